"""What a Kalman filter leaves over is white: dense covariances, scipy's likelihood, and a plant that is pushed."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import block_diag
from scipy.optimize import minimize

from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.noise import Noise, estimated, whiten
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import Estimate, Flow, linearise
from dynasindy.sindy.windows import Windows
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

DT = 0.1


def test_whitened_errors_are_those_of_the_dense_covariance():
    rng = np.random.default_rng(1)
    n, length = 2, 5
    phi = np.eye(n) + 0.3 * rng.normal(size=(length, n, n))
    seen = np.ones((length + 1, n))
    seen[0, 1] = seen[2, 0] = seen[4] = 0
    sensor, push = np.array([0.3, 0.2]), np.array([0.0, 0.9])
    # Each state is a sum of what earlier pushes became; half of a push acts before its interval, half after it.
    covariance, moves = np.zeros((n * (length + 1),) * 2), np.zeros((n * (length + 1), 0))
    for k in range(length):
        at = n * (k + 1)
        grown = np.zeros((n * (length + 1), 2 * n))
        grown[at : at + n] = np.hstack([phi[k], np.eye(n)]) @ np.diag(np.sqrt(0.5 * DT) * np.tile(push, 2))
        moves = np.hstack([moves, grown])
        moves[at : at + n, : 2 * n * k] = phi[k] @ moves[at - n : at, : 2 * n * k]
    covariance = moves @ moves.T + block_diag(*[np.diag(sensor**2)] * (length + 1))
    kept = seen.flatten() > 0
    covariance = covariance[kept][:, kept]
    rows = rng.normal(size=(length + 1, n, 3)) * seen[..., None]
    white, half = whiten(
        torch.from_numpy(rows)[None],
        torch.from_numpy(seen)[None],
        torch.from_numpy(phi)[None],
        Noise(torch.from_numpy(sensor), torch.from_numpy(push)),
        DT,
    )
    white = white[0].reshape(-1, 3).numpy()
    dense = rows.reshape(-1, 3)[kept]
    assert np.allclose(white.T @ white, dense.T @ np.linalg.solve(covariance, dense), rtol=1e-10)
    assert float(half) == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1], rel=1e-10)
    assert np.all(white[~kept] == 0)


@pytest.mark.parametrize(("noise", "push"), [(0.2, 0.5), (0.05, 1.0)])
def test_sizes_of_noise_and_pushes_are_those_of_scipy_s_likelihood_of_differences(noise, push):
    # A random walk seen with noise: differences know nothing of where it began.
    rng = np.random.default_rng(2)
    walk = np.cumsum(push * np.sqrt(DT) * rng.normal(size=(4, 101)), 1) + noise * rng.normal(size=(4, 101))
    steps = np.diff(walk, axis=1)

    def cost(logs: np.ndarray) -> float:
        covariance = (2 * np.exp(2 * logs[0]) + DT * np.exp(2 * logs[1])) * np.eye(100)
        covariance -= np.exp(2 * logs[0]) * (np.eye(100, k=1) + np.eye(100, k=-1))
        whole = np.einsum("wi,ij,wj", steps, np.linalg.inv(covariance), steps)
        return 2 * float(np.linalg.slogdet(covariance)[1]) + 0.5 * float(whole)

    theirs = np.exp(minimize(cost, np.log([noise, push]), method="Nelder-Mead", options={"xatol": 1e-6}).x)
    rows = torch.stack([torch.ones(4, 101), torch.from_numpy(walk)], -1).unsqueeze(2).double()
    phi = torch.ones(4, 100, 1, 1).double()
    spread = torch.from_numpy(walk).std().reshape(1)
    found = estimated(rows, torch.ones(4, 101, 1).double(), phi, torch.tensor([True]), spread, DT)
    assert [float(found.sensor), float(found.push)] == pytest.approx(theirs.tolist(), rel=0.01)


def test_a_state_that_no_sensor_sees_or_that_cannot_be_pushed_has_no_size():
    rows = torch.randn(2, 20, 2, 3, generator=torch.Generator().manual_seed(0)).double()
    seen = torch.ones(2, 20, 2).double()
    seen[..., 1] = 0
    rows[:, :, 1] = 0
    phi = torch.tensor([[1.0, DT], [0.0, 0.9]]).double().expand(2, 19, 2, 2)
    found = estimated(rows, seen, phi, torch.tensor([False, True]), torch.ones(2).double(), DT)
    assert float(found.push[0]) == 0 and float(found.sensor[1]) == 1
    assert float(found.push[1]) > 0 and float(found.sensor[0]) > 0


@pytest.mark.parametrize("rate", [-1.0, 10.0])
def test_what_innovations_cost_is_their_likelihood_of_a_plant_that_runs_away_too(rate):
    # Noise of a sensor alone: a filter of a plant that runs away expects any error, and meets it.
    rng, sensor, push, n = np.random.default_rng(3), 0.1, 0.02, 8
    y = sensor * rng.normal(size=n + 1)
    signature = Signature(("x",), ("m",), ("u",), (1.0,))
    library = SindyModel(signature, ["x", "u"]).library
    data = Transitions.from_trajectory(torch.from_numpy(y)[:, None], torch.zeros(n, 1).double(), DT)
    noise = Noise(torch.tensor([sensor]).double(), torch.tensor([push]).double())
    windows = replace(Windows.of(data, n, joined=False), noise=noise)
    xi = torch.tensor([[rate], [0.0]]).double()
    found = linearise(Flow.of(Estimate(library, xi, windows.first), Parameters.where(xi != 0), windows))
    grown = sum((rate * DT) ** k / math.factorial(k) for k in range(5))
    # Each half of a push, before and after its interval, and what becomes of it.
    moves = np.zeros((n + 1, 2 * n))
    for k in range(n):
        moves[k + 1] = grown * moves[k]
        moves[k + 1, 2 * k : 2 * k + 2] = np.sqrt(0.5 * DT) * push * np.array([grown, 1.0])
    covariance = moves @ moves.T + sensor**2 * np.eye(n + 1)
    error = y - y[0] * grown ** np.arange(n + 1)
    wanted = error @ np.linalg.solve(covariance, error) * np.exp(np.linalg.slogdet(covariance)[1] / n)
    assert found.cost == pytest.approx(wanted, rel=1e-4)


TRUE = {"u": 1.0, "v": -2.0, "tanh(100 v)": -0.2}
SIGNATURE = Signature(("q", "v"), ("m", "m/s"), ("u",), (0.3, 0.2))


def axis(seed: int) -> Transitions:
    """A mass with friction that a controller moves to and fro; forces push it at random that nobody measures."""
    rng, dt, inner = np.random.default_rng(seed), 0.02, 10
    q = v = 0.0
    positions, inputs = [q], []
    for k in range(1000):
        aim = 0.25 * np.sin(0.9 * k * dt) + 0.1 * np.sin(2.3 * k * dt)
        u = 30 * (aim - q - 1e-4 * rng.normal()) - 2 * v
        force = 0.3 * rng.normal()
        for _ in range(inner):
            v += dt / inner * (TRUE["u"] * u + TRUE["v"] * v + TRUE["tanh(100 v)"] * np.tanh(100 * v) + force)
            q += dt / inner * v
        positions.append(q)
        inputs.append(u)
    y = np.full((1001, 2), np.nan)
    y[:, 0] = np.array(positions) + 1e-4 * rng.normal(size=1001)
    return Transitions.from_trajectory(torch.from_numpy(y), torch.tensor(inputs).unsqueeze(-1).double(), dt)


def fitted(data: Transitions, error: str) -> tuple[dict[str, float], str]:
    """The coefficients of v' by name, and what the report says."""
    model = SindyModel(
        SIGNATURE, [*TRUE], Regression("bic"), Refinement("trajectory", window=50, error=error), known={"q": "v"}
    )
    report = model.fit(data)
    return dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True)), report.to_text()


def wrong(found: dict[str, float]) -> float:
    return float(np.sqrt(np.mean([(found[name] / value - 1) ** 2 for name, value in TRUE.items()])))


@pytest.mark.slow
def test_of_an_axis_that_is_pushed_at_random_innovations_tell_more_than_a_simulation():
    errors: dict[str, list[float]] = {"simulation": [], "innovation": []}
    for seed in range(4):
        data = axis(seed)
        for error, found in errors.items():
            found.append(wrong(fitted(data, error)[0]))
    rms = {error: float(np.sqrt(np.mean(np.square(found)))) for error, found in errors.items()}
    # 0.07 and 0.15 in these four.
    assert rms["innovation"] < 0.7 * rms["simulation"] and rms["innovation"] < 0.1


def test_the_data_say_that_an_axis_is_pushed():
    found, told = fitted(axis(0), "auto")
    assert "error=prediction" in told and "pushes the plant" in told and wrong(found) < 0.2
