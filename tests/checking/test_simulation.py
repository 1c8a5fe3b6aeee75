"""Flights are those of the linear map, and the plant comes back where arithmetic says that it can."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.checking.check import Settings, check
from dynasindy.checking.simulation import (
    GAINS,
    LATEST,
    LONGER,
    LoopSimulation,
    diverged_rows,
    find_limit_cycles,
    has_dry_friction,
    large_signal_margins,
    recovery_plane,
    simulate_loop,
)
from dynasindy.checking.verdict import check_verdict
from dynasindy.sindy import SindyModel


def test_a_flight_is_the_power_of_a_matrix(loops):
    flights = simulate_loop(loops(), torch.tensor([[0.4, -0.2]]), torch.tensor([[0.0]]), 2.0)
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
    assert not diverged_rows(x, torch.zeros(1), torch.tensor([0.5]), 0.002).any()
    slow = replace(flights, dt=0.05)  # 20 s: the last 2 s count
    assert slow.last == 40


def test_a_law_that_is_too_weak_for_a_hill_loses_the_plant_beyond_a_line(loops, carts, law):
    # v' = p + u with u = clamp(-3 p - 3 v) to 0.5: with p + v at most 0.5 it comes back, beyond it runs away.
    class Limited(law):
        def __call__(self, tensordict):
            tensordict = super().__call__(tensordict)
            return tensordict.set("action", tensordict["action"].clamp(-0.5, 0.5))

    loop = loops(Limited(3.0, 3.0), carts(spring=-1.0))
    (plane,) = recovery_plane(loop, torch.zeros(2), torch.zeros(1), 0.5, 9, 12.0)
    assert plane.names == ("p", "v") and plane.first[-1] == 1.0 and plane.second[-1] == 1.5
    total = (plane.first.unsqueeze(1) + plane.second).abs()
    clear = (total - 0.5).abs() > 0.05
    assert bool((plane.back == (total < 0.5))[clear].all())
    assert plane.share == pytest.approx(float((total < 0.5).double().mean()), abs=0.1)


def test_a_loop_that_rests_beside_its_target_comes_back_to_there_and_its_error_is_told_apart(loops, law):
    # v' = 2 (0 - p) - 2.5 v + 1 rests at p = 0.5, a quarter of the range of 2 m from the target.
    (plane,) = recovery_plane(loops(law(2.0, 2.5, bias=1.0)), torch.tensor([0.5, 0.0]), torch.zeros(1), 0.5, 5, 20.0)
    assert plane.share == 1.0
    assert plane.steady_error.tolist() == pytest.approx([0.5], abs=1e-6)


START = torch.tensor([[-0.2, 0.0], [0.2, 0.0]], dtype=torch.float64)
TARGETS = -START[:, :1]


def stable(k_p, k_v, gain=1.0, later=0, dt=0.1, lift=0.5):
    """Tell whether the sampled loop on a double integrator is stable, its input so many periods late.

    In a period an input lifts the place by `lift` dt^2: of the difference equation of the same changes by nothing.
    """
    a = np.zeros((2 + later, 2 + later))
    b = gain * np.array([lift * dt**2, dt])
    a[:2, :2] = [[1, dt], [0, 1]]
    law = np.array([-k_p, -k_v, *np.zeros(later)])
    if later:
        a[:2, 2] = b
        a[2:-1, 3:] = np.eye(later - 1)
        a[-1] += law
    else:
        a[:2] += np.outer(b, law)
    return np.abs(np.linalg.eigvals(a)).max() < 1


def test_of_a_linear_loop_they_are_those_of_its_eigenvalues(law, loops):
    found = large_signal_margins(loops(law(2.0, 2.5)), START, TARGETS, 40.0)
    late = next(n for n in range(1, 20) if not stable(2.0, 2.5, later=n))
    assert late - 1 - LATEST / 16 <= found.delay <= late
    assert found.gain == GAINS[-1] and stable(2.0, 2.5, gain=float(GAINS[-1]))
    strong = large_signal_margins(loops(law(2.0, 9.0)), START, TARGETS, 40.0)
    edge = next(g for g in np.arange(1.0, 4.0, 0.01) if not stable(2.0, 9.0, gain=g))
    assert edge - 0.135 <= strong.gain <= edge


@pytest.mark.parametrize(("k_p", "k_v"), [(4.0, 2.5), (2.0, 9.0)])
def test_a_difference_equation_bears_whole_periods_of_delay(law, loops, carts, k_p, k_v):
    """Those with which its characteristic polynomial is stable: 3 and 1 here, and not a part of one more."""
    found = large_signal_margins(loops(law(k_p, k_v), carts(step=0.1)), START, TARGETS, 60.0)
    late = next(n for n in range(1, 20) if not stable(k_p, k_v, later=n, lift=0.0))
    assert found.delay == late - 1
    edge = next((g for g in np.arange(1.0, 4.0, 0.01) if not stable(k_p, k_v, g, lift=0.0)), 4.0)
    assert edge - 0.135 <= found.gain <= edge


def rough(loops, law):
    """Return the cart with little damping but dry friction, by a force of 0.15 at any speed above 1 cm/s."""
    signature = loops().signature
    model = SindyModel(signature, ["force", "v", "tanh(100 v)"], known={"p": "v"})
    xi = [[0.0, 1.0], [1.0, 0.0], [0.0, -0.15]]
    model.set_coefficients(torch.tensor(xi, dtype=torch.float64))
    return loops(law(2.0, 1.2), model=model)


def test_dry_friction_makes_margins_at_rest_that_large_movements_do_not_have(loops, law):
    loop = rough(loops, law)
    found = check(loop, Settings((-0.4,), (0.4,), points=2, seconds=40.0, grid=2, draws=0))
    at_rest = min(margin.delay for target in found.margins for margin in target) / 0.1
    smooth = next(n for n in range(1, 20) if not stable(2.0, 1.2, later=n))  # nothing rubs
    assert smooth - 1 <= found.flown.delay < 0.5 * at_rest
    values = {each.code: each.values for each in check_verdict(found)}["check.large_movements"]
    assert values["delay"] == found.flown.delay and "delay" in values["counts"]


def test_a_loop_that_is_lost_as_it_is_has_none(loops, law):
    assert not stable(2.0, 0.05)
    found = large_signal_margins(loops(law(2.0, 0.05)), START, TARGETS, 40.0)
    assert found.gain == found.delay == 0.0


def test_a_plant_without_friction_is_not_flown(loops, law):
    found = check(loops(), Settings((-0.4,), (0.4,), points=2, seconds=4.0, grid=2, draws=0))
    assert found.flown is None and "check.large_movements" not in [each.code for each in check_verdict(found)]
    assert has_dry_friction(rough(loops, law).plant.model) and not has_dry_friction(loops().plant.model)


ENDS = torch.tensor([[-0.4], [0.4]], dtype=torch.float64)
ORIGIN = torch.zeros(2)


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


def test_swings_are_those_of_a_motion_that_is_computed_exactly(loops, carts, law):
    found = find_limit_cycles(
        loops(law(40.0, 1.0, limit=1.0), carts(friction=0.8)), ENDS, torch.tensor([False, True]), 20.0, ORIGIN
    )
    places, inputs = moved(40.0, 1.0, 0.8, -0.4, 200 * LONGER)
    assert found.seconds == 20.0 * LONGER
    assert float(found.outputs[0]) == pytest.approx(np.ptp(places[-200:]) / 2, rel=0.02)
    assert float(found.inputs[0]) == pytest.approx(np.ptp(inputs[-200:]) / 2, rel=0.02)
    assert float(found.error[0]) == pytest.approx(np.abs(places[-200:] + 0.4).mean(), rel=0.02)
    assert not found.outputs[1].any() and not found.inputs[1].any() and not found.error[1].any()  # it is stable


def test_swings_that_grow_have_no_size(loops, law):
    found = find_limit_cycles(loops(law(-1.0, 0.0)), ENDS, torch.tensor([False, False]), 4.0, ORIGIN)
    assert found.outputs.isinf().all() and (found.error > 1).all()
