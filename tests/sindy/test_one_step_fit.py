"""The one-step fit of a linear plant is the least-squares fit of its exact discrete form, noise and all."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from dynasindy.sindy import one_step_fit
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.sindy.one_step_fit import one_step_covariance, one_step_errors, refine_one_step
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("y",), ("-",), ("u",), (1.0,))
LIBRARY = Library(SIGNATURE, [variable("y"), variable("u"), CONSTANT, variable("y", 2)])
A, B, DT = -2.0, 3.0, 0.05


def coefficients_of(refine, *args):
    """Coefficients that a refinement finds; the library comes back as it was."""
    return refine(*args)[1]


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
    """y' = A y changes y by (exp(A dt) - 1) y over a step."""
    x = torch.tensor([[0.3], [-1.0], [2.0]], dtype=torch.float64)
    moved = Transitions(x, 0 * x, math.exp(A * DT) * x, DT, torch.zeros(3, dtype=torch.long))
    wanted = (math.exp(1.1 * A * DT) - math.exp(A * DT)) / (math.exp(A * DT) - 1)
    assert one_step_errors(LIBRARY, column(1.1 * A, 0.0, 0.0, 0.0), moved) == {"y": pytest.approx(wanted, rel=1e-6)}
    assert one_step_errors(LIBRARY, column(A, 0.0, 0.0, 0.0), moved)["y"] < 1e-8


def test_from_a_poor_first_model_the_plant_is_found_to_nine_digits():
    found = coefficients_of(refine_one_step, LIBRARY, column(-1.0, 2.0, 0.5, 0.2), FREE, recording(), 1e-9)
    assert found[2:].flatten().tolist() == [0.0, 0.0]
    assert found[:2].flatten().tolist() == pytest.approx([A, B], rel=1e-8)


def test_with_process_noise_it_is_the_least_squares_fit_of_the_discrete_form():
    data = recording(0.05)
    rows = torch.cat([data.x, data.u], -1).numpy()
    phi, gamma = np.linalg.lstsq(rows, data.x_next.numpy().ravel(), rcond=None)[0]
    a = math.log(phi) / DT
    found = coefficients_of(
        refine_one_step, LIBRARY, column(A, B, 0.0, 0.0), torch.tensor([[True], [True], [False], [False]]), data, 1e-9
    )
    assert found[:2].flatten().tolist() == pytest.approx([a, gamma * a / (phi - 1)], rel=1e-6)
    assert abs(a - A) > 1e-3  # the noise does move the estimate


def test_a_recording_is_fitted_block_by_block_as_it_is_at_once(monkeypatch):
    data, xi = recording(0.05), column(-1.0, 2.0, 0.0, 0.0)
    whole = refine_one_step(LIBRARY, xi, FREE, data, 1e-9)[1], one_step_covariance(LIBRARY, xi, FREE, data, 1e-9)
    monkeypatch.setattr(one_step_fit, "CHUNK", 40)
    found, known = refine_one_step(LIBRARY, xi, FREE, data, 1e-9)[1], one_step_covariance(LIBRARY, xi, FREE, data, 1e-9)
    torch.testing.assert_close(found, whole[0], rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(known.factor, whole[1].factor, rtol=1e-6, atol=1e-9)


def test_coefficients_that_are_not_free_stay():
    free = torch.tensor([[True], [False], [False], [False]])
    found = coefficients_of(refine_one_step, LIBRARY, column(-1.0, 2.5, 0.0, 0.0), free, recording(), 1e-6)
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
        library, xi = refine_one_step(LIBRARY, column(A, B, 0.0, 0.0), support, data, 1e-9)
        known = one_step_covariance(library, xi, support, data, 1e-9)
        assert (known.features.tolist(), known.states.tolist()) == ([0, 1], [0, 0])
        fits.append(xi[:2, 0])
        stated.append(known.errors)
    rows = torch.cat([data.x, data.u], -1).numpy()
    phi, gamma = math.exp(A * DT), B * (math.exp(A * DT) - 1) / A
    slope = np.array([[1 / (phi * DT), 0.0], [0.0, A / (phi - 1)]])
    slope[1, 0] = gamma * (1 / (phi * DT) / (phi - 1) - A / (phi - 1) ** 2)
    closed = np.sqrt(np.diag(slope @ (0.02**2 * np.linalg.inv(rows.T @ rows)) @ slope.T))
    told = torch.stack(stated).square().mean(0).sqrt()
    np.testing.assert_allclose(told, closed, rtol=0.25)
    np.testing.assert_allclose(told, torch.stack(fits).std(0), rtol=0.35)
