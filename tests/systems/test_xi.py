"""Oracles: the published table, and the eigenvalues and equilibria that follow from it."""

import math

import pytest
import torch

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


# The paper's table "SINDY model Xi matrix": the rows that are not zero, a column per derivative.
TABLE = {
    "1": (0, 0, 0, 0.5961, 262.7, -8.54),
    "x3": (1, 0, -10.0573, 0, 0, 0),
    "x4": (0, 1, 0, -0.414, 0, 0),
    "x5": (0, 0, 0, 0, -5.2281, 0),
    "x6": (0, 0, 0, 0.0013, 0, -1.4193),
    "u1": (0, 0, 0, 0.1303, 3.7e4, 0),
    "u2": (0, 0, 0, 0, 0, 6.1e3),
    "x5 cos x2": (0, 0, 9.8316e-4, 0, 0, 0),
    "u2 cos x2": (0, 0, -0.7025, 0, 0, 0),
    "x3^2 sin x2": (0, 0, 0, -16.3547, 0, 0),
    "sin x2": (0, 0, 0, -3.54373, 0, 0),
    "cos x2": (0, 0, 0.9479, -1.7473, 0, 0),
}


@pytest.mark.parametrize(
    ("x", "u"),
    [([0.3, 0.7, -0.8, 0.5, 3000.0, -1500.0], [0.4, -0.6]), ([-0.2, -1.1, 0.6, -0.9, -7.0, 11.0], [-0.03, 0.02])],
)
def test_derivatives_are_the_sums_of_the_published_table(x, u):
    names = {f"x{i + 1}": value for i, value in enumerate(x)} | {"u1": u[0], "u2": u[1], "1": 1.0}
    names |= {"sin": math.sin(x[1]), "cos": math.cos(x[1]), "x3^2": x[2] ** 2}
    value = {term: math.prod(names[word] for word in term.split() if word != "x2") for term in TABLE}
    expected = [sum(row[k] * value[term] for term, row in TABLE.items()) for k in range(6)]
    dx = Xi()(torch.tensor(x, dtype=torch.float64), torch.tensor(u, dtype=torch.float64))
    assert dx.tolist() == pytest.approx(expected, rel=1e-12)
    assert sum(number != 0 for row in TABLE.values() for number in row) == 19
