"""Text for people: lengths of time, and the name that was probably meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import NamedTuple


class _TimeUnit(NamedTuple):
    name: str
    seconds: float


SECONDS = _TimeUnit("s", 1.0)
FROM: tuple[tuple[float, _TimeUnit], ...] = ((7200.0, _TimeUnit("h", 3600.0)), (600.0, _TimeUnit("min", 60.0)))
"""From which length on [s] a unit is used, the longest first; shorter ones are in seconds."""


def duration_unit(seconds: float) -> _TimeUnit:
    """Return the unit in which a length of time is given, the same in words, in figures and in animations.

    Args:
        seconds: The length [s]; one that is not finite has seconds.
    """
    return next((unit for least, unit in FROM if least <= abs(seconds) < float("inf")), SECONDS)


def unit_suffix(unit: str) -> str:
    """Return a unit as it stands behind a number, ` m/s`; nothing of a number without one, `-`."""
    return "" if unit in ("", "-") else f" {unit}"


def format_duration(seconds: float, longest: float | None = None, digits: int = 4) -> str:
    """Return a length of time with its unit, `90 min`.

    Args:
        seconds: The length [s].
        longest: Length whose unit is used [s], where several lengths stand beside each other; by default its own.
        digits: Significant digits, at least those before the point.
    """
    unit = duration_unit(seconds if longest is None else longest)
    value = seconds / unit.seconds
    return f"{value:.0f} {unit.name}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g} {unit.name}"


def did_you_mean(name: object, names: Iterable[str]) -> str:
    """Return `; did you mean 'angle'?` of the nearest name, whatever its capitals; nothing where none is near.

    Args:
        name: What was given, which need not be text: a key of a mapping may be a number.
        names: Those that exist.
    """
    plain = {each.lower(): each for each in names}
    found = get_close_matches(str(name).lower(), plain, 1)
    return f"; did you mean '{plain[found[0]]}'?" if found else ""
