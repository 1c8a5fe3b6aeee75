"""References to track: constants and periodic waves, one draw per episode.

Every reference is a row of five numbers per output, so that a batch may mix steps, sines and squares:

    r(t) = offset + amplitude * w(2 pi frequency t + phase),  w = sin, or sign(sin) where `square` is 1
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal

import torch
from pydantic import with_config
from torch import Tensor
from typing_extensions import TypedDict

from dynasindy.limits import Count
from dynasindy.sentences import setting

N_PARAMS = 5
"""offset, amplitude [unit of the output], frequency [Hz], phase [rad], square (0 or 1)."""


def value(params: Tensor, t: Tensor) -> Tensor:
    """Return the reference at a time.

    Args:
        params: Parameters, `(*batch, n_r, 5)`.
        t: Time since the start of the episode [s], `(*batch, 1)`.

    Returns:
        Reference [unit of the output], `(*batch, n_r)`.
    """
    offset, amplitude, frequency, phase, square = params.unbind(-1)
    angle = 2 * math.pi * frequency * t + phase
    sine = torch.sin(angle)
    # sign(0) would be 0 for one sample at the jump, so a square wave is +1 from its zero on.
    jump = torch.where(torch.remainder(angle, 2 * math.pi) < math.pi, 1.0, -1.0).to(sine)
    return offset + amplitude * (sine + square * (jump - sine))


def rate(params: Tensor, t: Tensor) -> Tensor:
    """Return the derivative of the reference, zero for steps and squares.

    Args:
        params: Parameters, `(*batch, n_r, 5)`.
        t: Time since the start of the episode [s], `(*batch, 1)`.

    Returns:
        Rate of the reference [unit of the output per second], `(*batch, n_r)`.
    """
    _, amplitude, frequency, phase, square = params.unbind(-1)
    omega = 2 * math.pi * frequency
    return (1 - square) * amplitude * omega * torch.cos(omega * t + phase)


class Reference(ABC):
    """A distribution over references."""

    n_r: int

    @abstractmethod
    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw parameters, `(*batch, n_r, 5)`, float32, from the generator."""


def _finite(name: str, *values: Sequence[float]) -> None:
    """Refuse values that are not finite numbers or whose lengths differ."""
    lengths = {len(row) for row in values}
    if lengths == {0}:
        raise ValueError(
            f"{name} has no targets; name the states to hold in plant.outputs, the ends of their targets in plant.low "
            "and plant.high"
        )
    if len(lengths) != 1 or not all(math.isfinite(v) for row in values for v in row):
        raise ValueError(f"{name} needs one finite number per output in each list, got {values}; complete the lists")


class Step(Reference):
    """Fixed targets; row k of a batch gets target k modulo their number.

    Args:
        targets: One list of targets per step, `(n_steps, n_r)` [unit of the outputs].

    Raises:
        ValueError: No target, rows of different lengths or a number that is not finite.
    """

    def __init__(self, targets: Sequence[Sequence[float]]) -> None:
        _finite("step reference (targets)", *targets)
        self.targets = torch.tensor([list(row) for row in targets], dtype=torch.float32)
        self.n_r = self.targets.shape[-1]

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Return the targets in order, `(*batch, n_r, 5)`; the generator is not used."""
        rows = torch.arange(batch.numel()) % len(self.targets)
        params = torch.zeros(batch.numel(), self.n_r, N_PARAMS)
        params[..., 0] = self.targets[rows]
        return params.reshape(*batch, self.n_r, N_PARAMS)


class RandomStep(Reference):
    """A fresh constant target per episode, uniform in a range (the paper's training references).

    Args:
        low: Lower ends, one per output [unit of the output].
        high: Upper ends, one per output [unit of the output].

    Raises:
        ValueError: The lengths differ, a number is not finite, or low exceeds high.
    """

    def __init__(self, low: Sequence[float], high: Sequence[float]) -> None:
        _finite("random step (low, high)", low, high)
        if not all(a <= b for a, b in zip(low, high, strict=True)):
            raise ValueError(
                f"random step needs low <= high, got low={list(low)}, high={list(high)}; swap them "
                f"({setting('plant.low')}, {setting('plant.high')})"
            )
        self.low, self.high = torch.tensor(list(low)), torch.tensor(list(high))
        self.n_r = len(low)

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw targets, `(*batch, n_r, 5)`."""
        params = torch.zeros(*batch, self.n_r, N_PARAMS)
        draw = torch.rand(*batch, self.n_r, generator=generator)
        params[..., 0] = self.low + (self.high - self.low) * draw
        return params


class Wave(Reference):
    """A sine or square wave about an offset, with given or random phase.

    Args:
        amplitude: One per output [unit of the output].
        frequency: One per output [Hz], >= 0.
        shape: "sine" or "square".
        offset: One per output [unit of the output]; zero if omitted.
        random: Scale amplitude and frequency by a factor uniform in [0, 1] and draw the phase, per row.

    Raises:
        ValueError: Lengths differ, a number is not finite, a frequency is negative, or the shape is unknown.
    """

    def __init__(
        self,
        amplitude: Sequence[float],
        frequency: Sequence[float],
        shape: str = "sine",
        offset: Sequence[float] | None = None,
        random: bool = False,
    ) -> None:
        offset = [0.0] * len(amplitude) if offset is None else offset
        _finite(f"{shape} reference (amplitude, frequency, offset)", amplitude, frequency, offset)
        if min(frequency) < 0:
            raise ValueError(f"frequencies must be >= 0 Hz, got frequency= {list(frequency)}; give e.g. 0.015")
        if shape not in ("sine", "square"):
            raise ValueError(f"shape '{shape}' of a wave is unknown; use 'sine' or 'square'")
        self.n_r = len(amplitude)
        self.random = random
        self.params = torch.zeros(self.n_r, N_PARAMS)
        for column, row in enumerate((offset, amplitude, frequency)):
            self.params[:, column] = torch.tensor(list(row))
        self.params[:, 4] = float(shape == "square")

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Return the wave, or draw one per row, `(*batch, n_r, 5)`."""
        params = self.params.expand(*batch, self.n_r, N_PARAMS).clone()
        if self.random:
            params[..., 1:3] *= torch.rand(*batch, self.n_r, 2, generator=generator)
            params[..., 3] = 2 * math.pi * torch.rand(*batch, self.n_r, generator=generator)
        return params


@with_config(extra="forbid")
class Signal(TypedDict, total=False):
    """What a plant's file may say of a wave; the rest follows from the plant.

    Attributes:
        amplitude: One per output [unit of the output].
        frequency: One per output [Hz].
        offset: One per output [unit of the output].
        seconds: How long it is flown in a scenario [s].
    """

    amplitude: list[float]
    frequency: list[float]
    offset: list[float]
    seconds: float


def wave(
    shape: Literal["sine", "square"],
    low: Sequence[float],
    high: Sequence[float],
    max_steps: Count,
    dt: float | None,
    signal: Signal | None = None,
) -> Wave:
    """Return a sine or a square about the middle of the target range and over half of it, with an episode as period.

    An output that has a single target stays there.

    Args:
        shape: Its shape.
        low: Lower end of the targets, per output [unit of the output].
        high: Upper end of the targets, per output [unit of the output].
        max_steps: Control periods per episode.
        dt: Control period [s].
        signal: What the plant says of this wave.

    Raises:
        ValueError: The shape is unknown, the numbers of ends differ, the length of an episode is not known or not
            positive, or the plant says something else of the wave than there is to say.
    """
    ends = _ends(low, high)
    own: Signal = signal or {}
    if "frequency" not in own and not (dt and dt > 0 and max_steps > 0):
        raise ValueError(
            f"the period of a {shape} is the length of an episode, and task.max_steps is {max_steps}, env.dt {dt}; "
            f"give a number of control periods and their length in seconds, or plant.signals.{shape}.frequency, one "
            "per output in Hz"
        )
    return Wave(  # a square jumps over half of the range, as far as a step from its middle
        own.get("amplitude") or [0.25 * (b - a) for a, b in ends],
        own.get("frequency") or [1.0 / (max_steps * (dt or 1.0))] * len(ends),
        shape,
        own.get("offset") or [0.5 * (a + b) for a, b in ends],
    )


def target(low: Sequence[float], high: Sequence[float], targets: Sequence[Sequence[float]] | None = None) -> Step:
    """Return a step to one target in the upper half of the target range, or to what the plant's file names.

    Args:
        low: Lower end of the targets, per output [unit of the output].
        high: Upper end of the targets, per output [unit of the output].
        targets: Rows of targets, one value per output in each; None for three quarters of the way from low to high.

    Raises:
        ValueError: The numbers of ends differ.
    """
    return Step(targets or [[a + 0.75 * (b - a) for a, b in _ends(low, high)]])


def _ends(low: Sequence[float], high: Sequence[float]) -> list[tuple[float, float]]:
    if len(low) != len(high):
        raise ValueError(
            f"plant.low={list(low)} and plant.high={list(high)} differ in length; give one end per output in each"
        )
    return list(zip(low, high, strict=True))
