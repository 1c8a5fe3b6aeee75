"""Simulations in open loop, against solutions by hand."""

import math

import pytest
import torch
from benchmarks.open_loop import simulated

from dynasindy.sindy.model import SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


def test_a_simulation_takes_inputs_when_they_take_effect():
    model = SindyModel(Signature(("y",), ("-",), ("u",), (1.0,)), ["u"])
    model.set_coefficients(torch.tensor([[1.0]]))
    model.delay = 0.2
    u = torch.tensor([[1.0], [0.0], [0.0], [5.0]]).double()
    data = Transitions.from_trajectory(torch.zeros(5, 1).double(), u, 0.1)
    # y' = u two samples late; before the log its first input held.
    assert simulated(model, torch.zeros(1).double(), data, 2)[:, 0].tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.3])


def test_each_sample_is_as_many_steps_as_were_asked_for():
    model = SindyModel(Signature(("y",), ("-",), ("u",), (1.0,)), ["y"])
    model.set_coefficients(torch.tensor([[-2.0]]))
    data = Transitions.from_trajectory(torch.zeros(4, 1).double(), torch.zeros(3, 1).double(), 0.5)
    coarse, fine = (simulated(model, torch.ones(1).double(), data, n)[:, 0] for n in (1, 50))
    # A Runge-Kutta step of fourth order over 0.5 s takes y' = -2 y by 1 - 1 + 1/2 - 1/6 + 1/24.
    assert coarse.tolist() == pytest.approx([0.375**k for k in range(4)])
    assert fine.tolist() == pytest.approx([math.exp(-k) for k in range(4)], rel=1e-7)
