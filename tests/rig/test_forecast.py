"""What a model says of a flight is what its equations say."""

import re

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

from dynasindy import Controller
from dynasindy.control.controller import ControlSetup
from dynasindy.rig.session import forecast_flight
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.tasks import RandomStep, Tracking, TrackingReward

DT = 0.05


def flown(decay, targets):
    """Fly y' = decay y + 2 u under u = r."""
    signature = Signature(("y",), ("m",), ("u",), (1.0,))
    model = SindyModel(signature, ["y", "u"])
    model.set_coefficients(torch.tensor([[decay], [2.0]]))
    task = Tracking(signature, RandomStep([0.0], [1.0]), ("y",), (), TrackingReward((1.0,)))
    policy = TensorDictModule(lambda params: params[..., 0, :1].float(), ["task_params"], ["action"])
    return forecast_flight(Controller(policy, ControlSetup(task, DT)), model, [[target] for target in targets], 2.0)


def test_the_error_is_that_of_the_last_half_of_each_step():
    """Of y' = 2 (u - y) under u = r, a step from zero to r leaves r exp(-2 t); targets of 0.5 and 0.25 m, 2 s each."""
    targets = (0.5, 0.25)
    said = flown(-2.0, targets)
    left = np.mean(targets) * np.exp(-2 * DT * np.arange(40))
    assert said.startswith("prediction of the model, mean error over the last half of each target: y to ")
    assert float(re.search(r"y to (\S+) m$", said)[1]) == pytest.approx(left[20:].mean(), rel=0.005)


def test_a_flight_that_runs_away_is_told():
    assert flown(40.0, (0.5,)) == "prediction: on the model this flight runs away"
