"""Signals that excite a plant: chirps, sums of sines, and levels that are held and jump."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, TypedDict, Unpack

import torch
from pydantic import Field, SkipValidation
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dynasindy.safe_io import checked
from dynasindy.sentences import setting

Levels = Annotated[float | Sequence[float], SkipValidation]  # arrays, too
Share = Annotated[float, Field(gt=0, le=1)]


class _Common(TypedDict, total=False):
    """Settings that subclasses pass on, by name; see `Excitation`."""

    duration: float | None
    dt: float
    amplitude: Levels
    offset: Levels
    seed: int
    first: Share


class Excitation(TensorDictModuleBase, ABC):
    """Give inputs over time: `offset + amplitude * wave(t)`, clipped to [-1, 1].

    As a policy it reads `step_count` and writes `action`; the input is held for one control period.

    Args:
        n_u: number of inputs.
        duration: length of the experiment [s]; None is 200 control periods.
        dt: control period [s].
        amplitude: half range of each input, or one for all [normalised].
        offset: mean of each input, or one for all: the input that holds the plant where it is to be excited.
        seed: seed of what is random in the signal, if anything is.
        first: share of the amplitude with which the plant is moved at first, in (0, 1]; it doubles every ten control
            periods until it is whole. Less than 1 also says that nobody knows whether the plant stays by itself.

    Raises:
        ValueError: a time or the number of inputs is not positive, amplitudes or offsets are not one per input, an
            input would be clipped, or `first` is not in (0, 1].
    """

    in_keys = ["step_count"]  # noqa: RUF012 - the base class of TensorDict sets these per class
    out_keys = ["action"]  # noqa: RUF012
    amplitude: Tensor
    offset: Tensor

    @checked
    def __init__(
        self,
        n_u: int,
        duration: float | None = 10.0,
        dt: float = 0.05,
        amplitude: Levels = 0.3,
        offset: Levels = 0.0,
        seed: int = 0,
        first: Share = 1.0,
    ) -> None:
        super().__init__()
        self.seed, duration = seed, 200 * dt if duration is None else duration
        if n_u < 1 or not 0 < dt <= duration:
            raise ValueError(
                f"{setting('excitation.duration')} is {duration:g} s, the control period {dt:g} s, for {n_u} inputs; "
                "allowed are a control period above 0, a duration of one or more, and an input or more: excite for "
                f"longer, or lower {setting('env.dt')}"
            )
        self.n_u, self.duration, self.dt = n_u, float(duration), float(dt)
        self.register_buffer("amplitude", _per_input(amplitude, n_u, "amplitude"))
        self.register_buffer("offset", _per_input(offset, n_u, "offset"))
        if not bool(self.amplitude.any()) or bool((self.offset.abs() + self.amplitude.abs() > 1 + 1e-6).any()):
            raise ValueError(
                f"excitation.amplitude is {self.amplitude.tolist()} about excitation.offset {self.offset.tolist()}; "
                "allowed are a half range above 0 of an input, and what stays within [-1, 1]: correct either"
            )
        self.first = float(first)

    @property
    def n_steps(self) -> int:
        """Count the control periods of the experiment."""
        return max(1, round(self.duration / self.dt))

    @abstractmethod
    def wave(self, t: Tensor) -> Tensor:
        """Give the bare signal in [-1, 1] at times `(*batch,)` [s], as `(*batch, n_u)` float64."""

    def signal(self, t: Tensor) -> Tensor:
        """Give the inputs, `(*batch, n_u)` in [-1, 1], at times `(*batch,)` [s], float64."""
        return (self.offset + self.amplitude * self.wave(t.to(torch.float64))).clamp(-1.0, 1.0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action`, `(*batch, n_u)` float32, for `step_count`, `(*batch, 1)`."""
        t = tensordict.get("step_count").squeeze(-1).to(torch.float64) * self.dt
        return tensordict.set("action", self.signal(t).to(torch.float32))

    def growth(self, steps: Tensor) -> Tensor:
        """Give the share of its strength, in (0, 1], so many control periods after the plant began to be moved.

        Args:
            steps: Control periods, of any shape.
        """
        return (self.first * 2.0 ** (steps.double() / 10)).clamp_max(1.0)

    def samples(self, dt: float | None = None) -> Tensor:
        """Give the inputs of the whole experiment, `(N, n_u)` float64, sampled every `dt` [s] (default: `self.dt`)."""
        step = self.dt if dt is None else dt
        return self.signal(torch.arange(round(self.duration / step), dtype=torch.float64) * step)


class Chirp(Excitation):
    """Sweep the frequency linearly, differently on each input.

    One input: `cos(2 pi (start t + (stop - start) t^2 / (2 T)))`, T the duration; start 0, stop 1 Hz is
    `cos(pi t^2 / T)`. The same sweep on all inputs would leave them indistinguishable, so the inputs
    differ in phase by a quarter turn, and every second one sweeps to 0.7 of the last frequency.

    Departure: the paper prints `cos(pi t/T (1 - t/T))`, which stays within [0.707, 1] and does not sweep.

    Args:
        n_u: number of inputs.
        band: frequency at the beginning and at the end [Hz]; None ends at a twentieth of the control rate.
        **common: duration, control period, amplitude, offset and seed, see `Excitation`.

    Raises:
        ValueError: a frequency is negative or above half of the control rate, or what `Excitation` raises.
    """

    def __init__(self, n_u: int, *, band: Sequence[float] | None = None, **common: Unpack[_Common]) -> None:
        super().__init__(n_u, **common)
        band = (0.0, 0.05 / self.dt) if band is None else band
        if len(band) != 2 or not 0 <= min(band) <= max(band) <= 0.5 / self.dt:
            raise ValueError(
                f"excitation.band is {list(band)} Hz; allowed are two frequencies, from 0 to half of the control rate, "
                f"{0.5 / self.dt:g} Hz, beyond which an input that is held is another signal: lower them, or "
                f"{setting('env.dt')}"
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
        harmonics: number K of harmonics of each input.
        **common: duration, control period, amplitude, offset and seed, see `Excitation`.

    Raises:
        ValueError: there is no harmonic, or what `Excitation` raises.
    """

    def __init__(self, n_u: int, *, harmonics: int = 8, **common: Unpack[_Common]) -> None:
        super().__init__(n_u, **common)
        if harmonics < 1:
            raise ValueError(f"the signal got {harmonics} harmonics; allowed are 1 or more: 8 suits 10 s")
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


class Aprbs(Excitation):
    """Hold uniformly random levels, each input on its own (amplitude-modulated pseudo-random binary sequence).

    Args:
        n_u: number of inputs.
        hold: time for which a level is held [s]; None is ten control periods.
        **common: duration, control period, amplitude, offset and seed, see `Excitation`.
    """

    def __init__(self, n_u: int, *, hold: float | None = None, **common: Unpack[_Common]) -> None:
        super().__init__(n_u, **common)
        own, hold = hold, 10 * self.dt if hold is None else hold
        if not hold > 0 or (own is not None and hold > self.duration):
            raise ValueError(
                f"excitation.hold is {hold:g} s; allowed is a time above 0, up to the whole experiment, "
                f"excitation.duration={self.duration:g} s: correct it, for one level identifies nothing"
            )
        self.hold = float(hold)
        generator = torch.Generator().manual_seed(self.seed)
        count = int(self.duration / self.hold) + 3
        self.levels = 2 * torch.rand(count, n_u, generator=generator, dtype=torch.float64) - 1

    def wave(self, t: Tensor) -> Tensor:
        """Give the held levels at times `(*batch,)` [s], `(*batch, n_u)`; after the end they start again."""
        shift = torch.arange(self.n_u, dtype=torch.float64) / self.n_u
        # The small part of a hold keeps times that are multiples of it on one side of the jump.
        place = (t.unsqueeze(-1) / self.hold + shift + 1e-9).floor().long() % len(self.levels)
        return self.levels.gather(0, place.reshape(-1, self.n_u)).reshape(*t.shape, self.n_u)


def _per_input(value: Levels, n_u: int, what: str) -> Tensor:
    """Give one number per input, `(n_u,)` float64."""
    values = torch.as_tensor(value if isinstance(value, float | int) else list(value), dtype=torch.float64).reshape(-1)
    if values.numel() not in (1, n_u) or not bool(values.isfinite().all()):
        raise ValueError(
            f"excitation.{what} is {value}; allowed is a finite number, or one for each of {n_u} inputs: correct it"
        )
    return values.expand(n_u).clone()
