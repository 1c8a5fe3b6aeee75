"""The spread of the inputs is the closed form, and that of a long simulation."""

import numpy as np
import pytest
import torch

from dynasindy.checking.linear import Linear, rest
from dynasindy.checking.noise import noise_gain


def test_a_first_order_loop_has_the_spread_of_paper():
    # x+ = a x - b n, u = -k x - k n with a = 1 - 0.4, b = 0.4, k = 4: var x = b^2 / (1 - a^2).
    linear = Linear(*(np.array([[v]]) for v in (0.6, 0.1, -4.0, -0.4, -4.0)), 0.1)
    expected = 4 * np.sqrt(1 + 0.4**2 / (1 - 0.6**2))
    assert noise_gain(linear).item() == pytest.approx(expected)


def test_a_long_flight_under_noise_spreads_as_much(loops):
    loop = loops(observer={"delay": 1})
    held = rest(loop, torch.zeros(1, 1))
    gain = noise_gain(held.linear.row(0))
    assert gain[0, 1] == 0  # the rate is not measured
    generator = torch.Generator().manual_seed(2)
    z, covariance = held.z.expand(400, -1), held.covariance.expand(400, -1, -1)
    inputs = []
    for k in range(220):
        noise = torch.randn(400, 2, generator=generator, dtype=torch.float64) * torch.tensor([0.01, 0.5])
        z, covariance, u = loop.step(z, covariance, torch.zeros(400, 1), noise=noise)
        inputs += [u] if k >= 100 else []
    assert torch.stack(inputs).std().item() == pytest.approx(0.01 * gain[0, 0], rel=0.03)


def test_a_loop_that_is_not_stable_has_none():
    with pytest.raises(ValueError, match="no steady spread"):
        noise_gain(Linear(*(np.array([[v]]) for v in (1.1, 0.1, -4.0, -0.4, -4.0)), 0.1))
