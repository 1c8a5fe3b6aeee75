"""How strong the inputs of imagined episodes are, around those that hold the plant at rest."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Strength:
    """How strong the inputs of imagined episodes are.

    Attributes:
        factor: Of the inputs' distance from rest, `(rows, n_u)`.
        rest: Inputs at rest, `(rows, n_u)`.
    """

    factor: Tensor
    rest: Tensor

    def acting(self, u: Tensor) -> Tensor:
        """Return the inputs that act when `u` is commanded, `(rows, n_u)`."""
        return torch.lerp(self.rest, u, self.factor)

    def where(self, new: Tensor, fresh: Strength) -> Strength:
        """Return the strengths with those of the rows that are new, bool `(rows,)`, taken from others."""
        mask = new.unsqueeze(-1)
        return Strength(torch.where(mask, fresh.factor, self.factor), torch.where(mask, fresh.rest, self.rest))
