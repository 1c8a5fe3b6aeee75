"""How many samples of what a model leaves over stand for one witness."""

import pytest
import torch

from dynasindy.sindy.noise import repetition


def _autoregressive(n: int, a: float) -> torch.Tensor:
    noise, values = torch.randn(n, generator=torch.Generator().manual_seed(0), dtype=torch.float64), []
    last = torch.zeros((), dtype=torch.float64)
    for e in noise:
        last = a * last + e
        values.append(last)
    return torch.stack(values)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_noise_that_remembers_repeats_itself_as_often_as_theory_says(a):
    # The correlations of an autoregressive process are a^k, and 1 + 2 sum a^k = (1 + a) / (1 - a).
    error = _autoregressive(40_000, a).reshape(400, 100, 1)
    joined = torch.arange(400) > 0
    assert repetition(error, torch.ones_like(error), joined) == pytest.approx((1 + a) / (1 - a), rel=0.15)


def test_windows_on_their_own_are_not_read_across_their_borders():
    # In every window another constant: its four samples say the same, and its neighbours something else.
    error = torch.randn(500, 1, 1, generator=torch.Generator().manual_seed(1)).double().expand(500, 4, 1)
    alone = repetition(error, torch.ones_like(error), torch.zeros(500, dtype=torch.bool))
    assert alone == pytest.approx(4)


def test_samples_that_were_not_measured_witness_nothing():
    error = _autoregressive(40_000, 0.5).reshape(1, 40_000, 1)
    mask = torch.ones_like(error)
    mask[:, 1::2] = 0
    # Every other sample is left, and their correlations are 0.25^k.
    assert repetition(error, mask, torch.tensor([False])) == pytest.approx(1.25 / 0.75, rel=0.15)
    assert repetition(error, torch.zeros_like(error), torch.tensor([False])) == 1


def test_alternating_errors_count_in_full():
    error = torch.tensor([1.0, -1.0]).double().repeat(50).reshape(1, 100, 1)
    assert repetition(error, torch.ones_like(error), torch.tensor([False])) == 1
