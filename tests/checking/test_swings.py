"""What becomes of loops that are not stable, beside motions that are computed here step by step."""

import math

import numpy as np
import pytest
import torch

from dynasindy.checking.simulation import LONGER, find_limit_cycles

TARGETS = torch.tensor([[-0.4], [0.4]], dtype=torch.float64)
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
        loops(law(40.0, 1.0, limit=1.0), carts(friction=0.8)), TARGETS, torch.tensor([False, True]), 20.0, ORIGIN
    )
    places, inputs = moved(40.0, 1.0, 0.8, -0.4, 200 * LONGER)
    assert found.seconds == 20.0 * LONGER
    assert float(found.outputs[0]) == pytest.approx(np.ptp(places[-200:]) / 2, rel=0.02)
    assert float(found.inputs[0]) == pytest.approx(np.ptp(inputs[-200:]) / 2, rel=0.02)
    assert float(found.error[0]) == pytest.approx(np.abs(places[-200:] + 0.4).mean(), rel=0.02)
    assert not found.outputs[1].any() and not found.inputs[1].any() and not found.error[1].any()  # it is stable


def test_swings_that_grow_have_no_size(loops, law):
    found = find_limit_cycles(loops(law(-1.0, 0.0)), TARGETS, torch.tensor([False, False]), 4.0, ORIGIN)
    assert found.outputs.isinf().all() and (found.error > 1).all()


def test_a_loop_that_is_stable_everywhere_is_not_flown(loops, monkeypatch):
    monkeypatch.setattr("dynasindy.checking.simulation.simulate_loop", None)
    assert not find_limit_cycles(loops(), TARGETS, torch.tensor([True, True]), 4.0, ORIGIN).outputs.any()
