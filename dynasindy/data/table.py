"""A CSV file as headings and numbers, each row with its line in the file; what cannot be read says where."""

from __future__ import annotations

import csv
import math
import re
from array import array
from codecs import getincrementaldecoder
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice, pairwise
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from dynasindy.text import did_you_mean

DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+(\d{1,2})(:\d{2}.*))?")
"""A date as it is written with points, the day first: with slashes nobody could tell the day from the month."""
ALLOWED = "2024-05-31 12:00:00.05 or 31.05.2024 12:00:00.05"
"""Dates that are read, for messages."""


def seconds_of_date(text: str) -> float:
    """Return the seconds of a date with its time of day, by ISO 8601 or with points; NaN of what is none."""
    text = text.strip()
    if found := DAY_FIRST.fullmatch(text):
        day, month, year, hour, rest = found.groups()
        text = f"{year}-{month:0>2}-{day:0>2}T{hour or '0':0>2}{rest or ':00'}"
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        return math.nan
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()  # else summer time would leave a gap


MAP = "correct the column map (data.time, data.states, data.inputs)"
SEPARATORS = ",;\t"
"""What may stand between the values of a line."""
TITLES = 50
"""Lines among which the headings are looked for, to tell a title above them."""


@dataclass(frozen=True)
class Table:
    """Hold columns of a file.

    Attributes:
        headings: headings of the columns as the file has them.
        values: what is no number is NaN, `(rows, columns)`.
        lines: line of each row in the file, `(rows,)`.
        words: sentences on cells that hold something else than a number, one for each such column.
        dated: whether the first column holds dates.
    """

    headings: tuple[str, ...]
    values: NDArray[np.float64]
    lines: NDArray[np.int64]
    words: tuple[str, ...] = ()
    dated: bool = False


def read_columns(path: Path, names: Sequence[str]) -> Table:
    """Read the named columns of a file; a heading `angle [rad]` may be named by `angle`.

    The first column is that of time, and may hold dates, such as `2024-05-31 12:00:00.05`, which become seconds.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no table of text, a column is missing or stands there twice, or one has values and none
            of them is a number.
    """
    (_, headings), rows = rows_of(path)
    columns = [_find(path, name, headings) for name in names]
    values, lines = array("d"), array("q")
    first: dict[int, str] = {}
    wrong: dict[int, list[tuple[int, str]]] = {}
    dated = False
    for line, row in rows:
        if len(row) > len(headings) and any(text.strip() for text in row[len(headings) :]):
            raise ValueError(
                f"{path}, line {line} has {len(row)} values for {len(headings)} headings; allowed is one each: put "
                "points into decimals, or semicolons between columns"
            )
        lines.append(line)
        texts = [row[k] if k < len(row) else "" for k in columns]
        numbers = list(map(parse_number, texts))
        if texts and math.isnan(numbers[0]):
            numbers[0] = seconds_of_date(texts[0])
            dated = dated or not math.isnan(numbers[0])
        for k, (value, text) in enumerate(zip(numbers, texts, strict=True)):
            if math.isnan(value) and text.strip().lower() not in ("", "nan"):
                wrong.setdefault(k, []).append((line, text.strip()[:40]))
        values.extend(numbers)
        first = first or {k: text for k, text in zip(columns, texts, strict=True) if text.strip()}
    found = tuple(headings[k] for k in columns)
    words = tuple(_told(found[k], *told[0], len(told) - 1) for k, told in sorted(wrong.items()))
    cells = np.array(values).reshape(len(lines), len(names))
    table = Table(found, cells, np.array(lines, dtype=np.int64), words, dated)
    for k, heading, column in zip(columns, found, table.values.T, strict=True):
        if k in first and np.isnan(column).all():
            raise ValueError(
                f"{path}, column {heading!r} has no number, but values such as {first[k][:40]!r}; allowed are numbers, "
                f"and of time dates such as {ALLOWED}: convert the column, words such as ON and OFF to 1 and 0"
            )
    return table


def _told(heading: str, line: int, text: str, more: int) -> str:
    """Say which cell of a column holds text, and how many more of them do."""
    first = f"line {line}, column {heading!r} holds {text!r}, which is no number"
    if not more:
        return f"{first}; it counts as missing"
    others = "1 more cell of the column holds none" if more == 1 else f"{more} more cells of the column hold none"
    return f"{first}, and {others}; they count as missing"


def all_headings(path: Path) -> list[str]:
    """Return all headings of a file."""
    return rows_of(path)[0][1]


def split_unit(heading: str) -> tuple[str, str]:
    """Split `angle [rad]` or `angle (rad)` into name and unit; the unit is empty where there is none."""
    found = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", heading)
    return (found[1], (found[2] or found[3] or "").strip()) if found and found[1] else (heading, "")


def named_by(name: str, headings: Sequence[str]) -> list[str]:
    """Return the headings that a name means: its own, else those of which it is the name, else those in other brackets.

    So `T`, `T [degC]` and `T(degC)` all name the column `T [degC]`.
    """
    same: tuple[Callable[[str], bool], ...] = (
        lambda heading: heading == name,
        lambda heading: split_unit(heading)[0] == name,
        lambda heading: split_unit(heading) == split_unit(name),
    )
    return next(filter(None, ([h for h in headings if alike(h)] for alike in same)), [])


def parse_number(text: str) -> float:
    """Return a number, NaN for what is none; a comma that is left in a value is that of a decimal."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan


def _find(path: Path, name: str, headings: Sequence[str]) -> int:
    """Return the place of a column by its heading, with or without its unit."""
    named = named_by(name, headings)
    places = [k for k, heading in enumerate(headings) if heading in named]
    if not places:
        hint = did_you_mean(name, [*headings, *(split_unit(heading)[0] for heading in headings)])
        raise ValueError(f"{path} has no column {name!r}; allowed are {', '.join(headings)}: {MAP}{hint}")
    if len(places) > 1:
        raise ValueError(f"{path} has {len(places)} columns {name!r}; allowed is one: rename the others")
    return places[0]


def rows_of(path: Path) -> tuple[tuple[int, list[str]], Iterator[tuple[int, list[str]]]]:
    """Return the line and fields of the headings, and of the rows below them; rows without a value are no rows.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no table of text, or does not begin with a line of headings.
    """
    rows = _lines(path)
    line, fields = next(rows, (0, []))
    headings = [field.strip() for field in fields]
    if not any(headings):
        raise ValueError(f"{path} is empty or begins with an empty line; allowed is a CSV file with a line of headings")
    if all(not math.isnan(parse_number(heading)) for heading in headings):
        names = ",".join(["time", *(f"x{k}" for k in range(1, len(headings) - 1)), "u"][: len(headings)])
        raise ValueError(
            f"{path} has numbers in line {line}, where headings are wanted; allowed is a CSV file with a line of "
            f"headings: write one above, such as {names}, with names and units of yours, as in angle [deg]; columns "
            "that are called u or u_... are inputs, all others but time are states"
        )
    if below := _below_a_title(path):
        what = f"line 1 holds {', '.join(filter(None, headings))[:60]!r}"
        raise ValueError(
            f"{path}: {what}, as a title does, and the headings seem to stand in line {below}; allowed is a CSV file "
            f"whose first line holds the headings: delete what stands above line {below}"
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


def _below_a_title(path: Path) -> int:
    """Return the line of the headings if a title stands above them, else 0.

    Headings are words above numbers, and more of them than the title has parts; a line of units has as many.
    """
    with _opened(path) as file:
        lines = [line.rstrip("\r\n") for line in islice(file, TITLES)]
    for k, (line, below) in enumerate(pairwise(lines)):
        separator = max(SEPARATORS, key=line.count)
        words, values = ([part.strip() for part in text.split(separator)] for text in (line, below))
        title = [part for part in lines[0].split(separator) if part.strip()]
        wordy = all(math.isnan(parse_number(word)) for word in words)
        if len(words) == len(values) > 1 and wordy and any(not math.isnan(parse_number(value)) for value in values):
            return k + 1 if len(title) < len([word for word in words if word]) else 0
    return 0


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
    return max(SEPARATORS, key=first.count)
