"""What an actuator makes of commands, against the same thing in a thousand small steps an interval."""

import numpy as np
import pytest
import torch

from dynasindy.sindy.actuators import KINDS, Actuator
from dynasindy.systems.transitions import Transitions

DT, FINE = 0.1, 1000


def _step(kind, size, u, a, h):
    if kind == "rate limit":
        return a + np.clip(u - a, -size * h, size * h)
    if kind == "play":
        return np.clip(a, u - size, u + size)
    if kind == "dead zone":
        return np.sign(u) * max(abs(u) - size, 0.0)
    return a + h / size * (u - a)


@pytest.mark.parametrize(("kind", "size"), [("rate limit", 4.1), ("play", 0.2), ("dead zone", 0.3), ("lag", 0.1)])
def test_the_mean_over_an_interval_is_that_of_small_steps(kind, size):
    u = np.random.default_rng(0).uniform(-1, 1, 60)
    a, expected = 0.0, []  # where it begins is not told
    for held in u:
        outputs = []
        for _ in range(FINE):
            outputs.append(a := _step(kind, size, held, a, DT / FINE))
        expected.append(np.mean(outputs))
    data = Transitions.from_trajectory(torch.zeros(61, 1).double(), torch.from_numpy(u)[:, None], DT)
    found, known = Actuator(0, kind, size).acts(data)
    assert found.u[known, 0].numpy() == pytest.approx(np.array(expected)[known.numpy()], abs=4e-3)
    assert bool(known[20:].all()) and bool(known[0]) == (kind == "dead zone")
    assert found.x is data.x


def test_only_its_own_input_is_held_back_and_where_a_segment_begins_is_not_known():
    u = torch.tensor([[0.0, 0.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]], dtype=torch.float64)
    data = Transitions(torch.zeros(4, 1).double(), u, torch.zeros(4, 1).double(), 1.0, torch.tensor([0, 0, 0, 1]))
    # A unit a second, from 0 or from 1: at the end of the first second both ways are at 0; then from there to 1.
    found, known = Actuator(1, "rate limit", 1.0).acts(data)
    assert found.u.tolist() == [[0, 0.25], [1, 0.5], [1, 1], [1, 0.75]]
    assert known.tolist() == [False, True, True, False]


@pytest.mark.parametrize(("kind", "size"), [("hysteresis", 1.0), ("play", 0.0), ("lag", float("nan"))])
def test_what_is_no_actuator_is_refused(kind, size):
    with pytest.raises(ValueError, match=f"allowed are {', '.join(KINDS)} and a size above 0"):
        Actuator(0, kind, size)
