"""Signals that excite a plant: chirps, sums of sines, and levels that are held and jump."""

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

    Departure: the paper prints `cos(pi t/T (1 - t/T))`, which stays within [0.707, 1] and does not sweep.

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        band: frequency at the beginning and at the end [Hz]; None ends at a twentieth of the control rate.
        **common: amplitude, offset and seed, see `Excitation`.

    Raises:
        ValueError: a frequency is negative or above half of the control rate, or what `Excitation` raises.
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
        if max(band) > 0.5 / dt:
            raise ValueError(
                f"excitation.band is {list(band)} Hz; allowed is up to half of the control rate, {0.5 / dt:g} Hz, "
                "beyond which an input that is held for a period is another signal: lower it, or env.dt"
            )
        self.start = float(band[0])
        self.stop = torch.tensor([band[1] * (1.0 if i % 2 == 0 else 0.7) for i in range(n_u)], dtype=torch.float64)
        self.phase = torch.tensor([(i - 1) * math.pi / 2 for i in range(n_u)], dtype=torch.float64)

    def wave(self, t: Tensor) -> Tensor:
        """Give the sweep in [-1, 1] at times `(*batch,)` [s], `(*batch, n_u)`."""
        t = t.unsqueeze(-1)
        turns = self.start * t + (self.stop - self.start) * t**2 / (2 * self.duration)
        return torch.cos(2 * math.pi * turns + self.phase)


class Multisine(Excitation):
    """Give harmonics with random phases, another signal for every seed.

    `sqrt(2/K) sum_{i=1..K} cos(2 pi i t/T + theta_i)`, T the duration, divided by its peak. Harmonic i belongs to input
    `i mod n_u`, so that the spectra of the inputs interleave and nothing of one input can be mistaken for another.

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
        generator = torch.Generator().manual_seed(self.seed)
        self.phases = 2 * math.pi * torch.rand(harmonics, n_u, generator=generator, dtype=torch.float64)
        self.peak = torch.ones(n_u, dtype=torch.float64)
        self.peak = self.wave(torch.linspace(0, self.duration, 4096, dtype=torch.float64)).abs().amax(0)

    def wave(self, t: Tensor) -> Tensor:
        """Give the sum of harmonics in [-1, 1] at times `(*batch,)` [s], `(*batch, n_u)`."""
        angle = 2 * math.pi / self.duration * self.numbers * t[..., None, None] + self.phases
        return math.sqrt(2 / len(self.phases)) * torch.cos(angle).sum(-2) / self.peak


HELD = 10
"""Control periods for which a level is held where no time is given."""


class Aprbs(Excitation):
    """Hold uniformly random levels, each input on its own (amplitude-modulated pseudo-random binary sequence).

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        hold: time for which a level is held [s]; None is ten control periods.
        **common: amplitude, offset and seed, see `Excitation`.
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
        own, hold = hold, HELD * dt if hold is None else hold
        if not hold > 0:
            raise ValueError(f"excitation got hold {hold} s; allowed is a positive time: 0.5 s suits the twin rotor")
        if own is not None and hold > self.duration:
            raise ValueError(
                f"excitation.hold is {hold:g} s; allowed is up to the whole experiment, excitation.duration="
                f"{self.duration:g} s: shorten it, for one level identifies nothing"
            )
        self.hold = float(hold)
        self._check_size(self.hold, 1)
        generator = torch.Generator().manual_seed(self.seed)
        count = int(self.duration / self.hold) + 3
        self.levels = 2 * torch.rand(count, n_u, generator=generator, dtype=torch.float64) - 1

    def wave(self, t: Tensor) -> Tensor:
        """Give the held levels at times `(*batch,)` [s], `(*batch, n_u)`; after the end they start again."""
        shift = torch.arange(self.n_u, dtype=torch.float64) / self.n_u
        # The small part of a hold keeps times that are multiples of it on one side of the jump.
        place = (t.unsqueeze(-1) / self.hold + shift + 1e-9).floor().long() % len(self.levels)
        return self.levels.gather(0, place.reshape(-1, self.n_u)).reshape(*t.shape, self.n_u)
