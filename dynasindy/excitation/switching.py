"""Signals that hold a level and jump: random steps and pseudo-random binary sequences."""

from __future__ import annotations

from abc import abstractmethod
from typing import Unpack

import torch
from torch import Tensor

from dynasindy.excitation.base import Common, Excitation

HELD = 10
"""Control periods for which a level is held where no time is given."""


class _Switching(Excitation):
    """Hold random levels; each input jumps at its own times.

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        hold: time for which a level is held [s]; None is ten control periods.
        **common: amplitude, offset and seed, see `Excitation`.

    Raises:
        ValueError: the hold is not positive, or what `Excitation` raises.
    """

    def __init__(
        self,
        n_u: int,
        duration: float | None = 10.0,
        dt: float = 0.05,
        *,
        hold: float | None = 0.5,
        **common: Unpack[Common],
    ) -> None:
        super().__init__(n_u, duration, dt, **common)
        hold = HELD * dt if hold is None else hold
        if not hold > 0:
            raise ValueError(f"excitation got hold {hold} s; allowed is a positive time: 0.5 s suits the twin rotor")
        self.hold = float(hold)
        self._check_size(self.hold, 1)
        generator = torch.Generator().manual_seed(self.seed)
        self.levels = self._levels(int(self.duration / self.hold) + 3, generator)

    @abstractmethod
    def _levels(self, n: int, generator: torch.Generator) -> Tensor:
        """Draw levels in [-1, 1], `(n, n_u)`."""

    def wave(self, t: Tensor) -> Tensor:
        """Give the held levels at times `(*batch,)` [s], `(*batch, n_u)`; after the end they start again."""
        shift = torch.arange(self.n_u, dtype=torch.float64) / self.n_u
        # The small part of a hold keeps times that are multiples of it on one side of the jump.
        place = (t.unsqueeze(-1) / self.hold + shift + 1e-9).floor().long() % len(self.levels)
        return self.levels.gather(0, place.reshape(-1, self.n_u)).reshape(*t.shape, self.n_u)


class Aprbs(_Switching):
    """Hold uniformly random levels (amplitude-modulated pseudo-random binary sequence)."""

    def _levels(self, n: int, generator: torch.Generator) -> Tensor:
        return 2 * torch.rand(n, self.n_u, generator=generator, dtype=torch.float64) - 1


class Prbs(_Switching):
    """Switch at random between the two ends of the range (pseudo-random binary sequence)."""

    def _levels(self, n: int, generator: torch.Generator) -> Tensor:
        return 2.0 * torch.randint(0, 2, (n, self.n_u), generator=generator).to(torch.float64) - 1
