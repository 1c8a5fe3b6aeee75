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


def unit_of(seconds: float, running: bool = False) -> TimeUnit:
    """Return the unit in which a length of time is told, the same in words, in figures and in animations.

    Args:
        seconds: The length [s]; one that is not finite has seconds.
        running: Whether it goes on. Then only how long it is counts: from one moment to the next seconds would take the
            place of minutes where they are rounder.

    Returns:
        The unit: of what does not run, seconds also where only they make a round number of it, as of 800 s.
    """
    if seconds == float("inf"):
        return SECONDS
    unit = next((unit for least, unit in FROM if abs(seconds) >= least), SECONDS)
    rough = not running and abs(seconds) < MANY and not _round(seconds / unit.seconds) and _round(seconds)
    return SECONDS if rough else unit


def _round(value: float) -> bool:
    """Tell whether three digits say all of a number; sums of control periods miss it by less than a millionth."""
    return float(f"{value:.3g}") == float(f"{value:.6g}")


def in_words(seconds: float, longest: float | None = None, digits: int = 4, running: bool = False) -> str:
    """Return a length of time with its unit, `90 min`.

    Args:
        seconds: The length [s].
        longest: Length whose unit is used [s], where several lengths stand beside each other; by default its own.
        digits: Significant digits, at least those before the point.
        running: Whether it goes on, as `unit_of` takes it.
    """
    unit = unit_of(seconds if longest is None else longest, running)
    value = seconds / unit.seconds
    return f"{value:.0f} {unit.name}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g} {unit.name}"
