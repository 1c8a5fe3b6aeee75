"""Margins against python-control, against a simulation that goes unstable, and against figures on paper."""

import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from dynasindy.checking.linear_loop import Linear, loop_margins, open_loop, sensitivity

DT = 0.1
A = np.array([[1.0, DT], [0.0, 1.0]])
B = np.array([[DT**2 / 2], [DT]])


def closed(a, b, k):
    """Return the loop of u = -k x."""
    n = len(a)
    return Linear(a - b @ k, b, -k, np.zeros((n, n)), np.zeros((b.shape[1], n)), DT)


def lqr(a, b, q, r):
    p = solve_discrete_are(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


LQR = lqr(A, B, np.diag([1.0, 0.1]), np.array([[0.5]]))
COUPLED = np.array([[1.1, 0.2, 0.0], [0.0, 0.7, 0.3], [0.1, 0.0, 0.9]])
INPUTS = np.array([[0.1, 0.0], [0.5, 0.1], [0.0, 0.4]])
TWO = lqr(COUPLED, INPUTS, np.eye(3), np.eye(2))


# An oscillation of 3 rad/s whose rate is fed back: the phase of the loop is positive below its resonance.
TURN = 0.98 * np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
RATE = np.array([[0.0, 0.5]])


def radius(a, b, k, factor):
    return np.abs(np.linalg.eigvals(a - b @ np.diag(factor) @ k)).max()


@pytest.mark.parametrize(("a", "b", "k"), [(A, B, LQR), (COUPLED, INPUTS, TWO)])
def test_at_its_gain_margins_a_loop_is_about_to_go(a, b, k):
    for i, found in enumerate(loop_margins(closed(a, b, k))):
        factor = np.ones(b.shape[1])
        factor[i] = found.gain
        assert radius(a, b, k, factor) == pytest.approx(1, abs=1e-6)
        factor[i] = 0.999 * found.gain
        assert radius(a, b, k, factor) < 1
        if found.lower:
            factor[i] = found.lower
            assert radius(a, b, k, factor) == pytest.approx(1, abs=1e-6)


def test_an_integrator_has_the_margins_of_paper():
    # x+ = x + 0.1 u, u = -4 x: 1 + k L = 0 where 0.4 k = 2. L = 0.4 / (z - 1) has gain 1 where 2 sin(w dt / 2) = 0.4,
    # and its phase there is -90 deg - w dt / 2.
    (found,) = loop_margins(closed(np.array([[1.0]]), np.array([[DT]]), np.array([[4.0]])))
    angle = 2 * math.asin(0.2)
    assert found.gain == pytest.approx(5) and found.lower == 0
    assert found.phase == pytest.approx(math.degrees(math.pi / 2 - angle / 2))
    assert found.delay == pytest.approx((math.pi / 2 - angle / 2) / (angle / DT))
    # S = (z - 1) / (z - 0.6), and |S - 1/2| = |z - 1.4| / |2 (z - 0.6)| is largest at z = -1.
    assert found.disk == pytest.approx(2 * 1.6 / 2.4, rel=1e-6)


@pytest.mark.parametrize(("a", "b", "k"), [(A, B, np.array([[1.0, 1.1]])), (TURN, np.array([[0.0], [1.0]]), RATE)])
def test_a_delay_of_whole_periods_beyond_the_margin_is_too_long(a, b, k):
    (found,) = loop_margins(closed(a, b, k))
    for periods in range(1, 15):
        late = np.zeros((2 + periods, 2 + periods))
        late[:2, :2], late[:2, 2:3] = a, b
        late[np.arange(2, 1 + periods), np.arange(3, 2 + periods)] = 1
        late[-1, :2] = -k
        assert (np.abs(np.linalg.eigvals(late)).max() < 1) == (periods * DT < found.delay)


@pytest.mark.parametrize(("a", "b", "k"), [(A, B, LQR), (COUPLED, INPUTS, TWO), (TURN, np.array([[0.0], [1.0]]), RATE)])
def test_python_control_finds_the_same(a, b, k):
    control = pytest.importorskip("control")
    linear = closed(a, b, k)
    for i, found in enumerate(loop_margins(linear)):
        opened = a - b @ k + b[:, i : i + 1] @ k[i : i + 1]
        loop = control.ss(opened, b[:, i : i + 1], k[i : i + 1], 0, DT)
        gains, phases, *_ = control.stability_margins(loop, returnall=True)
        disk, _, _ = control.disk_margins(loop, np.linspace(1e-3, math.pi / DT, 4000))
        # It leaves out half the sampling rate, and finds a gain of 1e-10 in the rounding of a double integrator.
        theirs = [gain for gain in gains if 1e-6 < gain < 1e6]
        assert all(pytest.approx(gain, rel=1e-4) in (found.gain, found.lower) for gain in theirs)
        assert found.phase == pytest.approx(min(abs(phases)), rel=1e-4)
        assert found.disk == pytest.approx(disk, rel=1e-3)


def test_an_unstable_plant_must_not_lose_the_input():
    # x+ = 1.2 x + 0.1 u, u = -4 x: 1.2 - 0.4 k = 1 at k = 0.5, and = -1 at k = 5.5.
    (found,) = loop_margins(closed(np.array([[1.2]]), np.array([[DT]]), np.array([[4.0]])))
    assert found.lower == pytest.approx(0.5) and found.gain == pytest.approx(5.5)


def test_the_loop_is_that_which_is_open_at_one_input_alone():
    omega = np.array([0.3, 2.0, 20.0])
    linear = closed(COUPLED, INPUTS, TWO)
    for i in range(2):
        opened = COUPLED - INPUTS @ TWO + INPUTS[:, i : i + 1] @ TWO[i : i + 1]
        expected = [
            (TWO[i] @ np.linalg.solve(np.exp(1j * w * DT) * np.eye(3) - opened, INPUTS[:, i])).item() for w in omega
        ]
        np.testing.assert_allclose(open_loop(linear, omega)[:, i], expected, rtol=1e-9)
        np.testing.assert_allclose(sensitivity(linear, omega)[:, i], 1 / (1 + np.array(expected)), rtol=1e-9)


def test_a_loop_that_is_not_stable_has_none():
    with pytest.raises(ValueError, match="margins"):
        loop_margins(closed(A, B, -LQR))
