"""Errors that last: what a model leaves over of a real plant follows on what it left over a sample before.

Least squares of a trajectory are maximum likelihood where errors are white. Those of a real plant last, because every
model lacks something, and a stretch of a thousand samples with one slow error then outweighs all quick ones. If an
error is `rho` times the one a sample before and something new, what is new is white, and its least squares are maximum
likelihood (Cochrane and Orcutt 1949). Of a stretch it holds how the states change as well as where they are.
"""

from __future__ import annotations

import torch
from torch import Tensor


def news(rows: Tensor, seen: Tensor, joined: Tensor, rho: Tensor) -> Tensor:
    """Return what errors, or their slopes, hold that did not follow from the sample before, `(W, L, n_x, C)`.

    A sample without a measured one before it counts by its own size, as one of a process that has run for long.

    Args:
        rows: errors and slopes, `(W, L, n_x, C)`; zero where not measured.
        seen: 1 where a state was measured, else 0, `(W, L, n_x)`.
        joined: whether a window continues the one before, bool `(W,)`.
        rho: part of an error that is left a sample later, `(n_x,)`.
    """
    before, follows = _before(rows, seen, joined)
    part = rho.unsqueeze(-1)
    return torch.where(follows.unsqueeze(-1), rows - part * before, rows * (1 - part.square()).sqrt())


def remaining(error: Tensor, seen: Tensor, joined: Tensor) -> Tensor:
    """Estimate which part of an error is left a sample later, `(n_x,)`, 0 or more and below 1.

    Args:
        error: what a model leaves over, `(W, L, n_x)`.
        seen: 1 where a state was measured, else 0, `(W, L, n_x)`.
        joined: whether a window continues the one before, bool `(W,)`.
    """
    before, follows = _before((error * seen).unsqueeze(-1), seen, joined)
    last, now = before.squeeze(-1) * follows, error * follows
    count = seen.sum((0, 1)).clamp_min(2)
    # An error that lasts as long as the recording cannot be told from one that stays for ever.
    part = (now * last).sum((0, 1)) / last.square().sum((0, 1)).clamp_min(1e-300)
    return torch.minimum(part.clamp_min(0.0), 1 - 1 / count)


def _before(rows: Tensor, seen: Tensor, joined: Tensor) -> tuple[Tensor, Tensor]:
    """Return the rows of the sample before, and whether it and the sample were measured, bool `(W, L, n_x)`."""
    flat, known = rows.flatten(0, 1), seen.flatten(0, 1) > 0
    before, follows = flat.roll(1, 0), known & known.roll(1, 0)
    begins = torch.zeros(seen.shape[:2], dtype=torch.bool)
    begins[:, 0] = ~joined
    follows = follows & ~begins.flatten().unsqueeze(-1)
    return before.view_as(rows), follows.view_as(seen)
