"""The columns of a log as numbers: what their headings say, what is no number and where, and what each of them is."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dynasindy.data.files import read_file
from dynasindy.data.headings import is_clock, named_by, plain_heading, split_unit
from dynasindy.findings import Finding, LogError, note, weak
from dynasindy.sentences import setting
from dynasindy.text import did_you_mean

Array = NDArray[np.float64]
DAY = 86400.0
CODES = frozenset((999.0, 999.9, 9999.0, 9999.9, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 2.0**31, 2.0**31 - 1))
HUGE = 1e30
"""What programs write where a sample was lost, of either sign."""
SWITCHED = {"on": 1.0, "off": 0.0, "yes": 1.0, "no": 0.0, "open": 1.0, "closed": 0.0, "true": 1.0, "false": 0.0}
"""Words for 1 and 0, in small letters."""
MANY = 0.1
"""Share of the cells from which on words in them are more than samples that were lost."""
COUNTED = 5
"""Rows from which on a column that grows by one in each is a counter; fewer may do so by chance."""
FRACTION = re.compile(r"(?:.*[\W_])?(n|u|m|nano|micro|milli)(?:s|secs?|seconds?)", re.IGNORECASE)
"""A heading of parts of a second, such as `nanosec`."""
CLOCK_OF_ITS_OWN = re.compile(r"(?:(.+)[_ ./])?(?:timestamp|time|stamp|t)(?:[_ ./](.+))?", re.IGNORECASE)
"""A heading that is the time of the columns with the same beginning, such as `left_time` or `time_left`."""


def correct_map() -> str:
    """Ask for a correct column map."""
    return f"correct the column map ({', '.join(map(setting, ('data.time', 'data.states', 'data.inputs')))})"


@dataclass(frozen=True)
class Table:
    """Hold columns of a file.

    Attributes:
        path: The file.
        frame: Numbers below the headings of the file, NaN of what is none; the index holds the line of each row.
        words: Cells that hold something else than a number, by heading: line and text of the first one, and the count.
        dated: Headings of columns that hold dates, in seconds.
        findings: What was decided.
    """

    path: Path
    frame: pd.DataFrame
    words: Mapping[str, dict[str, Any]]
    dated: frozenset[str] = frozenset()
    findings: tuple[Finding, ...] = ()

    @staticmethod
    def read(path: Path) -> Table:
        """Read a file.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is no table, or a column with values has no heading.
        """
        raw, findings = read_file(path)
        raw, findings = _with_signals_apart(raw, findings)
        headings = _plain_headings([" ".join(str(heading).split()) for heading in raw.columns])
        values, words, dated = np.empty((len(headings), len(raw))), dict[str, dict[str, Any]](), set[str]()
        kept = list[int]()
        for k, heading in enumerate(headings):
            column, wrong, is_date = _numbers(raw.iloc[:, k])
            if not is_date and (code := _lost_code(column)) is not None:
                lost = column == code
                column, line = np.where(lost, np.nan, column), int(raw.index[lost.argmax()])
                findings.append(note("log.code", column=heading, value=code, count=int(lost.sum()), line=line))
            values[k] = column
            if not heading:  # an index that a program wrote, a time that names the rows as in pandas, or nothing
                timed = any(map(is_clock, headings[1:]))
                if not k and not timed and (is_date or (grows(column) and not counts(column))):
                    heading = headings[k] = "time"
                elif k and np.isfinite(column).any() and not counts(column):
                    raise ValueError(f"{path} has numbers in column {k + 1} and no heading above them; give it one")
            if wrong is not None:
                words[heading] = wrong
            if is_date:
                dated.add(heading)
            if heading:
                kept.append(k)
        whole = values if len(kept) == len(values) else values[kept]
        frame = pd.DataFrame(whole.T, index=raw.index, columns=[headings[k] for k in kept], copy=False)
        table = Table(path, frame, words, frozenset(dated), tuple(findings))
        return _with_one_clock(_with_fractions(_with_whole_dates(table)))

    @property
    def headings(self) -> list[str]:
        """Headings of the columns."""
        return [*self.frame]

    def column(self, heading: str) -> Array:
        """Return the numbers below a heading, the first one of that name, `(rows,)`."""
        return self.frame.iloc[:, self.headings.index(heading)].to_numpy()

    def edit(self, frame: pd.DataFrame, names: Mapping[str, str], *findings: Finding) -> Table:
        """Return the table with other numbers, maybe of fewer columns, of which some get new headings."""
        words = {names.get(heading, heading): each for heading, each in self.words.items() if heading in frame}
        dated = frozenset(names.get(heading, heading) for heading in self.dated if heading in frame)
        return Table(self.path, frame.rename(columns=names), words, dated, (*self.findings, *findings))

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Return what stands below each heading: dates, words, empty, constant, counter of rows, or moving numbers."""
        kinds = dict[str, str]()
        for heading in self.headings:
            column = self.column(heading)
            numbers = column[~np.isnan(column)]
            kind = "constant" if len(numbers) and (numbers == numbers[0]).all() else "moving"
            kind = "counter" if kind == "moving" and counts(column) else kind
            none = "dates" if heading in self.dated else "words" if heading in self.words else "empty"
            kinds[heading] = none if heading in self.dated or not len(numbers) else kind
        return kinds

    def of_kind(self, *kinds: str) -> list[str]:
        """Return the headings of columns of some kinds."""
        return [heading for heading, kind in self.kinds.items() if kind in kinds]

    def moving(self) -> dict[str, Array]:
        """Return the numbers that move, without the rows in which one of them is missing."""
        frame = self.frame[self.of_kind("moving", "counter")]
        return dict(zip(frame, frame[np.isfinite(frame).all(axis=1)].to_numpy().T, strict=True))

    def select(self, names: Sequence[str], dt: float | None = None) -> Table:
        """Return the named columns, in this order; a heading `angle [rad]` may be named by `angle`.

        The first column is that of time, and alone may hold dates, which become seconds. Where the file has none and a
        sampling time is given, its rows are even.

        Args:
            names: Names or headings of the columns.
            dt: Sampling time that was given [s].

        Raises:
            ValueError: a column is missing or stands there twice, one has no number, or the time is named once more.
        """
        whole, time = self, names[0]
        blank = time in whole.headings and whole.kinds[time] == "empty"
        if dt is not None and (
            blank or (time == "time" and not named_by(time, whole.headings))
        ):  # nobody named another
            rows = pd.DataFrame({time: dt * np.arange(len(whole.frame), dtype=np.float64)}, whole.frame.index)
            others = whole.frame.drop(columns=time, errors="ignore")
            whole = whole.edit(pd.concat([rows, others], axis=1), {}, note("log.no_time"))
        places = [_find(self.path, name, whole.headings) for name in names]
        if places[0] in places[1:]:
            raise LogError("log.time_named", file=str(self.path), column=whole.headings[places[0]])
        frame = whole.frame.iloc[:, places]
        first, *others = frame
        if dates := [heading for heading in others if heading in whole.dated]:
            frame = frame.assign(**dict.fromkeys(dates, np.nan))
        words = {h: whole.words[h] for h in frame if h in whole.words and (h != first or h not in whole.dated)}
        for heading in frame.columns[frame.isna().all()] if len(frame) else ():
            if heading in words:
                raise LogError("log.worded_column", file=str(self.path), column=heading, text=words[heading]["text"])
            raise LogError("log.column_without_numbers", file=str(self.path), column=heading)
        said = (
            (weak if cells["count"] > MANY * len(frame) else note)("log.words", column=heading, **cells)
            for heading, cells in words.items()
        )
        return replace(whole.edit(frame, {}, *said), dated=whole.dated & {first})


def _plain_headings(headings: Sequence[str]) -> list[str]:
    """Return headings with plain names, but where two of these would be the same."""
    own = {*headings} - {""}  # of which `der(angle)` is none in the unit `angle`
    plain = [re.sub(r"\W+", "_", h).strip("_") if split_unit(h)[1] in own else plain_heading(h) for h in headings]
    names = [split_unit(heading)[0] for heading in plain]
    found = []
    for new, old, name in zip(plain, headings, names, strict=True):
        unit = "" if split_unit(old)[1] else split_unit(new)[1]
        found.append(new if names.count(name) == 1 else f"{old} [{unit}]" if unit else old)
    return found


def _with_signals_apart(raw: pd.DataFrame, findings: list[Finding]) -> tuple[pd.DataFrame, list[Finding]]:
    """Return a table of which each row held a time, the name of a signal, and its value, with a column a signal."""
    if raw.shape[1] != 3 or not raw.columns.is_unique:
        return raw, findings
    words = [k for k in raw if raw[k].dtype.kind not in "biuf" and 1 < raw[k].nunique() < len(raw) / 20]
    if len(words) != 1:
        return raw, findings
    time, value = (k for k in raw if k != words[0])
    if not is_clock(str(time)) or raw[value].dtype.kind not in "biuf":
        return raw, findings
    lines = pd.Series(raw.index, raw.index).groupby(raw[time], sort=False).first()
    wide = raw.pivot_table(value, time, words[0], aggfunc="last", sort=False).reindex(lines.index)
    return wide.reset_index().set_axis(lines, axis=0), [*findings, note("log.long_format", signals=[*wide])]


def _lost_code(column: Array) -> float | None:
    """Return the number that stands for lost samples: a usual code, far off all others."""
    finite = column[np.isfinite(column)]
    for end in (finite.min(), finite.max()) if len(finite) else ():
        rest, known = finite[finite != end], abs(end) in CODES or abs(end) >= HUGE
        if known and 2 * len(rest) > len(finite) and np.abs(rest - end).min() > np.ptp(rest):
            return float(end)
    return None


def _with_whole_dates(table: Table) -> Table:
    """Return a table in which a column of days and the one of the time of day are one of dates."""
    dated = {heading: table.column(heading) for heading in table.headings if heading in table.dated}
    days = [name for name, column in dated.items() if bool((np.mod(column, DAY) == 0).all()) and column.any()]
    clocks = [name for name, column in dated.items() if name not in days and bool((column < DAY).all())]
    if len(days) != 1 or len(clocks) != 1:
        return table
    (day,), (clock,) = days, clocks
    frame = table.frame.assign(**{clock: dated[clock] + dated[day]}).drop(columns=day)
    return table.edit(frame, {clock: day if is_clock(day) or not is_clock(clock) else clock})


def _with_fractions(table: Table) -> Table:
    """Return a table in which whole seconds and the column of their parts behind them are one time, as of ROS."""
    for first, heading in zip(table.headings, table.headings[1:]):
        if not (match := FRACTION.fullmatch(split_unit(heading)[0])):
            continue
        whole, parts = table.column(first), table.column(heading)
        part = {"n": 1e-9, "u": 1e-6, "m": 1e-3}[match[1][0].lower()] * parts
        if (whole % 1).any() or (parts % 1).any() or not (np.diff(whole) >= 0).all() or grows(whole):
            continue
        if grows(whole + part) and (part >= 0).all() and (part < 1).all():
            frame = table.frame.assign(**{first: whole + part}).drop(columns=heading)
            return table.edit(frame, {} if is_clock(first) else {first: "time [s]"})
    return table


def _with_one_clock(table: Table) -> Table:
    """Return a table whose columns of a second clock stand at times of the first: held, on lines, or the nearest."""
    clocks = {
        match[1] or match[2]: heading
        for heading in table.headings
        if (match := CLOCK_OF_ITS_OWN.fullmatch(split_unit(heading)[0])) and bool(match[1]) != bool(match[2])
        if heading not in table.dated and grows(table.frame[heading].dropna().to_numpy())
    }
    if len(clocks) < 2 or any(map(is_clock, table.headings)):
        return table
    (_, first), *others = clocks.items()
    frame, moved, now = table.frame.copy(), list[str](), table.column(first)
    for begin, heading in others:
        for name in table.headings:
            if re.search(rf"(?:^|[_ ./]){re.escape(begin)}(?:$|[_ ./])", name) and name != heading:
                both = np.stack([table.column(heading), table.column(name)])
                then, column = both[:, ~np.isnan(both).any(0)]
                if np.median(np.diff(then)) > 1.5 * np.nanmedian(np.diff(now)):
                    rows = np.searchsorted(0.5 * (now[1:] + now[:-1]), then)
                    frame[name] = pd.Series(column, frame.index[rows]).groupby(level=0).last().reindex(frame.index)
                elif (np.diff(column) == 0).mean() > 0.5:
                    frame[name] = column[np.clip(np.searchsorted(then, now, side="right") - 1, 0, len(then) - 1)]
                else:
                    frame[name] = np.interp(now, then, column)
                moved.append(name)
    unit, left = split_unit(first)[1], [heading for _, heading in others]
    said = note("log.second_clock", columns=moved, clocks=left, first=first)
    return table.edit(frame.drop(columns=left), {first: f"time [{unit}]" if unit else "time"}, said)


def grows(column: Array) -> bool:
    """Tell whether each number is larger than the one before."""
    return len(column) > 1 and bool((np.diff(column) > 0).all())


def counts(column: Array, step: float = 1.0) -> bool:
    """Tell whether a column grows by exactly one step from row to row, but for gaps and where it begins anew."""
    rows = np.flatnonzero(~np.isnan(column))
    if not len(rows) or np.ptp(rows) + 1 < COUNTED:
        return False
    return bool((np.diff(column[rows]) == step * np.diff(rows)).mean() > 0.9)


def _numbers(cells: pd.Series) -> tuple[Array, dict[str, Any] | None, bool]:
    """Return cells as numbers, the words in them, and whether these are dates, which become seconds."""
    if cells.dtype.kind in "biuf":
        return cells.to_numpy(dtype=np.float64), None, False
    if cells.dtype.kind in "Mm" and len(cells):
        dates = _since_1970(pd.to_datetime(cells, utc=True) if cells.dtype.kind == "M" else cells)
        return dates, {"line": int(cells.index[0]), "text": str(cells.iloc[0]), "count": len(cells)}, True
    text = cells.astype("string").str.strip()
    numbers = pd.to_numeric(text, errors="coerce").to_numpy(np.float64, na_value=np.nan)
    switched = text.str.lower().map(SWITCHED)
    if np.isnan(numbers).all() and switched.notna().any() and switched.notna().eq(text.notna()).all():
        return switched.to_numpy(np.float64, na_value=np.nan), None, False
    worded = text[np.isnan(numbers) & ~text.fillna("").str.lower().isin(["", "nan"]).to_numpy(bool)]
    if not len(worded):
        return numbers, None, False
    first = str(worded.iloc[0])
    words = {"line": int(worded.index[0]), "text": first[:40], "count": len(worded)}
    dates = _seconds(text) if np.isnan(numbers).all() and re.search(r"[^\d.,]|\.\d\d?\.\d\d", first) else numbers
    is_date = dates is not numbers and bool(np.isfinite(dates).any())
    return dates if is_date else numbers, words, is_date


def _seconds(text: pd.Series) -> Array:
    """Return the seconds of dates, times of day and durations, NaN of what is none."""
    dates = _since_1970(pd.to_datetime(text, format="ISO8601", utc=True, errors="coerce"))
    first = str(text.dropna().iloc[0])
    if np.isfinite(dates).any() or not re.search(r"\d:\d\d|^\d+[-./]\d+[-./]\d+$|\d\s*(?:s|sec|ms|us|ns)$", first):
        return dates
    if re.search(r"\d\s*(?:s|sec|ms|us|ns)$|^(?:\d+ days? )?-?\d+:\d\d(?::\d\d)?(?:\.\d+)?$", first):
        whole = text.str.replace(r"^(\d+:\d\d(?:\.\d+)?)$", r"00:\1", regex=True)
        return _since_1970(pd.to_timedelta(whole, errors="coerce"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a form that pandas has to find for each row
        # Read the wrong way round, some dates of a log over midnight are none, or months apart.
        both = [_since_1970(pd.to_datetime(text, dayfirst=day, utc=True, errors="coerce")) for day in (True, False)]
        dates = min(both, key=lambda each: (np.isnan(each).sum(), np.nanmax(np.abs(np.diff(each)), initial=0.0)))
    return np.mod(dates, DAY) if re.fullmatch(r"[\d:.]+ ?[ap]m", first, re.IGNORECASE) else dates


def _since_1970(times: pd.Series) -> Array:
    # In seconds, as nanoseconds do not reach all years.
    since = times if times.dtype.kind == "m" else times - pd.Timestamp(0, tz="UTC").as_unit("s")
    return np.asarray((since / pd.Timedelta(seconds=1)).to_numpy(dtype=np.float64, na_value=np.nan))


def _find(path: Path, name: str, headings: Sequence[str]) -> int:
    """Return the place of a column by its heading, with or without its unit."""
    named = named_by(name, headings)
    if not named:
        hint = did_you_mean(name, [*headings, *(split_unit(heading)[0] for heading in headings)])
        raise ValueError(f"{path} has no column {name!r}; allowed are {', '.join(headings)}: {correct_map()}{hint}")
    if len(named) > 1:
        raise ValueError(f"{path} has {len(named)} columns {name!r}; allowed is one: rename the others")
    return headings.index(named[0])
