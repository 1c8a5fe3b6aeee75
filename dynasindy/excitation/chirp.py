"""Frequency sweeps: the chirp that the paper means, and the one that it prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Unpack

import torch
from torch import Tensor

from dynasindy.excitation.base import Common, Excitation

TURNS = 0.05
"""Highest frequency of a sweep without a band, in turns per control period."""


class Chirp(Excitation):
    """Sweep the frequency linearly, differently on each input.

    One input: `cos(2 pi (start t + (stop - start) t^2 / (2 T)))`, T the duration; start 0, stop 1 Hz is
    `cos(pi t^2 / T)`. The same sweep on all inputs would leave them indistinguishable, so the inputs
    differ in phase by a quarter turn, and every second one sweeps to 0.7 of the last frequency.

    Departure: the paper prints `cos(pi t/T (1 - t/T))`, which stays within [0.707, 1] and does not sweep; see
    `PrintedChirp`.

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        band: frequency at the beginning and at the end [Hz]; None ends at a twentieth of the control rate.
        **common: amplitude, offset and seed, see `Excitation`.

    Raises:
        ValueError: a frequency is negative, or what `Excitation` raises.
    """

    def __init__(
        self,
        n_u: int,
        duration: float | None = 10.0,
        dt: float = 0.05,
        *,
        band: Sequence[float] | None = (0.0, 1.0),
        **common: Unpack[Common],
    ) -> None:
        super().__init__(n_u, duration, dt, **common)
        band = (0.0, TURNS / dt) if band is None else band
        if len(band) != 2 or min(band) < 0:
            raise ValueError(f"chirp got the band {list(band)} Hz; allowed are two frequencies of 0 or more: from, to")
        self.start = float(band[0])
        self.stop = torch.tensor([band[1] * (1.0 if i % 2 == 0 else 0.7) for i in range(n_u)], dtype=torch.float64)
        self.phase = torch.tensor([(i - 1) * math.pi / 2 for i in range(n_u)], dtype=torch.float64)

    def wave(self, t: Tensor) -> Tensor:
        """Give the sweep in [-1, 1] at times `(*batch,)` [s], `(*batch, n_u)`."""
        t = t.unsqueeze(-1)
        turns = self.start * t + (self.stop - self.start) * t**2 / (2 * self.duration)
        return torch.cos(2 * math.pi * turns + self.phase)


class SquaredChirp(Chirp):
    """Give `0.5 chirp^2`, the form in the paper's source text: never negative, for rotors that turn one way."""

    def wave(self, t: Tensor) -> Tensor:
        """Give the squared sweep in [0, 0.5] at times `(*batch,)` [s], `(*batch, n_u)`."""
        return 0.5 * super().wave(t) ** 2


class PrintedChirp(Excitation):
    """Give the signal as the paper prints it, eq. (chirp): `cos(pi t/T (1 - t/T))`, the same on all inputs.

    It falls from 1 to 0.707 and returns: no sweep, and inputs that cannot be told apart. It is kept to show what
    the printed formula would identify.
    """

    def wave(self, t: Tensor) -> Tensor:
        """Give the printed signal at times `(*batch,)` [s], `(*batch, n_u)`."""
        share = (t / self.duration).unsqueeze(-1)
        return torch.cos(math.pi * share * (1 - share)).expand(*t.shape, self.n_u)
