"""Plants of the logs rest where their constants say, and logs hold what their sensors can tell."""

import math

import numpy as np
import pytest
import torch
from benchmarks.logged import CASES, ENCODER


def moved(name, x, u):
    given = (torch.tensor(values, dtype=torch.float64) for values in (x, [u]))
    return CASES[name].plant(*given).tolist()


def test_the_plants_rest_where_their_equations_are_solved_by_hand():
    rest = pytest.approx([0.0] * 4, abs=1e-9)
    assert [*moved("arm", [math.asin(25 * 0.3 / 19.6), 0.0], 0.3), *[0.0] * 2] == rest
    assert [*moved("propeller", [math.asin(8 * 0.25 / 9), 0.0, 0.5], 0.5), 0.0] == rest
    level = (0.55 * 1.2 / 0.16) ** 2
    assert [*moved("tanks", [level, level], 0.2), *[0.0] * 2] == rest
    # 0.12 (1 + u) flows from the air into the wall, and a 900th of the wall's excess out of it, in units of the air.
    wall = 20 + 900 * 0.12 * 200 / 600
    assert [*moved("oven", [wall + 24.0, wall], 0.0), *[0.0] * 2] == rest
    assert [*moved("ship", [0.3, 0.0, 0.0], 0.0), 0.0] == rest
    assert [*moved("beam", [0.1, 0.0, 0.0], 0.0), 0.0] == rest
    assert [*moved("fan", [100.0], (200 + 80 + 10) / 250 - 1), *[0.0] * 3] == rest


def test_the_plants_move_as_their_equations_say():
    w = 0.7
    assert moved("servo", [0.0, w], 0.5)[1] == pytest.approx(30 - 5.6 - 4 * math.tanh(35))
    a, v = 6 * 0.5 - 4 * 0.2 - 0.3 * math.tanh(10), 0.2
    swing = -(9.81 * math.sin(0.4) + a * math.cos(0.4)) / 0.5 - 0.05 * w
    assert moved("crane", [0.1, 0.4, v, w], 0.5) == pytest.approx([v, w, a, swing])
    # Of a pole on a cart (M + m) a + m l w' cos = F + m l w^2 sin and l w' + a cos = g sin.
    x, force = [0.0, 0.3, 0.2, w], 10 * 0.4 - 0.2
    _, _, a, turn = moved("pole", x, 0.4)
    assert 1.2 * a + 0.1 * turn * math.cos(0.3) == pytest.approx(force + 0.1 * w * w * math.sin(0.3))
    assert 0.5 * turn + a * math.cos(0.3) == pytest.approx(9.81 * math.sin(0.3))
    assert moved("drone", [0.0, 1.0, 0.2], 0.6) == pytest.approx([1.0, 9.81 * 0.2 - 0.25, 5.0])
    twist = 60 * 0.1 + 20 * 1e-3 + 0.5 * 0.3
    assert moved("shaft", [0.3, 0.2, 0.4, 0.1], 0.5)[2:] == pytest.approx([15 - 1.2 - twist, 1.5 * twist - 0.08])
    assert moved("ship", [0.0, 0.01, 0.1], 0.5)[1:] == pytest.approx([(0.005 - 0.01 - 0.003) / 30, 0.1])
    assert moved("beam", [0.0, 0.2, 0.1], 0.5)[1:] == pytest.approx([-7 * math.sin(0.1) - 0.02, 0.075 / 0.06])


@pytest.mark.parametrize("name", ["tanks", *(pytest.param(name, marks=pytest.mark.slow) for name in ("arm", "pole"))])
def test_a_log_is_what_sensors_show_of_a_plant_that_is_kept_in_sensible_places(name):
    case = CASES[name]
    y, u = case.record(0)
    assert len(y) == len(u) == round(case.seconds / case.dt)
    seen = [list(case.states).index(sensor) for sensor in case.sensors]
    assert not bool(y[:, seen].isnan().any()) and y.isnan().any(0).sum() == len(case.states) - len(seen)
    assert float(u.abs().max()) <= 1.0 and torch.equal(y[:, seen], case.record(0)[0][:, seen])
    assert not torch.equal(u, case.record(1)[1])
    if name == "pole":  # the loop keeps it upright
        assert float(y[:, 1].abs().max()) < 0.3
    if name == "arm":
        np.testing.assert_allclose(y[:, 0] / ENCODER, (y[:, 0] / ENCODER).round(), atol=1e-6)
        lengths = torch.diff((u.diff(dim=0)[:, 0] != 0).nonzero().flatten()) * case.dt
        assert case.holds[0] - case.dt <= float(lengths.min()) and float(lengths.max()) <= case.holds[1] + case.dt
