"""Lengths of time as people say them: seconds, minutes or hours by how long they are; files and settings are in s."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TimeUnit:
    """A unit of time.

    Attributes:
        name: How it is written.
        seconds: Its length [s].
    """

    name: str
    seconds: float


SECONDS = TimeUnit("s", 1.0)
FROM: tuple[tuple[float, TimeUnit], ...] = ((7200.0, TimeUnit("h", 3600.0)), (600.0, TimeUnit("min", 60.0)))
"""From which length on [s] a unit is used, the longest first; shorter ones are told in seconds."""
MANY = 10000.0
"""Length [s] from which on one alone is never told in seconds; below, 1000 s is plainer than 16.67 min."""


def unit_of(seconds: float) -> TimeUnit:
    """Return the unit in which a length of time [s] is told; one that is not finite has seconds."""
    if seconds == float("inf"):
        return SECONDS
    return next((unit for least, unit in FROM if abs(seconds) >= least), SECONDS)


def _suited(seconds: float) -> TimeUnit:
    """Return the unit in which a length of time alone is told: seconds where only they make a round number of it."""
    unit = unit_of(seconds)
    rough = abs(seconds) < MANY and not _round(seconds / unit.seconds) and _round(seconds)
    return SECONDS if rough else unit


def _round(value: float) -> bool:
    """Tell whether three digits say all of a number."""
    return float(f"{value:.3g}") == float(f"{value:.9g}")


def in_words(seconds: float, longest: float | None = None, digits: int = 4) -> str:
    """Return a length of time with its unit, `90 min`.

    Args:
        seconds: The length [s].
        longest: Length whose unit is used [s], where several lengths stand beside each other; by default its own.
        digits: Significant digits, at least those before the point.
    """
    unit = _suited(seconds) if longest is None else unit_of(longest)
    value = seconds / unit.seconds
    return f"{value:.0f} {unit.name}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g} {unit.name}"
