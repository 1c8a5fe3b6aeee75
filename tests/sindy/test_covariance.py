"""The covariance of a fit is that of least squares where errors are independent, and of the scatter where they last."""

import numpy as np
import pytest
import torch

from dynasindy.sindy.covariance import Covariance, of_rates

XI = torch.tensor([[0.5, 0.0], [2.0, 1.0], [0.0, -3.0], [1.0, 0.0]], dtype=torch.float64)
FREE = torch.ones(4, 2, dtype=torch.bool)


def regression(n: int, seed: int, lasting: float = 0.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return functions that change slowly, two of them alike, rates with errors of size 0.1, and the fit."""
    rng = np.random.default_rng(seed)
    theta, errors = np.zeros((n, 4)), np.zeros((n, 2))
    for k in range(n):
        theta[k] = 0.8 * theta[k - 1] + 0.6 * rng.normal(size=4)
        errors[k] = lasting * errors[k - 1] + 0.1 * np.sqrt(1 - lasting**2) * rng.normal(size=2)
    theta[:, 1] += 3 * theta[:, 0]
    theta, errors = torch.from_numpy(theta), torch.from_numpy(errors)
    dx, found = theta @ XI + errors, torch.zeros(4, 2, dtype=torch.float64)
    for i in range(2):
        active = XI[:, i].nonzero().flatten()
        found[active, i] = torch.linalg.lstsq(theta[:, active], dx[:, i : i + 1]).solution.flatten()
    return theta, dx, found


@pytest.mark.parametrize("lasting", [0.0, 0.95])
def test_stretches_that_are_left_out_tell_the_scatter_over_seeds(lasting):
    fits, stated = [], []
    for seed in range(60):
        theta, dx, xi = regression(900, seed, lasting)
        fits.append(xi[XI != 0])
        known = of_rates(xi, FREE, theta, dx)
        stated.append(torch.zeros_like(xi).index_put((known.features, known.states), known.errors)[XI != 0])
    told = torch.stack(stated).square().mean(0).sqrt() / torch.stack(fits).std(0)
    assert ((told > 1 / 1.4) & (told < 1.4)).all()


def test_coefficients_of_all_equations_go_together_as_their_errors_do():
    theta, dx, _ = regression(900, 1)
    dx = torch.stack([dx[:, 0], -2 * dx[:, 0]], -1)  # the error of one equation is that of the other one, doubled
    found = of_rates(torch.linalg.lstsq(theta, dx).solution, FREE, theta, dx)
    matrix = found.factor @ found.factor.mT
    np.testing.assert_allclose(matrix[4:, :4], -2 * matrix[:4, :4], rtol=1e-6, atol=1e-12)
    assert float(matrix[0, 1] / (matrix[0, 0] * matrix[1, 1]).sqrt()) < -0.8  # functions that are alike replace another


def test_errors_are_told_as_shares_of_their_coefficients():
    factor = torch.tensor([[0.3, 0.0], [-0.2, 0.1]], dtype=torch.float64)
    known = Covariance(torch.tensor([0, 2]), torch.tensor([0, 1]), factor)
    assert known.shares(XI).tolist() == pytest.approx([0.6, np.sqrt(0.05) / 3])
