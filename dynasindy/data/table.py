"""The columns of a log as numbers: what their headings say, what is no number and where, and a summary of each."""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dynasindy.data.files import MEASURED, PLAIN, read_file
from dynasindy.data.headings import UNITS, is_clock, named_by, plain_heading, plain_headings, split_unit
from dynasindy.findings import Finding, LogError, note
from dynasindy.sentences import setting
from dynasindy.text import did_you_mean

Array = NDArray[np.float64]
DAY_FIRST = re.compile(r"\d{1,2}\.\d{1,2}\.\d{4}\b.*")
"""A date as it is written with points, the day first: with slashes nobody could tell the day from the month."""
ALLOWED = "2024-05-31 12:00:00.05 or 31.05.2024 12:00:00.05"
"""Dates that are read, for messages."""


def correct_map() -> str:
    """Ask for a correct column map."""
    return f"correct the column map ({', '.join(map(setting, ('data.time', 'data.states', 'data.inputs')))})"


THOUSANDS = r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?"
"""A number whose commas part thousands, where all commas of a column do."""
DAY = 86400.0
CODES = frozenset((999.0, 999.9, 9999.0, 9999.9, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 2.0**31, 2.0**31 - 1))
HUGE = 1e30
"""What programs write where a sample was lost, of either sign."""
COUNTED = 5
"""Rows from which on a column that grows by one in each is a counter; fewer may do so by chance."""
STRAIGHT = 1e-3
"""Part of its range by which a second clock may be off the first one."""
TICKS = 3
"""Steps from which on they are those of a clock."""
REGULAR = 0.9
"""Share of the rows of a counter that follow the one before without a gap."""


@dataclass(frozen=True)
class Words:
    """Cells of a column that are no numbers: the line and text of the first one, and how many there are."""

    line: int
    text: str
    count: int


@dataclass(frozen=True)
class Table:
    """Hold columns of a file.

    Attributes:
        headings: headings of the columns as the file has them.
        values: what is no number is NaN, `(rows, columns)`.
        lines: line of each row in the file, `(rows,)`.
        words: cells that hold something else than a number, by heading.
        dated: headings of columns that hold dates, in seconds.
        findings: what was decided.
    """

    headings: tuple[str, ...]
    values: Array
    lines: NDArray[np.int64]
    words: Mapping[str, Words] = field(default_factory=dict)
    dated: frozenset[str] = frozenset()
    findings: tuple[Finding, ...] = ()

    def column(self, heading: str) -> Array:
        """Return the numbers below a heading, `(rows,)`."""
        return self.values[:, self.headings.index(heading)]

    def edit(self, values: Array, without: Collection[str], names: Mapping[str, str]) -> Table:
        """Return the table with other values, without some columns and with new headings of others."""
        columns = [k for k, heading in enumerate(self.headings) if heading not in without]
        headings = tuple(names.get(self.headings[k], self.headings[k]) for k in columns)
        words = {names.get(heading, heading): each for heading, each in self.words.items() if heading not in without}
        dated = frozenset(names.get(heading, heading) for heading in self.dated if heading not in without)
        return replace(self, headings=headings, values=values[:, columns], words=words, dated=dated)


def read_columns(path: Path) -> Table:
    """Read a file; a file that was read just before is not read again.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no table, or a column with values has no heading.
    """
    state = path.stat() if path.is_file() else None
    return _read(path, *((state.st_mtime_ns, state.st_size) if state else (0, 0)))


@lru_cache(maxsize=2)
def _read(path: Path, changed: int, size: int) -> Table:
    raw = read_file(path)
    headings = plain_headings([" ".join(str(heading).split()) for heading in raw.headings])
    values, words, dated = np.empty((len(raw.lines), len(headings))), dict[str, Words](), set[str]()
    codes = list[Finding]()
    for k, heading in enumerate(headings):
        cells, unit = _without_unit(raw.frame[k])
        if unit and not split_unit(heading)[1]:
            heading = headings[k] = plain_heading(f"{heading} [{unit}]")
        values[:, k], wrong, is_date = _numbers(cells, raw.lines)
        if not is_date and (code := _lost_code(values[:, k])) is not None:
            rows = np.flatnonzero(values[:, k] == code)
            values[rows, k] = np.nan
            codes.append(note("log.code", column=heading, value=code, count=len(rows), line=int(raw.lines[rows[0]])))
        first = not k and not heading and not any(map(is_clock, headings[1:]))
        if first and (is_date or (grows(values[:, k]) and not _counts(values[:, k]))):
            heading = headings[k] = "time"  # that rows are named by, as pandas writes it
        if wrong is not None:
            words[heading] = wrong
        if is_date:
            dated.add(heading)
    kept = [k for k, heading in enumerate(headings) if heading or np.isfinite(values[:, k]).any()]
    for k in [k for k in kept if not headings[k]]:
        if k and not _counts(values[:, k]):
            raise ValueError(f"{path} has numbers in column {k + 1} and no heading above them; give it one")
        kept.remove(k)  # an index that a program wrote
    before = [headings.index(headings[k]) for k in range(len(headings))]
    numbers = (k for k in kept if before[k] < k and headings[k] not in words)
    same = [k for k in numbers if np.array_equal(values[:, before[k]], values[:, k], equal_nan=True)]
    found = [headings[k] for k in kept if k not in same]
    findings = [note("log.same_columns", columns=sorted({headings[k] for k in same}))] if same else []
    values = values[:, [k for k in kept if k not in same]]
    table = Table(tuple(found), values, raw.lines, words, frozenset(dated), (*raw.findings, *codes, *findings))
    return _with_one_clock(_with_fractions(_with_whole_dates(table)))


def _lost_code(column: Array) -> float | None:
    """Return the number that stands for samples that were lost: a usual one, farther off the others than these lie."""
    finite = column[np.isfinite(column)]
    for end in (finite.min(), finite.max()) if len(finite) else ():
        rest = finite[finite != end]
        if (abs(end) in CODES or abs(end) >= HUGE) and len(rest) and np.abs(rest - end).min() > np.ptp(rest):
            return float(end)
    return None


def _with_whole_dates(table: Table) -> Table:
    """Return a table in which a column of days and the one of the time of day are one column of dates."""
    dated = {heading: table.column(heading) for heading in table.headings if heading in table.dated}
    days = [name for name, column in dated.items() if bool((np.mod(column, DAY) == 0).all()) and column.any()]
    clocks = [name for name, column in dated.items() if name not in days and bool((column < DAY).all())]
    if len(days) != 1 or len(clocks) != 1:
        return table
    values = table.values.copy()
    values[:, table.headings.index(clocks[0])] += dated[days[0]]
    time = days[0] if is_clock(days[0]) or not is_clock(clocks[0]) else clocks[0]
    return table.edit(values, days, {clocks[0]: time})


FRACTION = re.compile(r"(?:.*[\W_])?(n|u|m|nano|micro|milli)(?:s|secs?|seconds?)", re.IGNORECASE)
"""A heading of parts of a second, such as `nanosec`."""


def _with_fractions(table: Table) -> Table:
    """Return a table in which whole seconds and the column of their parts behind them are one time, as of ROS."""
    for k, heading in enumerate(table.headings):
        match = FRACTION.fullmatch(split_unit(heading)[0])
        whole, parts = table.values[:, k - 1], table.values[:, k]
        if not (match and k) or (whole % 1).any() or (parts % 1).any() or not (np.diff(whole) >= 0).all():
            continue
        scale = {"n": 1e-9, "nano": 1e-9, "u": 1e-6, "micro": 1e-6}.get(match[1].lower(), 1e-3)
        seconds = whole + scale * parts
        if grows(whole) or not grows(seconds) or (parts < 0).any() or (scale * parts >= 1).any():
            continue
        values, first = table.values.copy(), table.headings[k - 1]
        values[:, k - 1] = seconds
        return table.edit(values, [heading], {} if is_clock(first) else {first: "time [s]"})
    return table


CLOCK_OF_ITS_OWN = re.compile(r"(.+[_ ./])(timestamp|time|stamp|t)", re.IGNORECASE)
"""A heading that is the time of the columns with the same beginning, such as `left_time`."""


def _with_one_clock(table: Table) -> Table:
    """Return a table whose columns of a second clock are taken to the times of the first one.

    A column that is held for most of the time keeps its last value; others are on straight lines between two samples.
    """
    clocks = dict[str, str]()
    for heading in table.headings:
        match = CLOCK_OF_ITS_OWN.fullmatch(split_unit(heading)[0])
        if match and heading not in table.dated and grows(table.column(heading)):
            clocks[match[1]] = heading
    if len(clocks) < 2 or any(map(is_clock, table.headings)):
        return table
    (_, first), *others = clocks.items()
    values, moved, now = table.values.copy(), [], table.column(first)
    for begin, heading in others:
        then = table.column(heading)
        for k, name in enumerate(table.headings):
            if name.startswith(begin) and name != heading:
                held = (np.diff(values[:, k]) == 0).mean() > 0.5
                at = np.clip(np.searchsorted(then, now, side="right") - 1, 0, len(then) - 1)
                values[:, k] = values[at, k] if held else np.interp(now, then, values[:, k])
                moved.append(name)
    unit, left = split_unit(first)[1], [heading for _, heading in others]
    second = note("log.second_clock", columns=moved, clocks=left, first=first)
    edited = table.edit(values, left, {first: f"time [{unit}]" if unit else "time"})
    return replace(edited, findings=(*table.findings, second))


def grows(column: Array) -> bool:
    """Tell whether each number is larger than the one before."""
    return len(column) > 1 and bool((np.diff(column) > 0).all())


def _keeps_time(column: Array, t: Array) -> bool:
    """Tell whether a column grows as a time does, on a straight line or in even ticks of more than a row."""
    rows = np.isfinite(column) & np.isfinite(t)
    x, t = column[rows], t[rows]
    if len(t) < COUNTED or not grows(t):
        return False
    steps = np.diff(x)
    off = np.abs(x - x[0] - np.ptp(x) / (t[-1] - t[0]) * (t - t[0])).max()
    ticks = steps.max() if (steps > 0).sum() >= TICKS else 0.0
    return bool((steps >= 0).all() and steps.max() > 0 and off <= max(ticks, STRAIGHT * np.ptp(x)))


def _without_unit(column: pd.Series) -> tuple[pd.Series, str]:
    """Return cells without the unit behind their numbers, and this unit, where all that have one have the same."""
    if column.dtype.kind in "biuf":
        return column, ""
    text = column.astype("string").str.strip()
    units = text.str.extract(f"^{MEASURED.pattern}$")[1].dropna().unique()
    unit = units[0] if len(units) == 1 and units[0].lower() in UNITS else ""
    return text.str.removesuffix(unit) if unit else column, unit


def _numbers(column: pd.Series, lines: NDArray[np.int64]) -> tuple[Array, Words | None, bool]:
    """Return a column as numbers, the words in it, and whether these are dates, which become seconds."""
    if column.dtype.kind in "biuf":
        return column.to_numpy(dtype=np.float64), None, False
    text = column.astype("string").str.strip()
    points = text.str.translate(PLAIN).str.replace(",", ".", regex=False)
    points = points.str.replace(r"(?<=\d) (?=\d{3}(?:\D|$))", "", regex=True)
    points = points.str.replace(r"(?<=\d)[dD](?=[+-]?\d+$)", "e", regex=True)  # as Fortran writes
    comma = text.str.contains(",", regex=False).fillna(False)
    if comma.any() and text[comma].str.fullmatch(THOUSANDS).all():
        points = text.str.translate(PLAIN).str.replace(",", "", regex=False)
    numbers = pd.to_numeric(points, errors="coerce").to_numpy(np.float64, na_value=np.nan)
    worded = np.isnan(numbers) & ~text.fillna("").str.lower().isin(["", "nan"]).to_numpy(bool)
    if not worded.any():
        return numbers, None, False
    first = int(np.flatnonzero(worded)[0])
    said = str(text[first])
    words = Words(int(lines[first]), said[:40], int(worded.sum()))
    may_be_date = np.isnan(numbers).all() and (DAY_FIRST.fullmatch(said) or not re.fullmatch(r"[\d.,]*", said))
    if may_be_date and np.isfinite(_seconds(text.iloc[[first]]))[0]:
        dates = _seconds(text)
        return dates, words, bool(np.isfinite(dates).any())
    return numbers, words, False


def _seconds(text: pd.Series) -> Array:
    """Return the seconds of dates, NaN of what is none."""
    text = text.str.replace(",", ".", regex=False).str.replace(r"^\[|\]$|(?<=\d) ?[A-Z]{3,4}$", "", regex=True)
    text = text.str.replace(r"(:\d\d:\d\d):(\d{1,6})$", r"\1.\2", regex=True)  # a colon before the milliseconds
    dates = pd.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
    since = _since(dates - pd.Timestamp(0, tz="UTC"))
    return since if np.isfinite(since).any() else _other_dates(text)


def _since(times: pd.Series) -> Array:
    return np.asarray((times / pd.Timedelta(seconds=1)).to_numpy(dtype=np.float64, na_value=np.nan))


def _other_dates(text: pd.Series) -> Array:
    """Return the seconds of times of day, durations and dates in other forms, NaN of what is none.

    Whether the day or the month is first has to be told by the dates, or to make no difference from row to row.
    """
    first = str(text.dropna().iloc[0])
    if re.search(r"\d\s*(?:s|sec|ms|us|ns)$|^(?:\d+ days? )?-?\d+:\d\d(?::\d\d)?(?:\.\d+)?$", first):
        whole = text.str.replace(r"^(\d+:\d\d(?:\.\d+)?)$", r"00:\1", regex=True)
        return _since(pd.to_timedelta(whole, errors="coerce"))
    if not re.search(r"\d:\d\d|^\d+[-./]\d+[-./]\d+$", first):
        return np.full(len(text), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a form that pandas has to find for each row
        read = [pd.to_datetime(text, dayfirst=day, utc=True, errors="coerce") for day in (False, True)]
    months, days = (_since(dates - pd.Timestamp(0, tz="UTC")) for dates in read)
    lost = np.isnan(months).sum() - np.isnan(days).sum()
    steps = [np.abs(np.diff(each)) for each in (months, days)]
    if not lost and np.isfinite(steps[0]).any() and np.nanmedian(steps[0]) == np.nanmedian(steps[1]):
        lost = np.nanmax(steps[0]) - np.nanmax(steps[1])  # at midnight a day goes by, and not a month
    told = lost or DAY_FIRST.match(first) or np.array_equal(steps[0], steps[1], equal_nan=True)
    found = np.full(len(days), np.nan) if not told else months if lost < 0 else days
    return np.mod(found, DAY) if re.fullmatch(r"[\d:.]+ ?[ap]m", first, re.IGNORECASE) else found


def select_columns(path: Path, names: Sequence[str], dt: float | None = None) -> Table:
    """Return the named columns of a file, in this order; a heading `angle [rad]` may be named by `angle`.

    The first column is that of time, and alone may hold dates, which become seconds. Where the file has none and a
    sampling time is given, its rows are even.

    Args:
        path: The file.
        names: Names or headings of the columns.
        dt: Sampling time that was given [s].

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no table, a column is missing or stands there twice, or one has no number.
    """
    whole = read_columns(path)
    time, even = names[0], (dt or 0.0) * np.arange(len(whole.lines), dtype=np.float64)
    blank = time in whole.headings and time not in whole.words and bool(np.isnan(whole.column(time)).all())
    if dt is not None and (blank or (time == "time" and not named_by("time", whole.headings))):  # nobody named another
        others = [k for k, heading in enumerate(whole.headings) if heading != time]
        whole = replace(
            whole,
            headings=(time, *(whole.headings[k] for k in others)),
            values=np.column_stack([even, whole.values[:, others]]),
            findings=(*whole.findings, note("log.no_time")),
        )
    places = [_find(path, name, whole.headings) for name in names]
    found = tuple(whole.headings[k] for k in places)
    values = whole.values[:, places]
    words = {}
    for k, heading in enumerate(found):
        if heading in whole.dated and k:
            values[:, k] = np.nan
        if heading in whole.words and not (heading in whole.dated and not k):
            words[heading] = whole.words[heading]
        if not len(values) or not np.isnan(values[:, k]).all():
            continue
        if heading not in words:
            raise LogError("log.column_without_numbers", file=str(path), column=heading)
        raise ValueError(
            f"{path}, column {heading!r} has no number, but values such as {words[heading].text!r}; allowed are "
            f"numbers, and of time dates such as {ALLOWED}: convert the column, words such as ON and OFF to 1 and 0"
        )
    worded = (
        note("log.words", line=each.line, column=heading, text=each.text, count=each.count)
        for heading, each in words.items()
    )
    dated = frozenset(found[:1]) & whole.dated
    return Table(found, values, whole.lines, words, dated, (*whole.findings, *worded))


def _find(path: Path, name: str, headings: Sequence[str]) -> int:
    """Return the place of a column by its heading, with or without its unit."""
    named = named_by(name, headings)
    places = [k for k, heading in enumerate(headings) if heading in named]
    if not places:
        hint = did_you_mean(name, [*headings, *(split_unit(heading)[0] for heading in headings)])
        raise ValueError(f"{path} has no column {name!r}; allowed are {', '.join(headings)}: {correct_map()}{hint}")
    if len(places) > 1:
        raise ValueError(f"{path} has {len(places)} columns {name!r}; allowed is one: rename the others")
    return places[0]


def _counts(column: Array) -> bool:
    """Tell whether a column grows by exactly one from row to row, but for gaps and where it begins anew."""
    rows = np.flatnonzero(~np.isnan(column))
    if not len(rows) or np.ptp(rows) + 1 < COUNTED:
        return False
    return bool((np.diff(column[rows]) == np.diff(rows)).mean() > REGULAR)


@dataclass(frozen=True)
class ColumnSummary:
    """Hold the headings of a file by what stands below them.

    Attributes:
        headings: All headings.
        numeric: Those of columns that hold a number somewhere.
        still: Those of numeric columns that hold one number from beginning to end, with this number.
        worded: Those of columns that hold text and no number, with the first text.
        dated: Those of `worded` whose first text is a date.
        counting: Those of numeric columns that grow by exactly one in each row.
        moving: Numeric columns that are not still, without the rows in which one of them lacks a value.
        table: The file.
    """

    headings: tuple[str, ...]
    numeric: tuple[str, ...]
    still: dict[str, float]
    worded: dict[str, str]
    dated: tuple[str, ...]
    counting: tuple[str, ...]
    moving: dict[str, Array]
    table: Table

    @property
    def growing(self) -> list[str]:
        """Headings of the columns that grow from row to row."""
        return [heading for heading, column in self.moving.items() if grows(column)]

    def clocks(self, time: str | None) -> list[str]:
        """Return the headings of numeric columns that tell the time once more, as another clock does."""
        if time not in self.headings:
            return []
        t = self.table.column(time)
        return [heading for heading in self.numeric if heading != time and _keeps_time(self.table.column(heading), t)]


def summarise_columns(path: Path) -> ColumnSummary:
    """Say what stands in the columns of a file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no table, a heading is missing, or two agree but for their unit.
    """
    table = read_columns(path)
    names = [split_unit(heading)[0] for heading in table.headings]
    if double := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(
            f"{path} has {', '.join(map(repr, double))} more than once in its headings; rename all but one"
        )
    dated = tuple(heading for heading in table.headings if heading in table.dated)
    found = {h: c[~np.isnan(c)] for h, c in zip(table.headings, table.values.T, strict=True) if h not in dated}
    numeric = tuple(heading for heading, column in found.items() if len(column))
    still = {h: float(found[h][0]) for h in numeric if (found[h] == found[h][0]).all()}
    worded = {h: words.text for h, words in table.words.items() if h not in numeric}
    counting = tuple(h for h in numeric if _counts(table.column(h)))
    moving = [table.headings.index(heading) for heading in numeric if heading not in still]
    values = table.values[:, moving]
    columns = {table.headings[k]: c for k, c in zip(moving, values[np.isfinite(values).all(1)].T, strict=True)}
    return ColumnSummary(table.headings, numeric, still, worded, dated, counting, columns, table)
