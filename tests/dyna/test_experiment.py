"""What a recipe builds, what of it a run keeps, and an observer that makes up for a delay which the fit has found."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch
from recipes import Heard, make_recipe, resumed

from dynasindy.agents import TD3, DynaReplay
from dynasindy.dyna import experiment
from dynasindy.dyna.experiment import LoopSettings
from dynasindy.dyna.loop import train
from dynasindy.envs import Chirp, ControlEnv, Multisine, RandomStep, Tracking, TrackingReward
from dynasindy.planning import Gate, ImaginedReplay
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Pendulum, Tras


def recipe(seed=0):
    env = partial(ControlEnv, dtype=torch.float64)
    return make_recipe(Tras(azimuth_stop=2.0), 200, env=env, excitation=Chirp, seed=seed)


def test_imagined_and_real_environment_share_task_and_stops():
    parts = recipe().build()
    assert parts.model_env.task is parts.plant.task
    assert parts.model_env.stops is parts.plant.system.stops
    assert parts.model_env.float_type == torch.float32 and parts.plant.float_type == torch.float64


def test_every_part_draws_from_a_seed_of_its_own():
    def built(seed):
        given = {}

        def planning(**parts):
            given.update(parts)
            return ImaginedReplay(**parts)

        def agent(**settings):
            given["agent_seed"] = settings["seed"]
            return TD3(**settings, hidden=(8,))

        parts = replace(recipe(seed), planning=planning, agent=agent).build()
        assert given["env"] is parts.model_env and given["agent"] is parts.agent and given["replay"] is parts.replay
        generators = parts.plant.rng, parts.model_env.rng, parts.replay.generator
        return {*(each.initial_seed() for each in generators), given["seed"], given["agent_seed"]}

    assert built(3) == built(3) and len(built(3) | built(4)) == 10


def test_trust_in_the_model_and_the_global_generator_go_on_where_they_were():
    one, other = recipe().build(), recipe().build()
    one.gate.is_open = not other.gate.is_open
    state, wanted = one.state_dict(), torch.rand(2)
    other.load_state_dict(state)
    assert torch.equal(torch.rand(2), wanted) and other.gate.is_open == one.gate.is_open


def test_the_parts_fit_each_other():
    parts = recipe().build()
    assert parts.env is parts.plant and parts.sensing is None
    assert parts.excitation.dt == parts.plant.dt and parts.agent.deployed is not None


@pytest.mark.parametrize("substeps", [1, 3])
def test_the_memory_of_the_storages_is_that_of_their_full_rows(monkeypatch, substeps):
    sizes = []
    monkeypatch.setattr(experiment, "check_memory", lambda size, what: sizes.append(size))
    env = partial(ControlEnv, dtype=torch.float64, substeps=substeps)
    parts = replace(recipe(), env=env, replay=partial(DynaReplay, 1000, 16, model_capacity=300)).build()
    n_o = parts.plant.task.n_o
    # Two observations, two inputs and a reward, of four bytes; state, next state and samples of six, of eight bytes.
    assert sizes == [(1000 + 300 + 16) * 4 * (n_o + n_o + 2 + 1) + 1000 * 8 * 6 * (1 + 1 + substeps)]


WORDS = ["1", "u", "theta", "Omega", "sin(theta)"]


def pendulum(periods, sensors=None):
    """Return a recipe of a pendulum all of whose states are seen, and whose input is late without a word."""
    return make_recipe(
        Pendulum(),
        task=partial(
            Tracking,
            reference=RandomStep([-0.5], [0.5]),
            outputs=["theta"],
            rates=["Omega"],
            reward=TrackingReward((4.0,)),
            max_steps=50,
        ),
        env=partial(ControlEnv, substeps=2, delay=0.05 * periods, dtype=torch.float64),
        excitation=partial(Multisine, duration=2.5, amplitude=[0.3]),
        world_model=partial(
            SindyModel,
            library=WORDS,
            regression=Regression("bic", tolerance=1e-4),
            refinement=Refinement("integral", longest_delay=None),
            known={"theta": "Omega"},
        ),
        planning=partial(ImaginedReplay, rollouts=4, horizon=5),
        gate=Gate(math.inf, math.inf),
        train=LoopSettings(2, 0.2),
        sensors=sensors,
    )


def test_the_policy_is_shown_where_the_plant_will_be_when_its_input_arrives():
    made, periods = pendulum(2.5), 2.5
    parts, heard = made.build(), Heard()
    train(parts, made.train, heard)
    assert parts.world_model.delay == pytest.approx(0.05 * periods, abs=1e-3)
    ahead(heard.episodes[-1].rollout, periods)


def ahead(rows, periods):
    """Make sure that a policy was shown where the plant is so many periods later."""
    samples, later = rows["next", "samples"].reshape(-1, 2), round(2 * periods)  # two samples in a period
    truth = samples[later - 1 :: 2][: len(rows) - math.ceil(periods)]
    shown = rows["state"][: len(truth)]
    now = rows["true_state"][: len(truth)]
    assert (now - truth).abs().max() > 0.1  # the plant moves much meanwhile
    torch.testing.assert_close(shown[3:], truth[3:], atol=2e-3, rtol=0.0)


class Later(Heard):
    """Have delays looked for after the first fit only."""

    def fitted(self, report, excited, cost):
        assert self.parts.world_model.delay == 0.0 and self.parts.sensing is None
        self.parts.world_model.refinement = Refinement("integral", longest_delay=None)


@pytest.mark.parametrize(("periods", "held_out"), [(1, 2), (2.5, 0)])
def test_a_delay_that_a_refit_finds_is_made_up_for_from_then_on(periods, held_out):
    made = pendulum(periods)
    made.world_model.keywords["refinement"] = Refinement("integral", longest_delay=0.0)
    parts = made.build()
    heard = Later(parts)
    train(parts, replace(made.train, held_out=held_out), heard)
    first, second = (episode.rollout for episode in heard.episodes)
    assert "true_state" not in set(first.keys()) and "true_state" in set(second.keys())
    assert parts.world_model.delay == pytest.approx(0.05 * periods, abs=1e-3)
    ahead(second, periods)
    if held_out:  # the refit is judged by inputs as late as it says, by which it predicts what it has not seen
        assert heard.episodes[0].refit.error_after < 0.01 * heard.episodes[0].refit.error_before
    # Every period that was flown still counts, and the fit reads what was seen of the first ones.
    assert len(parts.replay.real) == 50 + len(first) + len(second)
    seen = parts.replay.real_in_order()["measurement"][50 : 50 + len(first)]
    torch.testing.assert_close(seen, first["state"])


def test_a_run_that_makes_up_for_a_delay_goes_on_where_it_was_stopped():
    made = pendulum(2)
    made = replace(made, train=replace(made.train, episodes=1))
    heard = Heard(whole := made.build())
    train(whole, made.train, heard)
    assert len(heard.states) == 3
    for place in heard.states[:-1]:
        again = resumed(made, *place)
        wanted, found = whole.state_dict(), again.state_dict()
        assert torch.equal(wanted["world_model"]["coefficients"], found["world_model"]["coefficients"])
        stored = [state["replay"]["real"]["rows"]["observation"] for state in (wanted, found)]
        assert torch.equal(*stored)
        weights = [list(parts.agent.deployed.parameters()) for parts in (whole, again)]
        assert all(torch.equal(one, other) for one, other in zip(*weights, strict=True)) and weights[0]
