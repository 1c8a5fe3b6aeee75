"""Oracles: the published table, and the eigenvalues and equilibria that follow from it."""

import math

import pytest
import torch
from published import TABLE

from dynasindy.systems import Xi


def test_eigenvalues_at_hover():
    x = torch.tensor([0, 0, 0, 0, -813.6, 896.5], dtype=torch.float64)
    jacobian = torch.autograd.functional.jacobian(lambda x: Xi()(x, torch.tensor([-0.122, 0.210]).double()), x)
    values = torch.linalg.eigvals(jacobian)
    expected = torch.tensor([0, -10.06, -5.23, -1.42, -0.207 + 1.871j, -0.207 - 1.871j], dtype=torch.complex128)
    for value in expected:
        assert (values - value).abs().min() < 0.01


def test_free_azimuth_drifts_as_published():
    # u = 0: pitch settles near -0.298 rad and the azimuth drifts at +0.095 rad/s.
    x = torch.tensor([0, -0.298, 0.0947, 0, 262.7 / 5.2281, -8.54 / 1.4193], dtype=torch.float64)
    dx = Xi()(x, torch.zeros(2, dtype=torch.float64))
    assert dx[2].abs() < 0.02 and dx[3].abs() < 0.02


@pytest.mark.parametrize(
    ("x", "u"),
    [([0.3, 0.7, -0.8, 0.5, 3000.0, -1500.0], [0.4, -0.6]), ([-0.2, -1.1, 0.6, -0.9, -7.0, 11.0], [-0.03, 0.02])],
)
def test_derivatives_are_the_sums_of_the_published_table(x, u):
    names = ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p", "u_a", "u_p")
    scope = {"sin": math.sin, "cos": math.cos, **dict(zip(names, x + u, strict=True))}
    value = {term: eval(term.replace(" ", " * ").replace("^", "**"), scope) for term in TABLE}
    expected = [sum(row[k] * value[term] for term, row in TABLE.items()) for k in range(6)]
    dx = Xi()(torch.tensor(x, dtype=torch.float64), torch.tensor(u, dtype=torch.float64))
    assert dx.tolist() == pytest.approx(expected, rel=1e-12)
    assert sum(number != 0 for row in TABLE.values() for number in row) == 19
