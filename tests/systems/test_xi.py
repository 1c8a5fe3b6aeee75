"""Oracle: the eigenvalues and equilibria that follow from the published table."""

import pytest
import torch

from dynasindy.systems import Xi


@pytest.mark.parametrize(
    ("pitch", "u1", "u2"), [(-0.5, -0.157, -0.131), (-0.25, -0.139, 0.044), (0, -0.122, 0.210), (0.4, -0.100, 0.432)]
)
def test_published_equilibria(pitch, u1, u2):
    x5 = (262.7 + 3.7e4 * u1) / 5.2281
    x6 = (-8.54 + 6.1e3 * u2) / 1.4193
    x = torch.tensor([0.3, pitch, 0, 0, x5, x6], dtype=torch.float64)
    dx = Xi()(x, torch.tensor([u1, u2], dtype=torch.float64))
    # The inputs are published to three digits, and the main rotor's gain on the pitch is 6.
    assert dx[2].abs() < 4e-3 and dx[3].abs() < 4e-3


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
