"""What counteracts a push: the solution of the linear equations, and no steady error in flight."""

import math
from functools import partial

import pytest
import torch

from dynasindy.control import Observer
from dynasindy.control.controller import acting
from dynasindy.control.observer import _correction
from dynasindy.control.sensing import Sensing
from dynasindy.envs import ControlEnv, Sensors, Step, Tracking, TrackingReward
from dynasindy.evaluation.disturbances import PerturbedPlant
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.systems import Signature, System

A = torch.tensor([[0.0, 1.0, 0.0], [-4.0, -0.8, 2.0], [0.0, 0.0, -3.0]], dtype=torch.float64)
B = torch.tensor([[0.0], [0.0], [3.0]], dtype=torch.float64)
SIGNATURE = Signature(("p", "v", "m"), ("m", "m/s", "-"), ("u",), (1.0, 2.0, 0.5))


class Linear(System):
    def __init__(self):
        super().__init__(SIGNATURE)

    def forward(self, x, u):
        return x @ A.to(x).T + u @ B.to(x).T


def test_on_a_linear_plant_it_solves_the_steady_state_equations():
    push = torch.tensor([[0.0, 0.3, 0.0], [0.0, -1.0, 0.0]], dtype=torch.float64)
    shift = torch.zeros(2, 4, dtype=torch.float64)
    for _ in range(5):
        shift = _correction(Linear(), torch.rand(2, 3).double(), torch.rand(2, 1).double(), push, [0], shift)
    held = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    both = torch.cat([torch.cat([A, B], 1), held])
    expected = torch.linalg.solve(both, torch.cat([-push, torch.zeros(2, 1)], -1).T).T
    torch.testing.assert_close(shift, expected, rtol=1e-6, atol=1e-6)
    assert shift[0, 2].item() == pytest.approx(-0.15) and shift[0, 3].item() == pytest.approx(-0.15)


class Crane(System):
    """A weight on an arm: v' = -sin(p) + tanh(u) - 0.3 v, of which no slope is that of a chord."""

    def __init__(self):
        super().__init__(Signature(("p", "v"), ("rad", "rad/s"), ("u",), (1.5, 3.0)))

    def forward(self, x, u):
        p, v = x.unbind(-1)
        return torch.stack([v, torch.tanh(u[..., 0]) - torch.sin(p) - 0.3 * v], -1)


def test_a_push_on_a_curved_plant_is_counteracted_by_newton_s_steps():
    """tanh(u - du) = tanh(u) + push, by hand; five calls of two steps leave next to nothing."""
    x, u = torch.tensor([0.4, 0.0], dtype=torch.float64), torch.tensor([0.2], dtype=torch.float64)
    push = torch.tensor([0.0, -0.2], dtype=torch.float64)
    shift, left = torch.zeros(3, dtype=torch.float64), []
    wanted = 0.2 - math.atanh(math.tanh(0.2) - 0.2)
    for _ in range(5):
        shift = _correction(Crane(), x, u, push, [0], shift)
        left.append(abs(float(shift[2]) - wanted))
    assert left[1] < 1e-6 and left[-1] < 1e-8
    assert shift[:2].abs().max() < 1e-8


def pushed(disturbance=True):
    plant = Linear()
    task = Tracking(SIGNATURE, Step([[0.0]]), ["p"], ["v"], TrackingReward([1.0]))
    env = ControlEnv(plant, task, substeps=1, dtype=torch.float64)
    sensors = Sensors({"p": {"resolution": 1e-3}}, {"p": "v"}, disturbance=disturbance)
    sensing = Sensing(env, Observer(plant, sensors, env), torch.Generator().manual_seed(0))
    sensing.observer.nis = 1.0
    sensing.observer.q[:3] = 1e-3
    return plant, sensing, env


def steer(tensordict):
    """Hold r with u = 2 r, the input of its steady state, and some feedback."""
    seen = tensordict["observation"]
    error, speed = 0.5 * seen[..., 3:4], 2.0 * seen[..., 1:2]
    reference = error + seen[..., :1]
    return tensordict.set("action", 2 * reference + error - 0.5 * speed)


def test_a_constant_push_leaves_no_steady_error_and_without_it_does():
    scenario = Scenario("s", Step([[0.2], [-0.1]]), 2, 15.0, plant=partial(PerturbedPlant, push={"v": 0.3}))
    errors = {}
    for disturbance in (True, False):
        _, sensing, env = pushed(disturbance)
        result = evaluate(env, steer, scenario, sensing)
        errors[disturbance] = result.metrics["steady_state_error"].max().item()
        if disturbance:
            found = result.trajectory["observer", "mean"][:, -50:, 3].mean().item()
            assert found == pytest.approx(0.3, abs=0.01)
    assert errors[True] < 2e-3 and errors[False] > 0.03


def test_the_action_stays_within_its_limits_and_observations_are_shifted():
    _, sensing, env = pushed()
    start = sensing.begin(env.start_from(torch.zeros(1, 3)))
    start["observer", "shift"] = torch.tensor([[0.0, 0.0, 0.1, 3.0]], dtype=torch.float64)
    seen = {}

    def watch(tensordict):
        seen["observation"] = tensordict["observation"]
        return tensordict.set("action", torch.zeros(1, 1))

    before = start["observation"].clone()
    acted = sensing.controller(watch)(start)
    assert acted["action"].tolist() == [[1.0]]
    torch.testing.assert_close(seen["observation"][0, 2], before[0, 2] - 0.1 / 0.5)
    assert torch.equal(acted["observation"], before)


def test_an_input_stays_between_its_ends_with_a_push_and_without_one():
    _, _, env = pushed()
    env.task = env.task.with_input_limits([[-0.25], [0.5]])
    start = env.start_from(torch.zeros(3, 3))
    commands = torch.tensor([[-1.0], [0.25], [0.75]])
    told = acting(lambda tensordict: tensordict.set("action", commands), env)(start)
    assert told["action"].flatten().tolist() == [-0.25, 0.25, 0.5]
    shift = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64).expand(3, -1)
    shifted = acting(lambda tensordict: tensordict.set("action", commands), env, pushed=True)
    start["observer", "shift"] = shift
    assert shifted(start)["action"].flatten().tolist() == [0.0, 0.5, 0.5]


class Vessel(System):
    """A vessel that empties in some 50 s: dx/dt = 0.05 u - 0.02 x."""

    def __init__(self):
        super().__init__(Signature(("level", "flow"), ("cm", "cm3/s"), ("u",), (2.0, 1.0)))

    def forward(self, x, u):
        return torch.stack([0.05 * u[..., 0] - 0.02 * x[..., 0], 0.5 * (u[..., 0] - x[..., 1])], -1)


def test_a_plant_without_rates_is_pushed_on_what_is_measured_at_its_own_pace():
    """At rest 0 = 0.05 (0.4 r + r - x) - 0.02 x + 0.01, which leaves x - r = 0.01 / 0.07 cm."""
    plant = Vessel()
    task = Tracking(plant.signature, Step([[0.0]]), ["level"], [], TrackingReward([1.0]))
    env, rng = ControlEnv(plant, task, 1.0, 1, dtype=torch.float64), torch.Generator().manual_seed(0)

    def feed(tensordict):
        seen = tensordict["observation"]
        error, level = 0.5 * seen[..., 2:3], 2.0 * seen[..., :1]
        return tensordict.set("action", 0.4 * (level + error) + error)

    scenario, left = (
        Scenario("s", Step([[0.5], [-0.5]]), 2, 250.0, plant=partial(PerturbedPlant, push={"level": 0.01})),
        {},
    )
    u = 2 * torch.rand(300, 1, generator=rng, dtype=torch.float64) - 1
    x = [torch.zeros(2, dtype=torch.float64)]
    for one in u:
        x.append(env.advance(x[-1], one)[0][-1])
    log = torch.stack(x)
    y = torch.stack([log[:, 0] + 0.01 * torch.randn(301, generator=rng), torch.full((301,), torch.nan)], -1)
    for disturbance in (True, False):
        observer = Observer(plant, Sensors({"level": {"noise": 0.01}}, disturbance=disturbance), env)
        assert observer.pushed == ([0] if disturbance else [])
        observer.learn(y.double(), u)
        result = evaluate(env, feed, scenario, Sensing(env, observer, torch.Generator().manual_seed(0)))
        left[disturbance] = result.metrics["steady_state_error"].max().item()
        if disturbance:
            # The range of its push is how fast the level usually changes, not a range in a second.
            usual = plant(log[:-1], u)[:, 0].square().mean().sqrt()
            torch.testing.assert_close(observer.scale[2], usual, rtol=0.02, atol=0.0)
            again = Observer(plant, observer.sensors, env)
            again.load_state_dict(observer.state_dict())
            assert torch.equal(again.scale, observer.scale)
            with pytest.raises(ValueError, match=r"range > 0 .* 1"):
                again.load_state_dict(observer.state_dict() | {"push_ranges": [-1.0]})
    # The estimate lags behind what is pushed, too, so that more is left than of a level that is known.
    assert left[True] < 0.01 and left[False] > 0.01 / 0.07
