"""Flights are those of the linear map, and the plant comes back where arithmetic says that it can."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.evaluation.check import LONGER, Settings, check
from dynasindy.evaluation.closed_loop import LoopSimulation

HERE = Settings((0.0,), (0.0,), points=1, reach=0.5, draws=0)
ENDS = Settings((-0.4,), (0.4,), points=2, grid=2, draws=0)


def test_a_flight_is_the_power_of_a_matrix(loops):
    flights = loops().fly(torch.tensor([[0.4, -0.2]]), torch.tensor([[0.0]]), 2.0)
    closed = np.array([[1.0, 0.1], [0.0, 1.0]]) - np.array([[0.005], [0.1]]) @ np.array([[2.0, 2.5]])
    expected = [np.linalg.matrix_power(closed, k) @ flights.x[0, 0].numpy() for k in range(21)]
    np.testing.assert_allclose(flights.x[0], expected, atol=1e-10)
    assert flights.u[0, 0].item() == pytest.approx(-2 * 0.4 + 2.5 * 0.2, abs=1e-6)


def test_error_slew_and_saturation_are_counted():
    x = torch.zeros(2, 41, 2, dtype=torch.float64)
    x[0, :, 0], x[1, -1, 0] = 0.7, torch.nan
    u = torch.zeros(2, 40, 1, dtype=torch.float64)
    u[0, :10, 0], u[1, 0, 0], u[1, 1, 0] = 1.0, -0.6, 0.9
    full = torch.tensor([[-1.0], [1.0]])
    flights = LoopSimulation(x, u, torch.tensor([[1.0], [0.0]]), [0], 0.1, full)
    assert flights.steady_error.flatten().tolist() == pytest.approx([0.3, np.inf])
    assert flights.slew.flatten().tolist() == pytest.approx([1.0, 1.5])
    assert flights.saturated.flatten().tolist() == [0.25, 0.0]
    narrow = replace(flights, limits=torch.tensor([[-0.6], [0.9]]))  # u is beyond, within, or at both ends
    assert narrow.saturated.flatten().tolist() == [0.25, 0.05]
    falling = replace(flights, u=torch.linspace(0.9, 0.8, 40, dtype=torch.float64).reshape(1, 40, 1))
    assert falling.slew.item() == pytest.approx(0.9)  # the first command comes from zero, and the last goes nowhere


def test_the_way_of_a_fast_plant_is_no_steady_error():
    # 0.8 s of a plant that is 1 away for 0.1 s, and then rests 0.01 beside its target.
    x = torch.full((1, 401, 1), 0.01, dtype=torch.float64)
    x[:, :50] = 1.0
    full = torch.tensor([[-1.0], [1.0]])
    flights = LoopSimulation(x, torch.zeros(1, 400, 1, dtype=torch.float64), torch.zeros(1, 1), [0], 0.002, full)
    assert flights.steady_error.item() == pytest.approx(0.01)
    assert flights.end.item() == pytest.approx(0.01)
    assert not flights.away(torch.tensor([0.5])).any()
    slow = replace(flights, dt=0.05)  # 20 s: the last 5 s count
    assert slow.last == 100


def test_a_law_that_is_too_weak_for_a_hill_loses_the_plant_beyond_a_line(loops, carts, law):
    # v' = p + u with u = clamp(-3 p - 3 v) to 0.5: with p + v at most 0.5 it comes back, beyond it runs away.
    class Limited(law):
        def __call__(self, tensordict):
            tensordict = super().__call__(tensordict)
            return tensordict.set("action", tensordict["action"].clamp(-0.5, 0.5))

    loop = loops(Limited(3.0, 3.0), carts(spring=-1.0))
    (plane,) = check(loop, replace(HERE, grid=9, seconds=12.0)).planes
    assert plane.names == ("p", "v")
    np.testing.assert_allclose(plane.first, np.linspace(-1, 1, 9), atol=1e-12)  # half of the ranges of 2 m and 3 m/s
    np.testing.assert_allclose(plane.second, np.linspace(-1.5, 1.5, 9), atol=1e-12)
    total = (plane.first.unsqueeze(1) + plane.second).abs()
    clear = (total - 0.5).abs() > 0.05
    assert bool((plane.back == (total < 0.5))[clear].all())
    assert plane.share == pytest.approx(float((total < 0.5).double().mean()), abs=0.1)


def test_a_loop_that_rests_beside_its_target_comes_back_to_there_and_its_error_is_told_apart(loops, law):
    # v' = 2 (0 - p) - 2.5 v + 1 rests at p = 0.5, a quarter of the range of 2 m from the target.
    (plane,) = check(loops(law(2.0, 2.5, bias=1.0)), replace(HERE, grid=5, seconds=20.0)).planes
    assert plane.share == 1.0
    assert plane.steady_error.tolist() == pytest.approx([0.5], abs=1e-6)


def moved(k_p, k_v, friction, target, periods, dt=0.1):
    """Positions and inputs of v' = u - friction v under a held u = clip(k_p (r - p) - k_v v), exactly."""
    left = math.exp(-friction * dt)
    p, v, places, inputs = 0.0, 0.0, [], []
    for _ in range(periods):
        u = float(np.clip(k_p * (target - p) - k_v * v, -1, 1))
        end = u / friction
        p, v = p + end * dt + (v - end) * (1 - left) / friction, end + (v - end) * left
        places.append(p)
        inputs.append(u)
    return np.array(places), np.array(inputs)


@pytest.mark.parametrize("seconds", [20.0, 3.0])
def test_swings_are_those_of_a_motion_that_is_computed_exactly(loops, carts, law, seconds):
    found = check(loops(law(40.0, 1.0, limit=1.0), carts(friction=0.8)), replace(ENDS, seconds=seconds)).swings
    last = round(10 * seconds)
    places, inputs = moved(40.0, 1.0, 0.8, -0.4, last * LONGER)
    assert found.seconds == seconds * LONGER
    assert float(found.outputs[0]) == pytest.approx(np.ptp(places[-last:]) / 2, rel=0.02)
    assert float(found.inputs[0]) == pytest.approx(np.ptp(inputs[-last:]) / 2, rel=0.02)
    assert float(found.error[0]) == pytest.approx(np.abs(places[-last:] + 0.4).mean(), rel=0.02)


def test_swings_that_grow_have_no_size(loops, law):
    found = check(loops(law(-1.0, 0.0)), replace(ENDS, seconds=4.0)).swings
    assert found.outputs.isinf().all() and (found.error > 1).all()


def test_a_loop_that_is_stable_swings_nowhere(loops):
    found = check(loops(), replace(ENDS, seconds=4.0)).swings
    assert not found.outputs.any() and not found.inputs.any() and not found.error.any()
