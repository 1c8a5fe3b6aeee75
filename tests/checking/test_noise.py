"""The spread of the inputs is the closed form, and that of a long simulation."""

import warnings

import numpy as np
import pytest
import torch

from dynasindy.checking.linear_loop import Linear, find_rest, noise_gain


def test_a_first_order_loop_has_the_spread_of_paper():
    # x+ = a x - b n, u = -k x - k n with a = 1 - 0.4, b = 0.4, k = 4: var x = b^2 / (1 - a^2).
    linear = Linear(*(np.array([[v]]) for v in (0.6, 0.1, -4.0, -0.4, -4.0)), 0.1)
    expected = 4 * np.sqrt(1 + 0.4**2 / (1 - 0.6**2))
    assert noise_gain(linear).item() == pytest.approx(expected)


def test_a_long_flight_under_noise_spreads_as_much(loops):
    loop = loops(observer={"delay": 1})
    held = find_rest(loop, torch.zeros(1, 1))
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


def test_states_in_other_units_give_the_same_spread_without_a_warning():
    rng = np.random.default_rng(0)
    a, units = rng.normal(size=(6, 6)), 10.0 ** np.array([0, 0, 1, 2, 5, 6])
    a *= 0.9 / np.abs(np.linalg.eigvals(a)).max()
    b, c, e, f = (rng.normal(size=size) for size in ((6, 2), (2, 6), (6, 6), (2, 6)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gain = noise_gain(Linear(a, b, c, e, f, 0.1))
        scaled = noise_gain(
            Linear(units[:, None] * a / units, units[:, None] * b, c / units, units[:, None] * e, f, 0.1)
        )
    np.testing.assert_allclose(scaled, gain, rtol=1e-6)
    # The sum over time of what a unit impulse of each measurement does to the inputs.
    impulse, total = e.copy(), f**2
    for _ in range(2000):
        total, impulse = total + (c @ impulse) ** 2, a @ impulse
    np.testing.assert_allclose(gain, np.sqrt(total), rtol=1e-6)


def test_a_loop_that_is_not_stable_has_none():
    with pytest.raises(ValueError, match="no steady spread"):
        noise_gain(Linear(*(np.array([[v]]) for v in (1.1, 0.1, -4.0, -0.4, -4.0)), 0.1))
