"""The time of a log: which column it is, in which unit, and the line that says so."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.headings import SECONDS, is_clock, named_by, parts_of, split_unit
from dynasindy.data.table import DAY, Table
from dynasindy.findings import Finding, LogError, note, weak

Array = NDArray[np.float64]
CLOCK = "time"
"""Heading of the time where no other is given; `Time` or `t` is taken where the file has none."""
MOSTLY = 0.9
"""Part of the steps that are one of two neighbouring numbers of ticks where an even clock was rounded to ticks."""
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
LONGEST_PART = 1 / 287
"""Parts of a day from row to row, five minutes, beyond which times are those of a second: 144 Hz are ten minutes."""
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


def _possible_ticks(column: Array, unit: float) -> Iterator[tuple[float, Array, int, float]]:
    """Yield the ticks [s] of which all stamps may be multiples, the likelier first; none of stamps with all digits."""
    # Beside them stand the stamps [ticks], of how many last digits a tick is, 0 of no whole number, and the rounding.
    largest = np.abs(column).max()
    noise, single = 4 * float(np.spacing(largest)), column.astype(np.float32)
    places = (k for k in range(10) if np.abs(column - (column * 10**k).round() / 10**k).max() <= noise)
    digit, coarse = next((10.0**-k for k in places), 0.0), float(np.spacing(np.float32(largest)))
    shortest = single[:1000].astype(str).astype(np.float64)  # of single precision, in full or in the fewest digits
    if digit < coarse and ((column[:1000] == single[:1000]) | (column[:1000] == shortest)).all():
        column, digit = single.astype(np.float64), coarse
    steps = (np.diff(column) / max(digit, noise)).round().astype(np.int64)
    if digit <= noise or not (divisor := int(np.gcd.reduce(steps))):
        return
    tick = digit * divisor
    at, slack, steps = (column - column[0]) / tick, 2 * noise / tick, steps // divisor
    yield tick * unit, at, divisor, slack
    # A tick of some digits that is rounded to whole ones makes steps such as 15, 16, 31 and 32 ms.
    sizes = np.sort(steps[(steps > 0) & (steps <= 3 * np.median(steps))])
    groups = np.split(sizes, np.flatnonzero(np.diff(sizes) > 1) + 1)
    if len(groups) > 1 and all(group[-1] - group[0] <= 1 for group in groups):
        means = np.array([group.mean() for group in groups])
        ratio = float(np.diff(means).min())
        if ratio > 2 and np.abs(means / ratio - (means / ratio).round()).max() < 0.15:
            yield tick * ratio * unit, at / ratio, 0, (2 + slack) / ratio


def _numbered(at: Array, period: float, within: float) -> tuple[Array, int]:
    """Return numbers of rows on an even clock, stamps in a strip [ticks], and how often it was set anew."""
    # A row that comes later than its number says is behind rows that were lost.
    low = high = 0.0
    number, anew, numbers = -1, 0, list[int]()
    for stamp in at.tolist():
        number += 1
        number += max(0, math.ceil((stamp - period * number - low - within) / period))
        off = stamp - period * number
        if off < high - within:
            anew, low, high = anew + 1, off, off
        low, high = min(low, off), max(high, off)
        numbers.append(number)
    return np.array(numbers, dtype=np.float64), anew


def _possible_periods(at: Array, low: float, starts: NDArray[np.int64], within: float) -> list[float]:
    """Return the shortest and the longest period [ticks] of an even clock that gives such stamps; empty of none."""
    # From each start on stamps stay in a strip of their own about even times. Two that leave it bound the period,
    # which is moved there until none does.
    found = list[float]()
    for period, way in ((low, 1), (low + 1.0, -1)):
        while True:
            off = at - period * np.arange(len(at))
            widths = np.maximum.reduceat(off, starts) - np.minimum.reduceat(off, starts)
            widest = int(widths.argmax())
            part = off[slice(*np.append(starts, len(at))[widest : widest + 2])]
            apart, beyond = int(part.argmax()) - int(part.argmin()), float(widths[widest]) - within
            if beyond <= 1e-9 + 4 * np.spacing(at[-1]):
                break
            if apart * way <= 0:
                return []
            period += beyond / apart
        found.append(period)
    return found


def _fit_even_clock(path: str, column: Array, unit: float, dt: float | None) -> tuple[Array, float, float] | None:
    """Return times of an even clock, its period and its tick [s] if it can have given such stamps, else None."""
    # Rounded to ticks, it writes steps of two neighbouring numbers of ticks, and t_k - k dt stays within one tick: any
    # two stamps bound dt. Times without that rhythm, of a clock that is late now and then, stay as they are.
    for tick, at, digits, slack in _possible_ticks(column, unit):
        steps, rows = np.diff(at).round(), len(at)
        sizes, counts = np.unique(steps, return_counts=True)
        pairs = counts + np.append(np.where(np.diff(sizes) == 1, counts[1:], 0), 0)
        low = float(sizes[pairs.argmax()])
        within = (1 + 1e-6 if low < 2 else 1.2) + slack  # wider where no lost row can look like a tick
        if dt is not None:
            period = dt / tick
            if abs(period - round(period)) * rows < 0.5 or not low <= period <= low + 1:  # even times are ticks
                continue
            numbers, anew = _numbered(at, period, within)
            if anew <= (1 - MOSTLY) * rows:
                return dt * numbers, dt, tick
            continue
        few, many = steps == low, steps == low + 1
        odd = np.flatnonzero(few if few.sum() < many.sum() else many)
        if len(odd) < (3 if low < 2 else 1):  # fewer may be lost or doubled rows, and no rhythm
            continue
        inside, between = few | many, np.diff(odd)
        starts = np.append(0, np.flatnonzero(~inside) + 1)
        found = _possible_periods(at, low, starts, within) if inside.mean() >= MOSTLY else []
        # A log may lose a tenth of its rows at random; where more steps are odd, or at even distances, a coarse clock
        # is as likely.
        rhythm = len(odd) > FEWEST and between.std() < 0.5 * between.mean()
        if not found and not (low == 1 and digits < 2 and (rhythm or len(odd) > 0.1 * rows)):
            continue
        if not found or found[1] - found[0] > 0.005 * sum(found) or (low == 1 and digits != 1):
            raise LogError("log.coarse_time", file=path, tick=tick, low=low, high=low + 1)
        period = _round_between(found[0] * tick, found[1] * tick)
        return period * _numbered(at, period / tick, within)[0], period, tick
    return None


def _round_between(low: float, high: float) -> float:
    """Return the number of seconds, or the inverse of one of hertz, of the fewest digits between two times."""
    middle = 0.5 * (low + high)
    for digits in range(1, 12):
        for value in (float(f"{middle:.{digits}g}"), 1 / float(f"{1 / middle:.{digits}g}")):
            if low <= value <= high:
                return value
    return middle


def period_of(t: Array) -> float:
    """Return the time between two rows, the median of all, as the decimal number that its digits can tell [s].

    Args:
        t: Time of each row, `(rows,)`, two or more [s].
    """
    return float(f"{np.median(np.diff(t)):.12g}")  # differences of decimals carry digits that nobody logged


def date_unit(values: Array) -> str:
    """Return the unit of times that can only be dates, as their size tells; empty for other times.

    They are of the years from 2010 to 2040, and days are told from seconds by rows that would be less than 1 ms apart.
    A part of a day, as spreadsheets write the time of day, has a period that is round in seconds of the day alone.

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
    step = float(np.nanmedian(np.diff(values)))
    told = low > 0.01 and high < 1 and 0 < step <= LONGEST_PART and _has_digits(DAY * step, 3)
    return "d" if told and not (_has_digits(step, 3) or _has_digits(1 / step, 2)) else ""


def _has_digits(value: float, digits: int) -> bool:
    """Tell whether so many digits say all of a number."""
    return abs(float(f"{value:.{digits - 1}e}") / value - 1) < 1e-4


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
    if (
        len(t) > 2
        and (np.diff(t) >= 0).all()
        and (found := _fit_even_clock(str(table.path), values, seconds, dt)) is not None
    ):
        t, period, tick = found
        said = [note("log.coarse_clock", column=name, tick=tick, dt=period)]
    said += [weak("log.whole_seconds", column=name)] if counts else []
    return t, [note("log.time", column=name, unit=unit, dates=bool(table.dated), dt=period), *said, *again]
