"""Settings of the loop: what a loop cannot run with is refused when they are made."""

import math
from dataclasses import FrozenInstanceError, fields

import pytest
import torch

from dynasindy.agents import TD3
from dynasindy.dyna.parts import Parts, Settings
from dynasindy.systems import Diverged
from dynasindy.tasks import Task


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"episodes": -1}, "episodes >= 0"),
        ({"updates_per_step": -0.5}, "updates_per_step >= 0"),
        ({"updates_per_step": math.nan}, "updates_per_step >= 0"),
        ({"recent_steps": 0}, "recent_steps >= 1 or null"),
        ({"recent_steps": -3}, "recent_steps >= 1 or null"),
        ({"held_out": 1}, "held_out is 1; give 0 for no test, or 2 or more"),
        ({"held_out": -2}, "held_out is -2"),
    ],
)
def test_settings_that_no_loop_can_run_with_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said) as error:
        Settings(**({"episodes": 1} | wrong))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("fine", [{"episodes": 0}, {"updates_per_step": 0}, {"recent_steps": 1}, {"held_out": 0}])
def test_the_smallest_allowed_settings_are_kept(fine):
    settings = Settings(**({"episodes": 1} | fine))
    assert {name: getattr(settings, name) for name in fine} == fine


def test_settings_cannot_change_under_a_running_loop():
    with pytest.raises(FrozenInstanceError):
        Settings(1).episodes = 2


def test_the_parts_are_those_that_algorithm_1_works_on():
    assert {f.name for f in fields(Parts)} == {
        *("plant", "env", "model_env", "excitation", "world_model", "agent", "replay", "planner", "gate", "sensing"),
    }
    with pytest.raises(TypeError, match="gate"):
        Parts(**dict.fromkeys([f.name for f in fields(Parts)][:-2]))


def test_every_fourth_second_is_held_out_by_default():
    assert Settings(7) == Settings(7, 1.0, None, 4) and Settings(1, held_out=2).held_out == 2


class Goal:
    own, state_dict = False, Task.state_dict


class Learner(Goal):
    def __init__(self):
        self.learnt = 0

    def state_dict(self):
        return {"learnt": self.learnt}

    def load_state_dict(self, state):
        self.learnt = state["learnt"]


class Part:
    """Any part of a run: it holds a number, and draws."""

    def __init__(self, number):
        self.number, self.rng, self.is_open = number, torch.Generator().manual_seed(number), number > 5
        self.task = Goal()

    def check(self):
        pass

    def state_dict(self):
        return {"number": self.number}

    def load_state_dict(self, state):
        self.number = state["number"]


@pytest.mark.parametrize("behind_sensors", [False, True])
def test_every_part_goes_on_where_it_was(behind_sensors):
    one, other = (
        Parts(**{f.name: Part(start + k) for k, f in enumerate(fields(Parts)) if f.name != "sensing" or behind_sensors})
        for start in (0, 100)
    )
    state = one.state_dict()
    torch.rand(3)
    drawn = [getattr(one, name).rng.get_state() for name in ("plant", "model_env")]
    wanted = torch.rand(2)
    other.load_state_dict(one.state_dict() | {"global": state["global"]})
    torch.rand(3)
    assert torch.equal(torch.rand(2), wanted)
    kept = ["world_model", "agent", "replay", "planner", *(["sensing"] if behind_sensors else [])]
    assert [getattr(other, name).number for name in kept] == [getattr(one, name).number for name in kept]
    assert [state[name]["number"] for name in kept] == [getattr(one, name).number for name in kept]
    assert other.gate.is_open == one.gate.is_open
    now = [getattr(other, name).rng.get_state() for name in ("plant", "model_env")]
    assert all(torch.equal(a, b) for a, b in zip(now, drawn, strict=True))


def test_weights_that_are_not_finite_are_in_no_state_to_go_on_from():
    agent = TD3(n_obs=2, n_u=1, hidden=(4,))
    with torch.no_grad():
        next(agent.policy.parameters()).fill_(torch.nan)
    parts = Parts(*[None] * 5, agent, *[None] * 3)
    with pytest.raises(Diverged):
        parts.state_dict()


def test_what_a_task_has_learnt_goes_on_with_the_run():
    one, other = (Parts(**{f.name: Part(k) for k, f in enumerate(fields(Parts)) if f.name != "sensing"}) for _ in "ab")
    for parts in (one, other):
        parts.plant.task = Learner()
    one.plant.task.learnt = 7
    other.load_state_dict(one.state_dict())
    assert other.plant.task.learnt == 7
