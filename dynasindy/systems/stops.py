"""Mechanical stops: a position is clamped and its outward rate is zeroed."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Stops:
    """Ends of travel of some positions of a system.

    Attributes:
        positions: Indices of the stopped positions in `x`.
        rates: Indices of their rates in `x`.
        low: Lower end of each position [unit of the position].
        high: Upper end of each position [unit of the position].

    Raises:
        ValueError: The lengths disagree or a lower end is not below its upper end.
    """

    positions: tuple[int, ...]
    rates: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        for field in ("positions", "rates", "low", "high"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        if not len(self.positions) == len(self.rates) == len(self.low) == len(self.high):
            raise ValueError(f"stops need one rate, low and high per position, got {self}; complete the lists")
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError(f"stops need low < high, got low={self.low}, high={self.high}; swap or widen them")

    def apply(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Hold states at the stops.

        The gradient of a stopped position and rate is zero, as the motion of the beam there is.

        Args:
            x: States, `(*batch, n_x)`.

        Returns:
            The states with positions clamped and outward rates zeroed, `(*batch, n_x)`, and whether any stop
            was touched, bool `(*batch,)`.
        """
        columns = list(x.unbind(-1))
        touched = torch.zeros_like(columns[0], dtype=torch.bool)
        for position, rate, low, high in zip(self.positions, self.rates, self.low, self.high, strict=True):
            below, above = columns[position] <= low, columns[position] >= high
            columns[position] = columns[position].clamp(low, high)
            outward = (below & (columns[rate] < 0)) | (above & (columns[rate] > 0))
            columns[rate] = columns[rate].masked_fill(outward, 0.0)
            touched = touched | below | above
        return torch.stack(columns, -1), touched
