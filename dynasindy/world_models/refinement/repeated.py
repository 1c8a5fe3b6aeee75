"""How many samples of what a model leaves over repeat one another: the noise of a sensor repeats nothing.

A criterion for white noise counts every sample as a witness of its own. What a model leaves over that is never quite
right lasts over many samples, and they all witness the same: a function would be let in for an error that it happens to
resemble once. The number of witnesses is that of the samples over 1 + 2 sum r_k, r_k being the sum of products of
samples that lie k apart, over the sum of their squares (Bayley and Hammersley 1946).
"""

from __future__ import annotations

import torch
from torch import Tensor


def repetition(error: Tensor, mask: Tensor, joined: Tensor) -> float:
    """Return how many samples stand for one witness, 1 or more; correlations count until the first that is negative.

    Args:
        error: what a model leaves over in windows, `(W, L, n_x)`.
        mask: 1 where a state was measured, else 0, `(W, L, n_x)`.
        joined: whether a window continues the one before, bool `(W,)`.
    """
    chains = _chains(error * mask, joined)
    length = chains.shape[1]
    products = torch.fft.irfft(torch.fft.rfft(chains, 2 * length, dim=1).abs().square().sum(0), 2 * length, 0)[:length]
    counts = mask.sum((0, 1))
    seen = (products[0] > 0) & (counts > 0)
    if not bool(seen.any()):
        return 1.0
    # Of samples with nothing measured k later the product is zero but for rounding: they end no sum.
    rho = (products / products[0].clamp_min(1e-300))[:, seen]
    before = (rho > -1e-9).cumprod(0)
    samples = (2 * (rho * before).sum(0) - 1).clamp_min(1.0)
    return float(counts[seen].sum() / (counts[seen] / samples).sum())


def _chains(values: Tensor, joined: Tensor) -> Tensor:
    """Lay windows that continue one another end to end, zeros behind the shorter ones, `(C, T, n_x)`."""
    starts = [*(~joined).nonzero().flatten().tolist(), len(joined)]
    chains = [values[a:b].flatten(0, 1) for a, b in zip(starts[:-1], starts[1:], strict=True)]
    return torch.nn.utils.rnn.pad_sequence(chains, batch_first=True)
