"""The signals of the paper's scenarios on any plant, made of its target range and of the length of its episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypedDict

from dynasindy.limits import Count
from dynasindy.tasks.references import Step, Wave

SHARE = 0.25
"""Amplitude of a wave in target ranges: a square jumps over half of the range, as far as a step from its middle."""
FIRST = 0.75
"""Place of the one target of a step between the ends of the target range."""


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
    if stray := sorted(own.keys() - Signal.__annotations__.keys()):
        raise ValueError(
            f"plant.signals.{shape} has {', '.join(stray)}; allowed are {', '.join(Signal.__annotations__)}: correct it"
        )
    if "frequency" not in own and not (dt and dt > 0 and max_steps > 0):
        raise ValueError(
            f"the period of a {shape} is the length of an episode, and task.max_steps is {max_steps}, env.dt {dt}; "
            f"give a number of control periods and their length in seconds, or plant.signals.{shape}.frequency, one "
            "per output in Hz"
        )
    return Wave(
        own.get("amplitude") or [SHARE * (b - a) for a, b in ends],
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
    return Step(targets or [[a + FIRST * (b - a) for a, b in _ends(low, high)]])


def _ends(low: Sequence[float], high: Sequence[float]) -> list[tuple[float, float]]:
    if len(low) != len(high):
        raise ValueError(
            f"plant.low={list(low)} and plant.high={list(high)} differ in length; give one end per output in each"
        )
    return list(zip(low, high, strict=True))
