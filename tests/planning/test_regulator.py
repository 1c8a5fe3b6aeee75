"""The regulator of the linearisation against its Riccati equation, and what a policy makes of it."""

import math

import numpy as np
import pytest
import torch
from scipy.linalg import expm, solve_discrete_are

from dynasindy.planning.plan_settings import find_task_equilibria
from dynasindy.planning.regulator import Regulator, regulated


def test_the_gain_and_the_slowest_mode_are_those_of_the_riccati_equation(inverted):
    env, rests = inverted()
    law = Regulator.of(env, rests, 50.0, 0.2)
    middle = float(rests.targets[rests.middle()])
    block = np.zeros((3, 3))
    block[0, 1], block[1, 0], block[1, 2] = 1.0, 4.0 * math.cos(middle), 6.0
    sampled = expm(block * 0.05)
    a, b, r = sampled[:2, :2], sampled[:2, 2:], np.array([[1.0]])
    p = solve_discrete_are(a, b, np.diag([50.0 / 0.8**2, 0.2 / 9.0]), r)
    k = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
    torch.testing.assert_close(law.gain, torch.as_tensor(k).float(), atol=1e-4, rtol=1e-4)
    radius = np.abs(np.linalg.eigvals(a - b @ k)).max()
    assert math.exp(-1 / law.slowest) == pytest.approx(radius, rel=1e-4)


@pytest.mark.parametrize(("dt", "a", "b"), [(0.5, -0.6, 1.0), (1.0, 0.36, 0.4)])
def test_a_difference_equation_is_regulated_as_the_map_that_it_is(mapped, dt, a, b):
    """x[k+1] = -0.6 x[k] + u[k], every step of 0.5 s; two of its steps are 0.36 x + 0.4 u, which nothing alternates."""
    env = mapped(-0.6, 1.0, dt)
    law = Regulator.of(env, find_task_equilibria(env), 2.0)
    # p = q + a^2 p - (a b p)^2 / (r + b^2 p) with q = 2 over the square of a target range of 1, and r = 1.
    half = (1 - a**2 - 2 * b**2) / (2 * b**2)
    p = -half + math.sqrt(half**2 + 2 / b**2)
    gain = a * b * p / (1 + b**2 * p)
    assert float(law.gain) == pytest.approx(gain, rel=1e-4) and float(law.cost) == pytest.approx(p, rel=1e-4)
    assert math.exp(-1 / law.slowest) == pytest.approx(abs(a - b * gain), rel=1e-4)


def test_a_law_is_that_of_whole_steps_of_a_difference_equation():
    rng = np.random.default_rng(0)
    f, g = rng.standard_normal((3, 3)), rng.standard_normal((3, 2))
    q = np.array([3.0, 0.5, 1.0])
    rates = torch.from_numpy((f - np.eye(3)) / 0.2), torch.from_numpy(g / 0.2)
    found = regulated(*rates, 0.4, torch.from_numpy(q), 0.2)
    a, b = f @ f, f @ g + g
    p = solve_discrete_are(a, b, np.diag(q), np.eye(2))
    np.testing.assert_allclose(found.cost, p, rtol=1e-8)
    np.testing.assert_allclose(found.gain, np.linalg.solve(np.eye(2) + b.T @ p @ b, b.T @ p @ a), rtol=1e-8)
