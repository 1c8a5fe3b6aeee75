"""Sums of harmonics: Schroeder phases (SPHS) and random phases (multisine)."""

from __future__ import annotations

import math
from typing import Unpack

import torch
from torch import Tensor

from dynasindy.excitation.base import Common, Excitation


class Sphs(Excitation):
    """Give the Schroeder-phased harmonic sequence, a flat spectrum of small peaks.

    `sqrt(2/K) sum_{i=1..K} cos(2 pi i t/T + theta_i)`, `theta_i = (2 pi/K) i(i+1)/2` (Schroeder 1970), T the duration,
    divided by its peak. Harmonic i belongs to input `i mod n_u`, so that the spectra of the inputs interleave and
    nothing of one input can be mistaken for another.

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        harmonics: number K of harmonics of each input.
        **common: amplitude, offset and seed, see `Excitation`.

    Raises:
        ValueError: there is no harmonic, or what `Excitation` raises.
    """

    def __init__(
        self,
        n_u: int,
        duration: float | None = 10.0,
        dt: float = 0.05,
        *,
        harmonics: int = 8,
        **common: Unpack[Common],
    ) -> None:
        super().__init__(n_u, duration, dt, **common)
        if harmonics < 1:
            raise ValueError(f"the signal got {harmonics} harmonics; allowed are 1 or more: 8 suits 10 s")
        self._check_size(min(self.dt, self.duration / 4096), harmonics)
        i = torch.arange(1, harmonics + 1, dtype=torch.float64)
        self.numbers = (i.unsqueeze(-1) - 1) * n_u + torch.arange(1, n_u + 1, dtype=torch.float64)
        self.phases = self._phases(i)
        self.peak = torch.ones(n_u, dtype=torch.float64)
        self.peak = self.wave(torch.linspace(0, self.duration, 4096, dtype=torch.float64)).abs().amax(0)

    def _phases(self, i: Tensor) -> Tensor:
        return (math.pi / len(i) * i * (i + 1)).unsqueeze(-1).expand(-1, self.n_u)

    def wave(self, t: Tensor) -> Tensor:
        """Give the sum of harmonics in [-1, 1] at times `(*batch,)` [s], `(*batch, n_u)`."""
        angle = 2 * math.pi / self.duration * self.numbers * t[..., None, None] + self.phases
        return math.sqrt(2 / len(self.phases)) * torch.cos(angle).sum(-2) / self.peak


class Multisine(Sphs):
    """Give the same harmonics with random phases, another signal for every seed."""

    def _phases(self, i: Tensor) -> Tensor:
        generator = torch.Generator().manual_seed(self.seed)
        return 2 * math.pi * torch.rand(len(i), self.n_u, generator=generator, dtype=torch.float64)
