"""How strong the inputs of imagined episodes are, around those that hold the plant at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Strength:
    """How strong the inputs of imagined episodes are.

    Attributes:
        factor: Of the inputs' distance from rest, `(rows, n_u)`.
        rest: Inputs at rest, `(rows, n_u)`; where references move, those at the start of the episode.
        limits: Least and largest input that acts, `(2, n_u)`, infinite where there is none; None for none at all.
        along: Inputs at rest, `(rows, n_u)`, of task parameters `(rows, n_r, 5)` at times `(rows, 1)` [s], where
            references move; None where none does.
    """

    factor: Tensor
    rest: Tensor
    limits: Tensor | None = None
    along: Callable[[Tensor, Tensor], Tensor] | None = None

    def at(self, params: Tensor, t: Tensor) -> Strength:
        """Return the same about what holds references with parameters `(rows, n_r, 5)` at times `(rows, 1)` [s]."""
        return self if self.along is None else replace(self, rest=self.along(params, t))

    def acting(self, u: Tensor) -> Tensor:
        """Return the inputs that act when `u` is commanded, `(rows, n_u)`."""
        stronger = torch.lerp(self.rest, u, self.factor)
        return stronger if self.limits is None else stronger.clamp(self.limits[0], self.limits[1])

    def slope(self, acting: Tensor) -> Tensor:
        """Return the derivative of the inputs that acted by those commanded, each by its own, `(*batch, rows, n_u)`.

        Args:
            acting: What `acting` returned, `(*batch, rows, n_u)`.
        """
        if self.limits is None:
            return self.factor
        return self.factor * ((acting > self.limits[0]) & (acting < self.limits[1]))

    def where(self, new: Tensor, fresh: Strength) -> Strength:
        """Return the strengths with those of the rows that are new, bool `(rows,)`, taken from others."""
        mask = new.unsqueeze(-1)
        factor, rest = (
            torch.where(mask, theirs, mine) for theirs, mine in ((fresh.factor, self.factor), (fresh.rest, self.rest))
        )
        return replace(self, factor=factor, rest=rest, along=self.along or fresh.along)
