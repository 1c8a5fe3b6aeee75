"""The time of a log: which column it is, in which unit, and the line that says so."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.table import Table, named_by, split_unit

Array = NDArray[np.float64]
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
CLOCKS = ("time", "t", "timestamp")
"""What a column of time is called, in small letters."""
CLOCK = "time"
"""Heading of the time where no other is given; `Time` or `t` is taken where the file has none."""
ALONE = 4
"""Letters from which on a unit alone, such as `millis`, is the name of a time; `s` or `h` may be a way or a height."""


@dataclass(frozen=True)
class Clock:
    """Say which column is the time.

    Attributes:
        heading: Heading of the column, as the file has it or as it was named.
        unit: Its unit; empty where nobody says one.
    """

    heading: str
    unit: str = ""

    def seconds(self, path: str) -> float:
        """Return how many seconds the unit is; without a unit it is seconds.

        Args:
            path: The file, for the message.

        Raises:
            ValueError: The unit is not one of time.
        """
        if self.unit and self.unit.lower() not in SECONDS:
            raise ValueError(
                f"{path} has the time column {self.heading!r} in {self.unit!r}; allowed units are "
                f"{', '.join(SECONDS)}, or none for s: rename it"
            )
        return SECONDS.get(self.unit.lower(), 1.0)


def clock_of(headings: Sequence[str], time: str = CLOCK) -> Clock:
    """Return the column of time: the one that is named, or the only one that can be meant.

    Where nobody named one and no heading is `time`, it is `Time`, `t` or `t_ms`, or `T` with a unit of time, for alone
    it may be a temperature. What is not there is returned as it was named. A unit may be said with the name, in any
    brackets: that of the heading, or where it has none, such as `count [ms]` of a column `count`, the one that counts.

    Args:
        headings: All headings of the file.
        time: Heading or name of the column; `time` if nobody named one.
    """
    if time in headings:
        return Clock(time, parts_of(time)[1])
    if named := named_by(time, headings):
        return Clock(named[0] if len(named) == 1 else time, split_unit(named[0])[1])
    name, unit = split_unit(time)
    if unit and name in headings:
        return Clock(name, unit)
    if time != CLOCK:
        return Clock(time)
    meant = [Clock(heading, parts_of(heading)[1]) for heading in headings if _is_clock(heading)]
    return meant[0] if len(meant) == 1 else Clock(time)


def parts_of(heading: str) -> tuple[str, str]:
    """Return the name and the unit of a heading of time: `t_ms` is in ms as `t [ms]` is, and `millis` as well."""
    name, unit = split_unit(heading)
    if unit:
        return name, unit
    if found := re.fullmatch(r"(.+)[_ ]([^\W_]+)", heading):
        return (found[1], found[2]) if found[2].lower() in SECONDS else (heading, "")
    return heading, heading if len(heading) >= ALONE and heading.lower() in SECONDS else ""


def _is_clock(heading: str) -> bool:
    """Tell whether a heading can only be that of time."""
    name, unit = parts_of(heading)
    if name.lower() in CLOCKS:
        return unit.lower() in SECONDS or (not unit and name != "T")
    return name == unit


def is_counter(column: Array) -> bool:
    """Tell whether a column counts: its numbers are whole, and each is larger than the one before."""
    return len(column) > 1 and bool((np.diff(column) > 0).all() and (column == column.round()).all())


def period_of(t: Array) -> float:
    """Return the time between two rows, the median of all, as the decimal number that its digits can tell [s].

    Args:
        t: Time of each row, `(rows,)`, two or more [s].
    """
    return float(f"{np.median(np.diff(t)):.12g}")  # differences of decimals carry digits that nobody logged


def in_seconds(path: str, table: Table, clock: Clock, dt: float | None) -> tuple[Array, str]:
    """Return the times of all rows [s], `(rows,)`, and the line that says which column they are and in which unit.

    A column of whole numbers without a unit is a counter where the sampling time is given.

    Args:
        path: The file, for messages.
        table: Rows of the file, the first column that of time.
        clock: Which column it is.
        dt: Sampling time that was given [s].

    Raises:
        ValueError: The unit is not one of time.
    """
    values, name = table.values[:, 0], split_unit(clock.heading)[0]
    t, counts = values * clock.seconds(path), not clock.unit and not table.dated and is_counter(values)
    if counts and dt is not None:
        t = values * (dt / float(np.median(np.diff(values))))
        return t, f"time is the column {name}, taken as a counter of rows: {dt:g} s between rows, as given by data.dt"
    how = "read as dates" if table.dated else f"in {clock.unit}" if clock.unit else "taken as seconds"
    between = f": {period_of(t):.4g} s between rows" if len(t) > 1 else ""
    told = f"time is the column {name}, {how}{between}"
    if not counts:
        return t, told
    units = shlex.quote(f'data.time="{name} [ms]"')
    return t, (
        f"{told}. It holds whole numbers without a unit, as a counter of rows does: if it is one, give the true time "
        f"between two rows in seconds, such as data.dt=0.01; if it is a time in ms, give {units}, or [s] for seconds"
    )
