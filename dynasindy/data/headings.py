"""What the heading of a column says: its name, its unit, and whether it can only be that of time or of a rate."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter

from dynasindy.systems.base import TURNS, UNIT

SECONDS = {
    unit: seconds
    for seconds, units in {
        1.0: "s sec second seconds",
        1e-3: "ms msec millisecond milliseconds millis",
        1e-6: "us \u00b5s \u03bcs usec microsecond microseconds micros",
        1e-7: "100ns",
        1e-9: "ns nsec",
        60.0: "min minute minutes",
        3600.0: "h hour hours",
        86400.0: "d day days",
    }.items()
    for unit in units.split()
}
"""Units of time, in seconds; capital letters are as good."""
UNITS = frozenset((
    "s", "sec", "ms", "us", "ns", "min", "h", "hz", "khz", "m", "mm", "cm", "km", "m/s", "m/s2", "m/s^2",
    "mm/s", "km/h", "rad", "rad/s", "deg", "deg/s", "°", "°/s", "rpm", "1/min", "turn", "v", "mv", "a", "ma",
    "w", "kw", "n", "kn", "nm", "n*m", "pa", "kpa", "mpa", "bar", "mbar", "k", "c", "°c", "degc", "%", "pct",
    "-", "1", "p.u.", "pu", "kg", "g", "l", "l/s", "l/min", "m3/h", "counts", "ticks", "t",
))  # fmt: skip
"""Units that may stand below the headings, in them or in each cell, in small letters and without brackets."""
CLOCKS = ("time", "t", "timestamp", "timestamps", "stamp", "datetime", "elapsed", "uptime", "epoch", "x_value")
"""What a column of time is called, in small letters."""
NAME = re.compile(r"[^\W\d][\w .-]*")
"""Names that can be told from functions and numbers in an equation."""
ALONE = 4
"""Letters from which on a unit alone, such as `millis`, is the name of a time; `s` or `h` may be a way or a height."""
ENDINGS = {
    **{unit: unit for unit in ("rpm", "V", "mV", "mA", "mm", "cm", "km", "Nm", "kN", "kW", "Pa", "kPa", "MPa", "mbar")},
    **{"dps": "deg/s", "pct": "%", "degC": "degC"},
}
"""Units as the end of a name has them, `supply_V` or `U/V`, beside those of angles; `x_bar` is a mean value."""
ANGLES = {
    **dict.fromkeys(("deg", "grad", "degs", "degree", "degrees", "\u00ba"), "deg"),
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
    **dict.fromkeys(("rev", "revs", "revolution", "revolutions"), "rev"),
    **{unit: unit for unit in ("\u00b0", "mrad", "cdeg", "mdeg", "gon", "turn", "turns")},
}
"""Units of angles, in small letters, and what stands for them."""
PER_SECOND = re.compile(r"(?:[ _]*(?:/|per|_)[ _]*s(?:ec(?:ond)?)?|[ *.\u00b7]*s(?:\^?-1|\u207b\u00b9))", re.IGNORECASE)
PER_MINUTE = re.compile(r"rpm|(?:rev|r|u)/min", re.IGNORECASE)
"""Turns per minute, which are `rpm`; of what is no rate of an angle they stay, as of a fan."""
APART = re.compile(r"\s*(?:[,/_{<-]|\bin\b|(?<=[a-z])(?=[A-Z]))\s*")
"""What may stand between a name and its unit where the unit has no brackets, as in `angle / deg` and `angleDeg`."""
INPUT = re.compile(r"(u|U|input)([_\d].*)?")
"""How inputs are called."""
COMMAND = re.compile(r"(.*[_ ])?(cmd|command|input)([_ \d].*)?")
"""How they may be called where none is called so: beside an input, a command may be a target."""
RATE_NAMES = ("{}_rate", "{}_dot", "{}dot", "d{}", "d_{}", "der_{}", "{}_vel", "{}_velocity", "{}_speed")
"""How the rate of a state is called."""


def split_unit(heading: str) -> tuple[str, str]:
    """Split `angle [rad]` or `angle (rad)` into name and unit; the unit is empty where there is none."""
    found = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", heading)
    return (found[1], (found[2] or found[3] or "").strip()) if found and found[1] else (heading, "")


def plain_heading(heading: str) -> str:
    """Return a heading as a name with its unit in brackets: `angle_deg` is `angle [deg]`.

    A place in an array belongs to the name, and so do the parts of a path: `/joint/position[0]` is `joint_position_0`.
    """
    heading = " ".join(heading.split())
    own = name, unit = split_unit(heading)
    if unit.isdigit() or not UNIT.fullmatch(_plain_unit(unit)):  # a place, or a serial number behind `h, m`
        name, unit = next(filter(itemgetter(1), [_apart(name)]), (heading, ""))
    if not unit and (found := re.fullmatch(r"(.*?\w)(?:\s+in)?\s*(\u00b0[CF]?|%)", name)):  # no letters of a name
        name, unit = found.groups()
    name, unit = (name, _plain_unit(unit)) if unit else _apart(name)
    if not NAME.fullmatch(name):
        plain = re.sub(r"\W+", "_", name).strip("_")
        name = plain if NAME.fullmatch(plain) else name
    return heading if (name, unit) == own else f"{name} [{unit}]" if unit else name


def _plain_unit(unit: str) -> str:
    """Return a unit of angles or of their rates as others are called: `DEG/sec` is `deg/s`; another one as it is."""
    if PER_MINUTE.fullmatch(unit):
        return "rpm"
    rate = re.fullmatch(rf"(.+?){PER_SECOND.pattern}", unit, re.IGNORECASE)
    angle = ANGLES.get((rate[1] if rate else unit).lower())
    return unit if angle is None else f"{angle}/s" if rate else angle


def _apart(name: str) -> tuple[str, str]:
    """Split a unit off the end of a name that has it without brackets: degrees, radians, or what follows an `in`."""
    for between in APART.finditer(name):
        text = name[between.end() :].rstrip("}>")
        unit = _plain_unit(text)
        said = between[0].strip() in ("in", ",") and unit.lower() in UNITS
        first = not re.search("[_/]", name[: between.start()])  # what follows a later `/` is half of a unit
        if text in ENDINGS and (between[0].strip() == "_" or (between[0].strip() == "/" and first)):
            unit, said = ENDINGS[text], True
        if between.start() and (said or re.fullmatch(r"(m?rad|[mc]?deg|\u00b0)(/s)?", unit)):
            return name[: between.start()], unit
    return name, ""


def in_radians(unit: str, turns: bool = True) -> tuple[str, float]:
    """Return the unit that a unit becomes, and the factor to it: rad or rad/s of angles and their rates.

    Args:
        unit: A unit, such as `deg/s`.
        turns: Whether turns per minute are those of an angle.
    """
    whole, per, time = unit.partition("/")
    if whole in TURNS and per + time in ("", "/s", "/s^2", "/s²"):
        return f"rad{per}{time}", TURNS[whole]
    if turns and PER_MINUTE.fullmatch(unit):
        return "rad/s", 2 * math.pi / 60
    return unit, 1.0


def is_rate_of(state: str, rate: str) -> bool:
    """Tell whether a column is called the rate of another one, as `arm_rate` of `arm`."""
    return rate in (pattern.format(state) for pattern in RATE_NAMES)


def named_by(name: str, headings: Sequence[str]) -> list[str]:
    """Return the headings that a name means: its own, else those of which it is the name, else those in other brackets.

    So `T`, `T [degC]` and `T(degC)` all name the column `T [degC]`, and `angle_deg` names `angle [deg]`.
    """
    plain = plain_heading(name)
    same: tuple[Callable[[str], bool], ...] = (
        lambda heading: heading == name,
        lambda heading: split_unit(heading)[0] == name,
        lambda heading: split_unit(heading) == split_unit(name),
        lambda heading: heading == plain,
        lambda heading: split_unit(heading)[0] == plain,
    )
    return next(filter(None, ([h for h in headings if alike(h)] for alike in same)), [])


def find_names(name: str, names: Iterable[str]) -> list[str]:
    """Return which names of columns, without their units, a name or a heading means: `angle_deg` means `angle`."""
    names = [*names]
    return named_by(name, names) or named_by(split_unit(plain_heading(name))[0], names)


def parts_of(heading: str) -> tuple[str, str]:
    """Return the name and the unit of a heading of time: `t_ms` is in ms as `t [ms]` is, and `millis` as well."""
    name, unit = split_unit(heading)
    if unit:
        return name, unit
    clocks, units = "|".join(name for name in CLOCKS if len(name) >= ALONE), "|".join(SECONDS)
    if found := re.fullmatch(f"(.+[_ ]|{clocks})({units})", heading, re.IGNORECASE):
        return found[1].rstrip("_ "), found[2]
    return heading, heading if len(heading) >= ALONE and heading.lower() in SECONDS else ""


def is_clock(heading: str) -> bool:
    """Tell whether a heading can only be that of time."""
    name, unit = parts_of(heading)
    if name.lower().strip("_") in CLOCKS:
        return unit.lower() in SECONDS or (not unit and name != "T")
    return name == unit
