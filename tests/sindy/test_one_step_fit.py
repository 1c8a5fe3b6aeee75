"""The one-step fit of a linear plant is the least-squares fit of its exact discrete form, noise and all."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from dynasindy.sindy import Refinement, shooting
from dynasindy.sindy.library import CONSTANT, Constraints, Library, variable
from dynasindy.sindy.reconstruction import RegressionData
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = Library(SIGNATURE, [variable("y"), variable("u"), CONSTANT, variable("y", 2)])
A, B, DT = -2.0, 3.0, 0.05


def refined(xi, free, data, tolerance):
    """What single steps tell, from a first model on."""
    constraints = Constraints(free, torch.where(free, 0.0, xi))
    return Refinement("one_step", rounds=0, tolerance=tolerance).run(
        (LIBRARY, xi), constraints, RegressionData.of(data, {})
    )


def recording(noise: float = 0.0, n: int = 400, seed: int = 0) -> Transitions:
    """y' = A y + B u in discrete form y+ = phi y + gamma u + noise."""
    generator = np.random.default_rng(seed)
    phi = math.exp(A * DT)
    u, y = generator.uniform(-1, 1, n), [0.3]
    for held, e in zip(u, noise * generator.normal(size=n)):
        y.append(phi * y[-1] + B * (phi - 1) / A * held + e)
    return Transitions.from_trajectory(torch.tensor(y).double().unsqueeze(-1), torch.from_numpy(u).unsqueeze(-1), DT)


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64).unsqueeze(-1)


FREE = torch.ones(4, 1, dtype=torch.bool)


def test_the_part_of_the_changes_that_steps_miss_is_that_of_the_closed_form():
    """y' = a y changes y by (exp(a dt) - 1) y over a step; the best a is that of the regression of all steps."""
    x = torch.tensor([[0.3], [-1.0], [2.0]], dtype=torch.float64)
    after = math.exp(A * DT) * x + torch.tensor([[0.01], [0.0], [0.0]])
    moved = Transitions(x, 0 * x, after, DT, torch.zeros(3, dtype=torch.long))
    phi = float((x * after).sum() / x.square().sum())
    wanted = float((after - phi * x).norm() / (after - x).norm())
    found = refined(column(A, 0.0, 0.0, 0.0), torch.tensor([[True], [False], [False], [False]]), moved, 1e-9)
    assert found.missed == {"y": pytest.approx(wanted, rel=1e-6)}


def test_from_a_poor_first_model_the_plant_is_found_to_nine_digits():
    found = refined(column(-1.0, 2.0, 0.5, 0.2), FREE, recording(), 1e-9).coefficients
    assert found[2:].flatten().tolist() == [0.0, 0.0]
    assert found[:2].flatten().tolist() == pytest.approx([A, B], rel=1e-8)


def test_with_process_noise_it_is_the_least_squares_fit_of_the_discrete_form():
    data = recording(0.05)
    rows = torch.cat([data.x, data.u], -1).numpy()
    phi, gamma = np.linalg.lstsq(rows, data.x_next.numpy().ravel(), rcond=None)[0]
    a = math.log(phi) / DT
    found = refined(column(A, B, 0.0, 0.0), torch.tensor([[True], [True], [False], [False]]), data, 1e-9).coefficients
    assert found[:2].flatten().tolist() == pytest.approx([a, gamma * a / (phi - 1)], rel=1e-6)
    assert abs(a - A) > 1e-3  # the noise does move the estimate


def test_a_recording_is_fitted_block_by_block_as_it_is_at_once(monkeypatch):
    data, xi = recording(0.05), column(-1.0, 2.0, 0.0, 0.0)
    whole = refined(xi, FREE, data, 1e-9)
    monkeypatch.setattr(shooting, "MOST_SLOPES", 40)
    monkeypatch.setattr(shooting, "CHUNK", 40)
    found = refined(xi, FREE, data, 1e-9)
    torch.testing.assert_close(found.coefficients, whole.coefficients, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.covariance.factor, whole.covariance.factor, rtol=1e-6, atol=1e-9)


def test_coefficients_that_are_not_free_stay():
    free = torch.tensor([[True], [False], [False], [False]])
    found = refined(column(-1.0, 2.5, 0.0, 0.0), free, recording(), 1e-6).coefficients
    assert found[1, 0] == 2.5 and found[2:].flatten().tolist() == [0.0, 0.0]

    def errors(a):
        phi, data = math.exp(a[0] * DT), recording()
        return (phi * data.x + 2.5 * (phi - 1) / a[0] * data.u - data.x_next).numpy().ravel()

    assert found[0, 0].item() == pytest.approx(least_squares(errors, [-1.0], xtol=1e-12, ftol=1e-12).x[0], rel=1e-5)


def test_standard_errors_are_those_of_the_discrete_form_and_of_the_scatter():
    """phi and gamma are a linear regression; a = log(phi) / dt and b = a gamma / (phi - 1) follow by their slopes."""
    fits, stated, support = [], [], torch.tensor([[True], [True], [False], [False]])
    for seed in range(40):
        data = recording(0.02, 400, seed)
        found = refined(column(A, B, 0.0, 0.0), support, data, 1e-9)
        known = found.covariance
        assert (known.features.tolist(), known.states.tolist()) == ([0, 1], [0, 0])
        fits.append(found.coefficients[:2, 0])
        stated.append(known.errors)
    rows = torch.cat([data.x, data.u], -1).numpy()
    phi, gamma = math.exp(A * DT), B * (math.exp(A * DT) - 1) / A
    slope = np.array([[1 / (phi * DT), 0.0], [0.0, A / (phi - 1)]])
    slope[1, 0] = gamma * (1 / (phi * DT) / (phi - 1) - A / (phi - 1) ** 2)
    closed = np.sqrt(np.diag(slope @ (0.02**2 * np.linalg.inv(rows.T @ rows)) @ slope.T))
    told = torch.stack(stated).square().mean(0).sqrt()
    np.testing.assert_allclose(told, closed, rtol=0.25)
    np.testing.assert_allclose(told, torch.stack(fits).std(0), rtol=0.35)
