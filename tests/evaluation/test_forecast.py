"""A prediction is as good as the worst of the models that it was made on."""

import numpy as np
import pytest
import torch
from controllers import angle_task
from plants import Plant

from dynasindy.dyna.recorder import judge_run
from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward
from dynasindy.evaluation import tracking_criteria as module
from dynasindy.evaluation.forecast import Forecast
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.evaluation.tracking_criteria import TrackingCriteria
from dynasindy.findings import weak, wrong
from dynasindy.systems import Pendulum


def seen(share, away=None, worst=None, idle=None):
    return TrackingCriteria({"theta": share}, {"theta": 3 * share if worst is None else worst}, away or {}, idle or {})


@pytest.mark.parametrize(
    ("flights", "errors", "more"),
    [
        ((seen(0.001), seen(0.02)), ("wrong", 0.001, 0.02, 0.06), [weak("forecast.models_differ")]),
        ((seen(0.001, worst=0.2),), ("wrong", 0.001, 0.001, 0.2), [weak("forecast.longer_plan")]),
        ((seen(0.001), None), ("note", 0.001, 0.001, 0.003), [wrong("forecast.runs_away", models=1, of=2)]),
        ((None, None), None, [wrong("forecast.runs_away", models=2, of=2)]),
        ((seen(0.001, {"cart": 0.5}),), ("wrong", 0.001, 0.001, 0.003), []),
    ],
)
def test_one_model_that_is_not_held_breaks_it(flights, errors, more):
    found = Forecast(flights)
    assert not found.promised and "NOT promised" in found.summary()
    assert found.findings[0].severity == "wrong"  # the gravest comes first
    tracked = [each for each in found.findings if each.code == "forecast.tracked"]
    assert [each for each in found.findings if each not in tracked] == more
    assert len(tracked) == bool(errors)
    for each in tracked:
        told = each.values["outputs"]["theta"]
        assert (each.severity, each.values["within"], each.values["lost"]) == (errors[0], 0.01, 0.1)
        assert [told[name] for name in ("least", "most", "worst")] == pytest.approx(errors[1:])
        assert each.values["away"] == {
            name: {"share": share, "swings": False} for name, share in flights[0].away.items()
        }
    assert found.record()["promised"] is False
    assert len(found.record()["flights"]) == len(flights)


def test_a_model_promises_nothing_of_itself():
    found = Forecast((seen(0.001),), in_sample=True)
    assert found.controlled
    assert not found.promised
    assert "promises nothing" in found.summary() and "NOT" not in found.summary()
    far = Forecast((seen(0.02),), in_sample=True)
    assert not far.controlled
    assert "NOT CONTROLLED" in far.summary()


@pytest.mark.parametrize("share", [0.0, 0.009, 0.011])
@pytest.mark.parametrize("worst", [0.02, 0.099, 0.101])
@pytest.mark.parametrize("away", [{}, {"cart": 0.1}])
def test_it_is_judged_as_a_run_is(share, worst, away):
    flight = seen(share, away, worst, {"mileage": 1.0})
    returns = {"untrained": {"return": 0.0}, "evaluation": {"return": 1.0}}
    verdict = judge_run({"scenario": "step", "held": vars(flight), **returns})
    assert Forecast((flight,)).promised == verdict.controlled


def constant(u):
    return lambda tensordict: tensordict.set("action", torch.full((*tensordict.batch_size, 1), u))


def test_each_model_is_flown_in_the_place_of_the_plant():
    """A constant input holds each pendulum where the torque of its own gravity is as large: 9.81 sin(theta) = 12 u."""
    plant = Pendulum()
    target = float(torch.asin(torch.tensor(12 * 0.2 / 9.81)))
    env = ControlEnv(plant, angle_task(Step([[target]]), max_steps=600), 0.1, 2, dtype=torch.float64)
    heavier = Pendulum(max_torque=10.0)
    exploding = Plant("theta Omega", lambda theta, Omega, u: [1e3 * theta**3 + 1.0, 1e3 * Omega**3 + 1.0])
    found = Forecast.of([exploding, plant, heavier], env, constant(0.2), Scenario("step", episodes=1, seconds=30.0))
    assert found.flights[0] is None
    assert found.flights[1].share["theta"] < 1e-3
    off = target - float(torch.asin(torch.tensor(10 * 0.2 / 9.81)))
    assert found.flights[2].share["theta"] == pytest.approx(off, rel=0.02)
    assert found.evaluation is not None


CAR = Plant("theta Omega", lambda theta, Omega, u: [Omega, u - Omega])
"""Its place is driven by its speed, and nothing depends on it."""


def driven(car, dt=0.1):
    task = Tracking(car.signature, Step([[0.5]]), ("Omega",), (None,), TrackingReward((1.0,)), max_steps=600)
    return ControlEnv(car, task, dt, dtype=torch.float64)


def test_a_state_that_nothing_depends_on_may_run_on():
    env = driven(CAR, 0.05)
    found = Forecast.of([CAR], env, constant(0.5), Scenario("step", episodes=1, seconds=30.0))
    assert found.promised
    assert list(found.flights[0].idle) == ["theta"]


def test_a_plant_is_as_far_off_as_pushes_hold_it():
    """A speed v' = u - v that is pushed by p at the end of each period h rests at u + p / (1 - exp(-h)) then."""
    push, env = torch.tensor([[0.0, 0.002]], dtype=torch.float64), driven(CAR)
    still = Scenario("step", episodes=3, seconds=30.0)
    found = Forecast.of([CAR, CAR], env, constant(0.5), still, pushes=push.expand(40, -1))
    off = 0.002 / (1 - np.exp(-0.1))
    for flight in found.flights:  # of pushes that are always alike no log has too few
        assert flight.share["Omega"] == pytest.approx(off, rel=1e-3) == flight.worst["Omega"]
    assert list(found.flights[0].idle) == ["theta"]
    once = torch.zeros(60, 2, dtype=torch.float64)
    once[7] = push
    rare = Forecast.of([CAR, CAR], env, constant(0.5), still, pushes=once)
    first, second = (flight.share["Omega"] for flight in rare.flights)
    assert first < 0.1 * off and 1.3 * first < second < 2 * first
    far = Forecast.of([CAR, CAR], env, constant(0.5), still, pushes=20 * push.expand(40, -1)).findings
    assert [each.code for each in far] == ["forecast.tracked", "forecast.pushed"]


def test_a_model_that_only_pushes_make_diverge_promises_nothing():
    """The speed is no number beyond 1."""
    car = Plant("theta Omega", lambda theta, Omega, u: [Omega, u - Omega + 0 * torch.sqrt(1 - Omega)])
    env = driven(car)
    still, push = Scenario("step", episodes=1, seconds=10.0), torch.tensor([[0.0, 2.0]], dtype=torch.float64)
    assert Forecast.of([car], env, constant(0.5), still).controlled
    assert not Forecast.of([car], env, constant(0.5), still, pushes=push).controlled


def test_a_plan_that_was_too_short_is_told_from_one_that_diverges():
    """A controller that swings, or only misses, wants more updates; one that loses the plant something else."""
    longer = weak("forecast.longer_plan")
    swinging = TrackingCriteria({"theta": 0.2}, {"theta": 0.4}, {"cart": 1.0}, {}, {"cart": 1.0})
    assert Forecast((swinging,)).findings[0].values["away"] == {"cart": {"share": 1.0, "swings": True}}
    assert longer in Forecast((swinging,)).findings and longer in Forecast((seen(0.02),)).findings
    assert longer not in Forecast((seen(0.001),)).findings
    for gone in ((seen(0.02), None), (seen(0.02, {"cart": 0.5}),)):
        found = Forecast(gone).findings
        assert longer not in found
        assert found[0].severity == "wrong" and found[0].code in ("forecast.runs_away", "forecast.tracked")


def test_a_doubt_breaks_a_promise():
    doubt = wrong("model.incomplete", seconds=2.0)
    doubted = Forecast((seen(0.001),), doubts=(doubt,))
    assert not doubted.controlled and not doubted.record()["controlled"]
    assert doubted.findings[0] == doubt and doubted.record()["findings"][0] == doubt.record()
    assert "NOT promised" in doubted.summary() and str(doubt) in doubted.summary()


def test_what_has_to_come_to_rest_is_asked_where_a_flight_begins(monkeypatch):
    plant, asked = Pendulum(), []
    env = ControlEnv(plant, angle_task(Step([[0.3]]), start={"theta": -0.2}))
    every = torch.ones(2, dtype=torch.bool)
    monkeypatch.setattr(module, "states_that_matter", lambda model, columns, start: asked.append(start) or every)
    Forecast.of([plant], env, constant(0.0), Scenario("step", seconds=1.0))
    assert len(asked) == 1 and asked[0].tolist() == pytest.approx([-0.2, 0.0], abs=1e-6)
