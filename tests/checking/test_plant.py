"""The plant moves as an oscillator on paper does, its inputs late."""

import math

import numpy as np
import pytest
import torch

from dynasindy.checking.closed_loop import FINE, Plant, step_for
from dynasindy.control.controller import ControlSetup
from dynasindy.sindy import SindyModel
from dynasindy.systems import Stops


def test_a_spring_swings_as_a_cosine(carts):
    plant = Plant(carts(spring=4.0), 0.1, 0.01)
    x = plant.period(torch.tensor([[1.0, 0.0]], dtype=torch.float64), torch.zeros(1, 1, 1))
    assert x[0].tolist() == pytest.approx([math.cos(0.2), -2 * math.sin(0.2)], abs=1e-8)


@pytest.mark.parametrize(("delay", "pending", "v"), [(0.0, 0, 0.3), (0.1, 1, 0.2), (0.13, 2, 0.03 * 1 + 0.07 * 2)])
def test_inputs_act_late(carts, delay, pending, v):
    plant = Plant(carts(delay=delay), 0.1, 0.01)
    assert plant.pending == pending
    inputs = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)[-1 - pending :].reshape(1, -1, 1)
    x = plant.period(torch.zeros(1, 2, dtype=torch.float64), inputs)
    assert x[0, 1].item() == pytest.approx(v)


def test_stops_hold(carts):
    plant = Plant(carts(), 0.1, 0.05, Stops((0,), (1,), (-1.0,), (0.5,)))
    x = plant.period(torch.tensor([[0.45, 2.0]], dtype=torch.float64), torch.zeros(1, 1, 1))
    assert x[0].tolist() == [0.5, 0.0]


@pytest.mark.parametrize("spring", [1e-4, 1.0, 100.0, 1e6])
def test_the_step_is_as_long_as_the_plant_allows(carts, tasks, spring):
    """A spring that takes minutes is passed in one step of 2 s, and ends where its cosine does, as does a fast one."""
    model, dt, finest = carts(spring=spring), 2.0, 0.01
    step = step_for(model, ControlSetup(tasks(), dt), finest)
    assert (step == dt) == (spring == 1e-4) and step >= finest and (step == finest) == (spring > 1.0)
    if spring < 1e6:
        x = Plant(model, dt, step).period(torch.tensor([[1.0, 0.0]], dtype=torch.float64), torch.zeros(1, 1, 1))
        omega = math.sqrt(spring)
        assert x[0, 0].item() == pytest.approx(math.cos(omega * dt), abs=FINE if spring < 100 else 1e-4)


@pytest.mark.parametrize("function", ["v^3", "force v"])
def test_the_step_is_short_where_only_large_movements_or_inputs_make_the_plant_fast(carts, tasks, function):
    """v' = -3 v^3 has a rate of 9 v^2, up to 324 per second at 6 m/s; v' = -30 u v one of 30 per second."""
    model = SindyModel(carts().signature, ["v", function], known={"p": "v"})
    model.set_coefficients(torch.tensor([[1.0, 0.0], [0.0, -3.0 if function == "v^3" else -30.0]], dtype=torch.float64))
    assert step_for(model, ControlSetup(tasks(), 0.1), 0.001) < 0.1


def test_the_step_is_never_shorter_than_the_finest(carts, tasks):
    assert step_for(carts(spring=1.0), ControlSetup(tasks(), 2.0), 0.5) == 0.5


@pytest.mark.parametrize(("delay", "pending"), [(0.0, 0), (0.1, 1), (0.3, 2)])
def test_a_difference_equation_moves_by_its_own_steps_however_long_those_of_the_plant_are(carts, delay, pending):
    """p += 0.1 v, v += 0.1 (u - 0.5 v - 4 p), two of its steps in a period, inputs late by 0, 1 and 3 of them."""
    plant = Plant(carts(delay, 0.5, 4.0, step=0.1), 0.2, 0.03)
    assert plant.pending == pending
    inputs, x = np.array([1.0, 2.0, 3.0])[-1 - pending :], np.array([0.3, -0.2])
    found = plant.period(torch.from_numpy(x)[None], torch.from_numpy(inputs).reshape(1, -1, 1))
    late = round(delay / 0.1)
    for u in np.repeat(inputs, 2)[len(inputs) * 2 - 2 - late :][:2]:
        x = np.array([[1.0, 0.1], [-0.4, 0.95]]) @ x + np.array([0.0, 0.1]) * u
    assert found[0].tolist() == pytest.approx(x.tolist(), abs=1e-12)
