"""A prediction is as good as the worst of the models that it was made on."""

import pytest
import torch

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.held import Held
from dynasindy.evaluation.predicted import Prediction, predict
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.systems import Pendulum, System
from dynasindy.tasks import Step, Tracking, TrackingReward


def seen(share, away=None):
    return Held({"theta": share}, {"theta": 3 * share}, away or {}, {})


def test_it_is_promised_where_every_model_is_held():
    good = Prediction((seen(0.001), seen(0.009)))
    assert good.promised
    assert "on 2 models fitted to data that the plan never saw" in good.words()
    assert "CONTROLLED: theta to 0.1 to 0.9 % of its box" in good.words()


@pytest.mark.parametrize(
    ("flights", "words"),
    [
        ((seen(0.001), seen(0.02)), "NOT promised, 1 % is asked for: theta to 0.1 to 2 %"),
        ((seen(0.001), None), "NOT promised.*1 of 2 models run away"),
        ((None, None), "NOT promised, all of them run away"),
        ((seen(0.001, {"cart": 0.5}),), "cart, which is not tracked, runs away"),
    ],
)
def test_one_model_that_is_not_held_breaks_it(flights, words):
    found = Prediction(flights)
    assert not found.promised
    with pytest.raises(ValueError, match=words):
        raise ValueError(found.words())
    assert found.record()["promised"] is False
    assert len(found.record()["flights"]) == len(flights)


def test_a_model_promises_nothing_of_itself():
    found = Prediction((seen(0.001),), own=True)
    assert not found.promised
    assert "promises nothing of the plant" in found.words()


class Exploding(System):
    def __init__(self):
        super().__init__(Pendulum().signature)

    def forward(self, x, u):
        return 1e3 * x * x.square() + 1.0


def test_each_model_is_flown_in_the_place_of_the_plant():
    """A constant input holds each pendulum where the torque of its own gravity is as large: 9.81 sin(theta) = 12 u."""
    plant = Pendulum()
    target = float(torch.asin(torch.tensor(12 * 0.2 / 9.81)))
    task = Tracking(plant.signature, Step([[target]]), ("theta",), ("Omega",), TrackingReward((4.0,)), max_steps=600)
    env = ControlEnv(plant, task, dtype=torch.float64)

    def constant(tensordict):
        return tensordict.set("action", torch.full((*tensordict.batch_size, 1), 0.2))

    heavier = Pendulum(max_torque=10.0)
    found = predict([Exploding(), plant, heavier], env, constant, Scenario("step", episodes=1, seconds=30.0))
    assert found.flights[0] is None
    assert found.flights[1].share["theta"] < 1e-3
    off = target - float(torch.asin(torch.tensor(10 * 0.2 / 9.81)))
    assert found.flights[2].share["theta"] == pytest.approx(off, rel=0.02)
    assert found.shown is not None
