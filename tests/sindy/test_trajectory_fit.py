"""The fit to whole trajectories is the maximum likelihood estimate: scipy's minimum, and the Cramer-Rao bound."""

import math

import numpy as np
import pytest
import torch
from first_order import DT, LIBRARY, SIGNATURE, TWO, Y0, A, B, column, inputs, motion
from plants import scipy_motion
from scipy.optimize import least_squares

from dynasindy.findings import weak
from dynasindy.sindy import Refinement, Regression, SindyModel, shooting, trajectory_fit
from dynasindy.sindy.library import CONSTANT, Constraints, Library, variable
from dynasindy.sindy.reconstruction import RegressionData
from dynasindy.sindy.shooting import Descent
from dynasindy.sindy.trajectory_fit import refine_trajectory
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

NOISE = 0.03
INPUTS = inputs(20)


def coefficients_of(refine, *args):
    """Coefficients that a refinement finds; the library comes back as it was."""
    if refine is refine_trajectory:
        return refine(*args[:-1], Descent(args[-1])).estimate.xi
    return refine(*args)[1]


def recording(seed: int, noise: float = NOISE) -> Transitions:
    y = motion(A, B, Y0, INPUTS) + noise * np.random.default_rng(seed).normal(size=201)
    return Transitions.from_trajectory(torch.from_numpy(y).unsqueeze(-1), torch.from_numpy(INPUTS).unsqueeze(-1), DT)


def refine(window: int) -> Refinement:
    return Refinement("trajectory", rounds=0, window=window)


def bound() -> np.ndarray:
    """Cramer-Rao standard errors of a and b, the start state unknown, from central differences of the motion."""
    place, slopes = np.array([A, B, Y0]), []
    for k in range(3):
        step = 1e-5 * np.eye(3)[k]
        slopes.append((motion(*(place + step), INPUTS) - motion(*(place - step), INPUTS)) / 2e-5)
    information = np.array(slopes) @ np.array(slopes).T / NOISE**2
    return np.sqrt(np.diag(np.linalg.inv(information)))[:2]


# From ten times too fast a decay the first step without damping raises the cost.
@pytest.mark.parametrize(("window", "start"), [(10, -1.5), (37, -1.5), (200, -1.5), (100, -20.0)])
def test_the_estimate_is_scipy_s_minimum_whatever_the_windows_and_the_start(window, start):
    data = recording(0)
    measured = np.append(data.x[:1, 0].numpy(), data.x_next[:, 0].numpy())
    theirs = least_squares(lambda p: motion(*p, INPUTS) - measured, [A, B, Y0], xtol=1e-12, ftol=1e-12).x
    found = coefficients_of(refine_trajectory, LIBRARY, column(start, 2.5, 0.0, 0.0), TWO, data, window)
    error = np.abs(found[:2, 0].numpy() - theirs[:2])
    assert np.all(error < 0.02 * bound()), error / bound()


def test_its_spread_over_recordings_is_the_cramer_rao_bound():
    estimates = np.array(
        [
            coefficients_of(refine_trajectory, LIBRARY, column(A, B, 0.0, 0.0), TWO, recording(k), 10)[:2, 0].numpy()
            for k in range(24)
        ]
    )
    assert np.all(np.abs(estimates.mean(0) - [A, B]) < 4 * bound() / math.sqrt(24))
    assert np.all(np.abs(estimates.std(0, ddof=1) / bound() - 1) < 0.35)


def test_functions_that_noise_suggests_are_dropped_and_those_that_are_missed_come_in():
    free, data = torch.ones(4, 1, dtype=torch.bool), recording(1)
    dropped = coefficients_of(refine_trajectory, LIBRARY, column(-1.8, 2.8, 0.05, 0.05), free, data, 10)
    assert (dropped != 0).flatten().tolist() == [True, True, False, False]
    added = coefficients_of(refine_trajectory, LIBRARY, column(0.0, 2.8, 0.0, 0.0), free, data, 10)
    assert np.allclose(added, dropped, atol=0.05 * bound().max())


def test_windows_on_their_own_give_scipy_s_minimum_over_all_their_start_states():
    data = recording(0)
    measured = np.append(data.x[:1, 0].numpy(), data.x_next[:, 0].numpy())

    def errors(p: np.ndarray) -> np.ndarray:
        parts = []
        for k, start in enumerate(p[2:]):
            held, seen = INPUTS[50 * k : 50 * (k + 1)], measured[50 * k : 50 * (k + 1) + 1]
            parts.append(motion(p[0], p[1], start, held) - seen)
        return np.concatenate(parts)

    theirs = least_squares(errors, [A, B, *measured[:200:50]], xtol=1e-12, ftol=1e-12).x
    alone = Descent(50, joined=False)
    found = refine_trajectory(LIBRARY, column(-1.5, 2.5, 0.0, 0.0), TWO, data, alone).estimate.xi
    assert np.all(np.abs(found[:2, 0].numpy() - theirs[:2]) < 0.02 * bound())


def test_windows_in_which_the_model_runs_away_are_shorter_and_the_report_says_so():
    """y' = y^3 from 1 is 1 / sqrt(1 - 2 t), beyond all bounds after half a second; here it falls back to 1 before."""
    dt, n = 0.05, 200
    y = torch.from_numpy(1 / np.sqrt(1 - 2 * dt * (np.arange(n + 1) % 8))).unsqueeze(-1)
    data = Transitions.from_trajectory(y, torch.zeros(n, 1, dtype=torch.float64), dt)
    library, xi, free = Library(SIGNATURE, [variable("y", 3)]), column(1.0), torch.ones(1, 1, dtype=torch.bool)
    findings = (
        refine(20).run((library, xi), Constraints(free, torch.zeros_like(xi)), RegressionData.of(data, {})).findings
    )
    assert refine_trajectory(library, xi, free, data, Descent(20)).windows.length == 8
    assert findings == (weak("fit.shorter_shooting", long=20, short=8),)


def test_of_a_plant_that_falls_one_state_is_enough_as_its_trajectory_begins_anew(monkeypatch):
    """A pendulum upright, its angle measured alone, held for 12 s: an error of its start grows e^36-fold meanwhile."""
    signature = Signature(("theta", "omega"), ("rad", "rad/s"), ("u",), (0.2, 1.0))
    library = Library(signature, [*(variable(name) for name in ("theta", "omega", "u")), CONSTANT])
    a, b = np.array([[0.0, 1.0], [9.0, -0.5]]), np.array([0.0, 8.0])
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2] = a, b
    f = torch.linalg.matrix_exp(torch.from_numpy(DT * whole))[:2].numpy()
    rng, x, u = np.random.default_rng(0), [np.zeros(2)], []
    for k in range(1200):
        if k % 5 == 0:
            held = -2.0 * x[-1][0] - 0.6 * x[-1][1] + 0.1 * rng.normal()
        u.append(held)
        x.append(f[:, :2] @ x[-1] + f[:, 2] * held)
    seen = torch.from_numpy(np.array(x))
    guess = seen[:-1].clone()
    seen = (seen / 1e-3).round() * 1e-3
    seen[:, 1] = torch.nan
    data = Transitions.from_trajectory(seen, torch.tensor(u).unsqueeze(-1), DT)
    wanted = torch.tensor([[0.0, 9.0], [1.0, -0.5], [0.0, 8.0], [0.0, 0.0]], dtype=torch.float64)
    free = torch.tensor([[False, True]]).expand(4, 2)
    first = torch.where(free, 1.03 * wanted, wanted)
    apart = [
        float((refine_trajectory(library, first, free, data, Descent(20), guess).estimate.xi - wanted).abs().max())
        for _ in (monkeypatch.setattr(trajectory_fit, "FARTHEST", farthest) for farthest in (1e6, math.inf))
    ]
    assert apart[0] < 0.2 < apart[1], apart


def test_a_linear_model_of_overflowing_tanks_is_the_same_wherever_its_hidden_state_is_guessed_to_begin():
    random, n, dt = np.random.default_rng(3), 700, 4.0
    pump = np.repeat(random.uniform(1, 6, n // 20), 20)[:, None]

    def levels(t, x, u):
        roots, spilled = 0.08 * np.sqrt(np.maximum(x, 0)), max(x[0] - 7, 0)
        return [0.04 * u[0] - roots[0] - spilled, roots[0] - 0.75 * roots[1] + 0.6 * spilled]

    x = scipy_motion(levels, [4.0, 5.0], pump, dt, rtol=1e-6, atol=1e-6)[:, 1]
    names = Signature(("level", "h"), ("V", "V/s"), ("u",), (1.0, 1.0))
    library = Library(names, [CONSTANT, variable("level"), variable("h"), variable("u")])
    free = torch.tensor([[False, True], [False, True], [False, True], [True, True]])
    first = torch.tensor([[0, -4e-4], [0, -3e-5], [1, -7e-3], [0.08, 9e-4]], dtype=torch.float64)
    samples = torch.from_numpy(np.stack([x + 0.01 * random.normal(size=n + 1), np.full(n + 1, np.nan)], 1))
    data = Transitions.from_trajectory(samples, torch.from_numpy(pump), dt)
    hidden = torch.from_numpy(np.gradient(x, dt)[:-1] - 0.08 * pump[:, 0])
    found = []
    for guess in (hidden, 0 * hidden):
        start = torch.stack([data.x[:, 0], guess], 1)
        found.append(refine_trajectory(library, first, free, data, Descent(100, joined=False, select=False), start))
    one, other = (each.estimate.xi[free] for each in found)
    torch.testing.assert_close(one, other, rtol=1e-3, atol=0)


def test_a_recording_may_be_of_fewer_windows_than_parts(monkeypatch):
    wanted, found = (SindyModel(SIGNATURE, LIBRARY, Regression("bic"), refine(100)) for _ in range(2))
    wanted.fit(recording(0))
    monkeypatch.setattr(shooting, "CHUNK", 20)
    found.fit(recording(0))
    torch.testing.assert_close(found.coefficients, wanted.coefficients, rtol=1e-6, atol=1e-9)
    assert found.coefficients[:, 0].tolist()[:2] == pytest.approx([A, B], rel=0.1)
