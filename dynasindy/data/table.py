"""A CSV file as headings and numbers, each row with its line in the file; what cannot be read says where."""

from __future__ import annotations

import csv
import math
import re
from array import array
from codecs import getincrementaldecoder
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

MAP = "correct the column map (data.time, data.states, data.inputs)"
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
    **dict.fromkeys(("millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("minute", "minutes"), 60.0),
    **dict.fromkeys(("hour", "hours"), 3600.0),
}
"""Units of time, in seconds; capital letters are as good."""
CLOCKS = ("time", "t", "timestamp")
"""What a column of time is called, in small letters."""
CLOCK = "time"
"""Heading of the time where no other is given; `Time` or `t` is taken where the file has none."""


@dataclass(frozen=True)
class Table:
    """Hold columns of a file.

    Attributes:
        headings: headings of the columns as the file has them.
        values: what is no number is NaN, `(rows, columns)`.
        lines: line of each row in the file, `(rows,)`.
        words: sentences on cells that hold something else than a number, one for each such column.
    """

    headings: tuple[str, ...]
    values: NDArray[np.float64]
    lines: NDArray[np.int64]
    words: tuple[str, ...] = ()


def read_table(path: Path, names: Sequence[str]) -> Table:
    """Read the named columns of a file; a heading `angle [rad]` may be named by `angle`.

    The first column is that of time, and may hold dates, such as `2024-05-31 12:00:00.05`, which become seconds.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no table of text, a column is missing or stands there twice, or one has values and none
            of them is a number.
    """
    (_, headings), rows = _rows(path)
    columns = [_find(path, name, headings) for name in names]
    values, lines = array("d"), array("q")
    first: dict[int, str] = {}
    wrong: dict[int, list[tuple[int, str]]] = {}
    for line, row in rows:
        if len(row) > len(headings) and any(text.strip() for text in row[len(headings) :]):
            raise ValueError(
                f"{path}, line {line} has {len(row)} values for {len(headings)} headings; allowed is one each: put "
                "points into decimals, or semicolons between columns"
            )
        lines.append(line)
        texts = [row[k] if k < len(row) else "" for k in columns]
        numbers = list(map(number, texts))
        if texts and math.isnan(numbers[0]):
            numbers[0] = _date(texts[0])
        for k, (value, text) in enumerate(zip(numbers, texts, strict=True)):
            if math.isnan(value) and text.strip().lower() not in ("", "nan"):
                wrong.setdefault(k, []).append((line, text.strip()[:40]))
        values.extend(numbers)
        first = first or {k: text for k, text in zip(columns, texts, strict=True) if text.strip()}
    found = tuple(headings[k] for k in columns)
    words = tuple(_told(found[k], *cells[0], len(cells) - 1) for k, cells in sorted(wrong.items()))
    table = Table(found, np.array(values).reshape(len(lines), len(names)), np.array(lines, dtype=np.int64), words)
    for k, heading, column in zip(columns, found, table.values.T, strict=True):
        if k in first and np.isnan(column).all():
            raise ValueError(
                f"{path}, column {heading!r} has no number, but values such as {first[k][:40]!r}; allowed are numbers, "
                "and of time dates such as 2024-05-31 12:00:00.05: convert the column"
            )
    return table


def _told(heading: str, line: int, text: str, more: int) -> str:
    """Say which cell of a column holds text, and how many more of them do."""
    first = f"line {line}, column {heading!r} holds {text!r}, which is no number"
    if not more:
        return f"{first}; it counts as missing"
    others = "1 more cell of the column holds none" if more == 1 else f"{more} more cells of the column hold none"
    return f"{first}, and {others}; they count as missing"


def numeric_headings(path: Path) -> list[str]:
    """Return the headings of columns that hold a number somewhere; the others are comments, or empty.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no table of text, a heading is missing, or two agree but for their unit.
    """
    (_, headings), rows = _rows(path)
    names = [split_unit(heading)[0] for heading in headings]
    if double := sorted({name for name in names if name and names.count(name) > 1}):
        raise ValueError(
            f"{path} has {', '.join(map(repr, double))} more than once in its headings; rename all but one"
        )
    waiting = set(range(len(headings)))
    for _, row in rows:
        waiting -= {k for k in waiting if k < len(row) and not math.isnan(number(row[k]))}
        if not waiting:
            break
    found = [k for k in range(len(headings)) if k not in waiting]
    if nameless := [k + 1 for k in found if k and not headings[k]]:  # the first may be the index of another program
        raise ValueError(f"{path} has numbers in column {nameless[0]} and no heading above them; give it one")
    return [headings[k] for k in found if headings[k]]


def all_headings(path: Path) -> list[str]:
    """Return all headings of a file."""
    return _rows(path)[0][1]


def split_unit(heading: str) -> tuple[str, str]:
    """Split `angle [rad]` or `angle (rad)` into name and unit; the unit is empty where there is none."""
    found = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", heading)
    return (found[1], (found[2] or found[3] or "").strip()) if found and found[1] else (heading, "")


def seconds_of(path: Path, heading: str) -> float:
    """Return how many seconds the unit of a time column is; without a unit it is seconds.

    Raises:
        ValueError: the unit is not one of time.
    """
    unit = split_unit(heading)[1]
    if unit and unit.lower() not in SECONDS:
        raise ValueError(
            f"{path} has the time column {heading!r}; allowed units are {', '.join(SECONDS)}, or none for s: rename it"
        )
    return SECONDS.get(unit.lower(), 1.0)


def clock_of(headings: Sequence[str], time: str = CLOCK) -> str:
    """Return the heading of the column of time: the one that is named, or the only one that can be meant.

    Where nobody named one and no heading is `time`, it is `Time` or `t`, or `T` with a unit of time, for alone it may
    be a temperature. What is not there is returned as it was named.

    Args:
        headings: All headings of the file.
        time: Heading or name of the column; `time` if nobody named one.
    """
    split = {heading: split_unit(heading) for heading in headings}
    if time != CLOCK or any(time in (heading, name) for heading, (name, _) in split.items()):
        return time
    meant = [
        heading
        for heading, (name, unit) in split.items()
        if (unit.lower() in SECONDS and name.lower() in CLOCKS) or (not unit and name.lower() in CLOCKS and name != "T")
    ]
    return meant[0] if len(meant) == 1 else time


def number(text: str) -> float:
    """Return a number, NaN for what is none; a comma that is left in a value is that of a decimal."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan


def _date(text: str) -> float:
    """Return the seconds of a date with its time of day, NaN for what is none."""
    try:
        found = datetime.fromisoformat(text.strip())
    except ValueError:
        return math.nan
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()  # else summer time would leave a gap


def _find(path: Path, name: str, headings: Sequence[str]) -> int:
    """Return the place of a column by its heading, else by its heading without the unit."""
    places = [k for k, h in enumerate(headings) if h == name]
    places = places or [k for k, h in enumerate(headings) if split_unit(h)[0] == name]
    if not places:
        raise ValueError(f"{path} has no column {name!r}; allowed are {', '.join(headings)}: {MAP}")
    if len(places) > 1:
        raise ValueError(f"{path} has {len(places)} columns {name!r}; allowed is one: rename the others")
    return places[0]


def _rows(path: Path) -> tuple[tuple[int, list[str]], Iterator[tuple[int, list[str]]]]:
    """Return the line and fields of the headings, and of the rows below them; rows without a value are no rows."""
    rows = _lines(path)
    line, fields = next(rows, (0, []))
    headings = [field.strip() for field in fields]
    if not any(headings):
        raise ValueError(f"{path} is empty or begins with an empty line; allowed is a CSV file with a line of headings")
    if all(not math.isnan(number(heading)) for heading in headings):
        names = ",".join(["time", *(f"x{k}" for k in range(1, len(headings) - 1)), "u"][: len(headings)])
        raise ValueError(
            f"{path} has numbers in line {line}, where headings are wanted; allowed is a CSV file with a line of "
            f"headings: write one above, such as {names}, with names and units of yours, as in angle [deg]; columns "
            "that are called u or u_... are inputs, all others but time are states"
        )
    return (line, headings), rows


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    with _opened(path) as file:
        reader, before = csv.reader(file, delimiter=_separator(file)), 0
        try:
            for row in reader:
                if reader.line_num > before + 1:
                    raise ValueError(
                        f"{path}, line {before + 1}: a quote opens that is not closed in its line, so the lines up "
                        f"to {reader.line_num} would be one value; close or remove it"
                    )
                before = reader.line_num
                if row:
                    yield before, row
        except csv.Error as error:
            raise ValueError(
                f"{path}, after line {before}: {error}; allowed are lines of short values: look for a quote that is "
                "not closed"
            ) from error


def _opened(path: Path) -> TextIO:
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist or is no file; allowed is a CSV file with a line of headings: correct data.path"
        )
    with path.open("rb") as file:
        begin = file.read(4096)
    wide = begin.startswith((b"\xff\xfe", b"\xfe\xff"))
    if b"\0" in begin and not wide:
        raise ValueError(f"{path} is not text; allowed is a CSV file with a line of headings: export the log as CSV")
    # A degree sign in a heading is one byte where Windows wrote it, which is no UTF-8.
    encoding = "utf-16" if wide else "utf-8-sig"
    try:
        getincrementaldecoder("utf-8")().decode(begin)
    except UnicodeDecodeError:
        encoding = encoding if wide else "cp1252"
    return path.open(newline="", encoding=encoding, errors="replace")


def _separator(file: TextIO) -> str:
    """Guess the separator from the line of headings, and go back to it."""
    first = file.readline(100_000)
    file.seek(0)
    return max(",;\t", key=first.count)
