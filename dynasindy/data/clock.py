"""The time of a log: which column it is, in which unit, and the line that says so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.headings import SECONDS, is_clock, named_by, parts_of, split_unit
from dynasindy.data.table import DAY, Table
from dynasindy.findings import Finding, LogError, note, weak

Array = NDArray[np.float64]
CLOCK = "time"
"""Heading of the time where no other is given; `Time` or `t` is taken where the file has none."""
LATE = 10
"""Usual steps within which a counter goes on after its overflow."""
YEARS = (1.26e9, 2.21e9)
"""From 2010 to 2040, in seconds since 1970."""
EPOCHS = {
    **dict.fromkeys(("ms", "us", "ns"), (0.0,)),
    "100ns": (11_644_473_600.0, 62_135_596_800.0),
    "d": (25_569 * DAY, 40_587 * DAY, 719_529 * DAY, 2_440_587.5 * DAY),
}
"""Seconds from the beginnings of calendars to 1970, by the unit of their times: files and programs of Windows count in
100 ns, spreadsheets, MATLAB and astronomers in days."""
OVERFLOWS = (2.0**8, 1e3, 2.0**16, 1e6, 2.0**24, 1e9, 2.0**32)
"""Sizes of counters, which begin anew there, also of parts of a second."""
FEWEST = 10
"""Rows of a recording that begins anew; single rows in disorder are none."""


def clock_of(headings: Sequence[str], time: str = CLOCK) -> tuple[str, str]:
    """Return heading and unit of the column of time: the one that is named, or the only one that can be meant.

    Where nobody named one and no heading is `time`, it is `Time`, `t` or `t_ms`, or `T` with a unit of time, for alone
    it may be a temperature. What is not there is returned as it was named. A unit may be said with the name, in any
    brackets: that of the heading, or where it has none, such as `count [ms]` of a column `count`, the one that counts.

    Args:
        headings: All headings of the file.
        time: Heading or name of the column; `time` if nobody named one.
    """
    if time in headings:
        return time, parts_of(time)[1] or time * (time.lower() in SECONDS)
    if named := named_by(time, headings):
        return named[0] if len(named) == 1 else time, split_unit(named[0])[1]
    name, unit = split_unit(time)
    if unit and name in headings:
        return name, unit
    meant = [heading for heading in headings if time == CLOCK and is_clock(heading)]
    return (meant[0], parts_of(meant[0])[1]) if len(meant) == 1 else (time, "")


def is_counter(column: Array) -> bool:
    """Tell whether a column counts: its numbers are whole, and each is larger than the one before."""
    return len(column) > 1 and bool((np.diff(column) > 0).all() and (column == column.round()).all())


def _even_rows(path: str, t: Array, dt: float | None) -> Array | None:
    """Return the times of even rows that a clock of coarse ticks wrote [s], `(rows,)`; None of any other clock.

    Its steps are of two neighbouring numbers of ticks, and its stamps lie within a tick of a straight line.
    """
    steps, rows = np.diff(t), np.arange(len(t))
    low, usual, high = float(steps.min()), float(np.median(steps)), float(steps.max())
    long = steps > 0.5 * (low + high)
    digit = next((10.0**-k for k in range(7) if np.abs(t - t.round(k)).max() < 1e-3 * 10.0**-k), 0.0)
    if high - low > 0.02 * usual and (np.abs(steps - np.where(long, high, low)) <= 0.1 * (high - low)).all():
        tick = float(steps[long].mean() - steps[~long].mean())
        count, off = divmod(float(steps[~long].mean()) / tick + 0.5, 1)
        slope = float(np.polyfit(rows, t - t[0], 1)[0])  # of which few digits are enough for a short log
        periods = (dt or float(f"{slope:.{digits}g}") for digits in range(6, 13))
        few = min(long.sum(), (~long).sum()) < 3  # which may be lost rows, as may be steps of several last digits
        sure = count >= 2 or not (few or (count == 1 and 0 < digit < 0.9 * tick))
        fit = next((period for period in periods if np.ptp(t - period * rows) <= 1.1 * tick), None)
        if sure and abs(off - 0.5) < 0.2 and fit is not None:
            return np.asarray(fit * rows)
    if digit > 0.75 * usual and (steps > usual + 0.5 * digit).mean() > 0.1:  # rows may be lost, or short of a tick
        if dt is None:
            raise LogError("log.coarse_time", file=path, tick=digit)
        first = dt * np.angle(np.exp(2j * np.pi * t / dt).mean()) / (2 * np.pi)
        return np.asarray(dt * np.round((t - first) / dt))
    return None


def period_of(t: Array) -> float:
    """Return the time between two rows, the median of all, as the decimal number that its digits can tell [s].

    Args:
        t: Time of each row, `(rows,)`, two or more [s].
    """
    usual, near = float(np.median(np.diff(t))), np.spacing(np.abs(t).max())
    # Differences of decimals, and more so those of dates, carry digits that nobody logged.
    decimals = [float(f"{usual:.{digits}g}") for digits in range(1, 13)]
    return next((period for period in decimals if abs(period - usual) <= near), decimals[-1])


def date_unit(values: Array) -> str:
    """Return the unit of times that can only be dates, as their size tells; empty for other times.

    They are of the years from 2010 to 2040, and days are told from seconds by rows that would be less than 1 ms apart.

    Args:
        values: Time of each row, `(rows,)`.
    """
    if len(values) < 2:
        return ""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    for unit, epochs in EPOCHS.items():
        first, last = (np.add(epochs, seconds) / SECONDS[unit] for seconds in YEARS)
        if ((first <= low) & (high < last)).any() and (unit != "d" or 0 < high - low < 1e-3 * len(values)):
            return unit
    return ""


def _unwrap_counter(values: Array, table: Table, unit: float, dt: float | None) -> tuple[Array, list[Finding]]:
    """Return times that go on where a counter overflowed, or where a recording begins anew, and what was found."""
    steps = np.diff(values)
    drops = np.flatnonzero(steps < 0)
    if not len(drops) or len(drops) > 1 + len(values) // FEWEST:
        return values, []
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else (dt or 1.0) / unit
    starts, lines = drops + 1, table.frame.index[drops + 1].tolist()
    for size in (*OVERFLOWS, DAY / unit):
        if np.ptp(values) < size and bool(((steps[drops] + size > 0) & (steps[drops] + size <= LATE * usual)).all()):
            found, lifts = note("log.overflow", size=size, lines=lines), np.full(len(drops), size)
            break
    else:
        parts = np.diff(np.concatenate([[0], starts, [len(values)]]))
        if (parts < FEWEST).any() or (values[starts] > values[0] + LATE * usual).any():
            return values, []
        found, lifts = note("log.restart", lines=lines), LATE * usual - steps[drops]
    return values + np.cumsum(np.bincount(starts, lifts, len(values))), [found]


def in_seconds(table: Table, unit: str, dt: float | None) -> tuple[Array, list[Finding]]:
    """Return the times of all rows [s], `(rows,)`, and what was found: which column they are, in which unit.

    A column of whole numbers without a unit is a counter where the sampling time is given.

    Args:
        table: Rows of the file, the first column that of time.
        unit: Its unit; empty where nobody says one.
        dt: Sampling time that was given [s].

    Raises:
        ValueError: The unit is not one of time, or the times do not tell that between two rows.
    """
    heading, name = table.headings[0], split_unit(table.headings[0])[0]
    values = table.column(heading)
    unit = "" if table.dated else unit or date_unit(values)
    if unit and unit.lower() not in SECONDS:
        raise LogError("log.time_unit", file=str(table.path), column=heading, unit=unit, units=[*SECONDS])
    seconds = SECONDS.get(unit.lower(), 1.0)
    values, again = _unwrap_counter(values, table, seconds, dt)
    t, counts = values * seconds, not unit and not table.dated and is_counter(values)
    if counts and dt is not None:
        t = values * (dt / float(np.median(np.diff(values))))
        return t, [note("log.row_counter", column=name, dt=dt)]
    period, said = period_of(t) if len(t) > 1 else 0.0, list[Finding]()
    since = len(values) and values[0] > 3e10  # of a time since any date
    if (counts and period >= 1000) or (since and not unit and not table.dated):  # hardly s
        raise LogError("log.no_time_unit", file=str(table.path), column=heading, step=period)
    even = _even_rows(str(table.path), t, dt) if len(t) > 2 and (np.diff(t) >= 0).all() else None
    if even is not None:
        t, period = even, period_of(even)
        said = [note("log.coarse_clock", column=name, dt=period)]
    said += [weak("log.whole_seconds", column=name)] if counts else []
    return t, [note("log.time", column=name, unit=unit, dates=bool(table.dated), dt=period), *said, *again]
