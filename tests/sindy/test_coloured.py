"""Errors that last are made white: dense covariances, and an estimate that scipy's generalised least squares finds."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.linalg import toeplitz
from scipy.optimize import minimize

from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.noise import news, remaining
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

DT, LEFT, HELD = 0.1, 0.9, 10


def test_white_errors_are_those_of_the_dense_covariance():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(3, 4, 1, 2))  # the first two windows are one trajectory of 8 samples, the third begins anew
    covariance = toeplitz(LEFT ** np.arange(8)) / (1 - LEFT**2)
    white = news(
        torch.from_numpy(rows),
        torch.ones(3, 4, 1).double(),
        torch.tensor([False, True, False]),
        torch.tensor([LEFT], dtype=torch.float64),
    ).numpy()
    for mine, part in ((slice(0, 2), 8), (slice(2, 3), 4)):
        dense, got = rows[mine].reshape(-1, 2), white[mine].reshape(-1, 2)
        assert np.allclose(got.T @ got, dense.T @ np.linalg.solve(covariance[:part, :part], dense), rtol=1e-10)


def test_behind_a_sample_that_was_not_measured_an_error_counts_by_itself():
    rows, seen = (
        torch.tensor([1.0, 0.0, 3.0, 5.0]).double().view(1, 4, 1, 1),
        torch.tensor([1.0, 0.0, 1.0, 1.0]).double(),
    )
    white = news(rows, seen.view(1, 4, 1), torch.tensor([False]), torch.tensor([0.6], dtype=torch.float64)).flatten()
    assert white.tolist() == pytest.approx([0.8, 0.0, 2.4, 5 - 0.6 * 3])


def test_what_is_left_a_sample_later_is_found_and_none_of_white_noise():
    rng = np.random.default_rng(1)
    error = np.zeros((4000, 2))
    for k, new in enumerate(rng.normal(size=(4000, 2))):
        error[k] = np.array([LEFT, 0.0]) * (error[k - 1] if k else 0.0) + new
    joined = torch.arange(40) > 0
    rho = remaining(torch.from_numpy(error).view(40, 100, 2), torch.ones(40, 100, 2).double(), joined)
    assert rho.tolist() == pytest.approx([LEFT, 0.0], abs=0.03)
    assert remaining(torch.ones(1, 50, 1).double(), torch.ones(1, 50, 1).double(), joined[:1]).item() < 1


def _log(seed: int) -> tuple[Transitions, np.ndarray, np.ndarray]:
    """Return x' = -0.5 x + 2 u by its exact steps, seen with errors of which nine tenths are left a sample later."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, 40), HELD)
    y = _path(np.array([-0.5, 2.0, 0.3]), u)
    error = 0.0
    for k, new in enumerate(0.1 * rng.normal(size=len(y))):
        error = LEFT * error + new if k else new / math.sqrt(1 - LEFT**2)
        y[k] += error
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.from_numpy(u)[:, None], DT)
    return data, u, y


def _path(p: np.ndarray, u: np.ndarray) -> np.ndarray:
    decay, x = math.exp(p[0] * DT), [p[2]]
    for held in u:
        x.append(decay * x[-1] + (decay - 1) / p[0] * p[1] * held)
    return np.array(x)


def test_the_exact_steps_are_those_of_scipy():
    u = np.repeat([1.0, -0.5], HELD)
    end = 0.3
    for held in (1.0, -0.5):
        end = solve_ivp(lambda _, x, held=held: -0.5 * x + 2 * held, (0, HELD * DT), [end], rtol=1e-10).y[0, -1]
    assert _path(np.array([-0.5, 2.0, 0.3]), u)[-1] == pytest.approx(end, rel=1e-6)


def _fitted(data: Transitions, error: str) -> list[float]:
    model = SindyModel(
        Signature(("x",), ("m",), ("u",), (1.0,)),
        ["x", "u"],
        Regression("bic"),
        Refinement("trajectory", error=error, window=20),
        initial={"x": {"x": -0.4, "u": 1.8}},
    )
    model.fit(data)
    return model.coefficients[:, 0].tolist()


def test_the_estimate_is_that_of_generalised_least_squares():
    data, u, y = _log(0)
    found = _fitted(data, "coloured")
    lags = np.arange(len(y))

    def cost(p: np.ndarray) -> float:
        error, rho = y - _path(p[:3], u), math.tanh(p[3])
        shape = toeplitz(rho**lags) / (1 - rho**2)
        squares = error @ np.linalg.solve(shape, error) / len(y)
        return 0.5 * len(y) * math.log(squares) + 0.5 * np.linalg.slogdet(shape)[1]

    theirs = minimize(cost, [-0.5, 2.0, 0.3, math.atanh(LEFT)], method="Nelder-Mead", options={"maxiter": 400}).x
    assert found == pytest.approx(theirs[:2].tolist(), rel=0.01)


def test_of_errors_that_last_coloured_estimates_are_nearer_to_the_truth_than_a_simulation_s():
    rms = {}
    for error in ("coloured", "simulation"):
        found = np.array([_fitted(_log(seed)[0], error) for seed in range(4)])
        rms[error] = np.sqrt(np.mean((found / [-0.5, 2.0] - 1) ** 2))
    assert rms["coloured"] < 0.8 * rms["simulation"]
