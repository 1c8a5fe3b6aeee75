"""What the heading of a column says: its name, its unit, and whether it can only be that of time."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence

SECONDS = {
    "s": 1.0,
    "sec": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "\u00b5s": 1e-6,
    "\u03bcs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
    **dict.fromkeys(("second", "seconds"), 1.0),
    **dict.fromkeys(("millisecond", "milliseconds", "millis"), 1e-3),
    **dict.fromkeys(("microsecond", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("minute", "minutes"), 60.0),
    **dict.fromkeys(("hour", "hours"), 3600.0),
}
"""Units of time, in seconds; capital letters are as good."""
CLOCKS = ("time", "t", "timestamp", "stamp", "elapsed", "x_value")
"""What a column of time is called, in small letters."""
ALONE = 4
"""Letters from which on a unit alone, such as `millis`, is the name of a time; `s` or `h` may be a way or a height."""
SUFFIXES = {
    "deg_s": "deg/s", "dps": "deg/s", "rad_s": "rad/s", "deg": "deg", "rad": "rad", "rpm": "rpm", "pct": "%", "V": "V",
}  # fmt: skip
"""Units as the end of a name has them, `angle_deg`."""


def split_unit(heading: str) -> tuple[str, str]:
    """Split `angle [rad]` or `angle (rad)` into name and unit; the unit is empty where there is none."""
    found = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", heading)
    return (found[1], (found[2] or found[3] or "").strip()) if found and found[1] else (heading, "")


def plain_heading(heading: str) -> str:
    """Return a heading as a name with its unit in brackets: `angle_deg` is `angle [deg]`.

    A place in an array belongs to the name, and so do the parts of a path: `/joint/position[0]` is `joint_position_0`.
    """
    heading = " ".join(heading.split())
    name, unit = split_unit(heading)
    if unit.isdigit():
        name, unit = heading, ""
    if not unit and (end := next((e for e in SUFFIXES if len(name) > len(e) + 1 and name.endswith(f"_{e}")), "")):
        name, unit = name[: -len(end) - 1], SUFFIXES[end]
    if re.search(r"/|\[\d+\]", name):
        name = re.sub(r"\W+", "_", name).strip("_")
    elif unit == split_unit(heading)[1]:
        return heading
    return f"{name} [{unit}]" if unit else name


def plain_headings(headings: Sequence[str]) -> list[str]:
    """Return headings with plain names, but where two of these would be the same."""
    plain = [plain_heading(heading) for heading in headings]
    names = [split_unit(heading)[0] for heading in plain]
    return [new if names.count(split_unit(new)[0]) == 1 else old for new, old in zip(plain, headings, strict=True)]


def units_of(headings: Iterable[str]) -> dict[str, str]:
    """Return the unit that each heading names, by the heading, by its name alone and by `name_unit`."""
    split = {heading: split_unit(heading) for heading in headings}
    ended = {f"{n}_{end}": unit for n, unit in split.values() for end, ending in SUFFIXES.items() if ending == unit}
    return ended | dict(split.values()) | {heading: unit for heading, (_, unit) in split.items()}


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


def parts_of(heading: str) -> tuple[str, str]:
    """Return the name and the unit of a heading of time: `t_ms` is in ms as `t [ms]` is, and `millis` as well."""
    name, unit = split_unit(heading)
    if unit:
        return name, unit
    if found := re.fullmatch(r"(.+)[_ ]([^\W_]+)", heading):
        return (found[1], found[2]) if found[2].lower() in SECONDS else (heading, "")
    return heading, heading if len(heading) >= ALONE and heading.lower() in SECONDS else ""


def is_clock(heading: str) -> bool:
    """Tell whether a heading can only be that of time."""
    name, unit = parts_of(heading)
    if name.lower().strip("_") in CLOCKS:
        return unit.lower() in SECONDS or (not unit and name != "T")
    return name == unit
