"""What the headings of a log leave open: columns summarised, and the settings for time and inputs filled in."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.clock import CLOCK, clock_of, is_counter, parts_of
from dynasindy.data.table import parse_number, read_columns, rows_of, seconds_of_date, split_unit

COUNTED = 5
"""Rows from which on a column that grows by one in each is a counter; fewer may do so by chance."""


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
    """

    headings: tuple[str, ...]
    numeric: tuple[str, ...]
    still: dict[str, float]
    worded: dict[str, str]
    dated: tuple[str, ...]
    counting: tuple[str, ...]


def summarise_columns(path: Path) -> ColumnSummary:
    """Look at the columns of a file, no further down than is needed to know them.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no table of text, a heading is missing, or two agree but for their unit.
    """
    (_, headings), rows = rows_of(path)
    names = [split_unit(heading)[0] for heading in headings]
    if double := sorted({name for name in names if name and names.count(name) > 1}):
        raise ValueError(
            f"{path} has {', '.join(map(repr, double))} more than once in its headings; rename all but one"
        )
    first: dict[int, float] = {}
    began: dict[int, int] = {}
    texts: dict[int, str] = {}
    still, counting = set(range(len(headings))), set(range(len(headings)))
    passed = dict.fromkeys(counting, 0)
    for place, (_, row) in enumerate(rows):
        for k in [k for k in still | counting if k < len(row)]:
            value = parse_number(row[k])
            if not math.isnan(value):
                passed[k] = place - began.setdefault(k, place)
                if value != first.setdefault(k, value):
                    still.discard(k)
                if value != first[k] + passed[k]:
                    counting.discard(k)
            elif row[k].strip().lower() not in ("", "nan"):
                texts.setdefault(k, row[k].strip()[:40])
        if not still | counting:
            break
    if nameless := [k + 1 for k in sorted(first) if k and not headings[k]]:  # the first may be an index
        raise ValueError(f"{path} has numbers in column {nameless[0]} and no heading above them; give it one")
    worded = {headings[k]: text for k, text in sorted(texts.items()) if k not in first and headings[k]}
    return ColumnSummary(
        tuple(headings),
        tuple(headings[k] for k in sorted(first) if headings[k]),
        {headings[k]: first[k] for k in sorted(still & first.keys()) if headings[k]},
        worded,
        tuple(heading for heading, text in worded.items() if not math.isnan(seconds_of_date(text))),
        tuple(headings[k] for k in sorted(counting & first.keys()) if headings[k] and passed[k] + 1 >= COUNTED),
    )


Array = NDArray[np.float64]
REGULAR = 0.9
"""Share of the rows of a counter that follow the one before without a gap."""


def row_counter(path: Path, time: str, named: Collection[str]) -> str:
    """Return the heading of the time of a log whose sampling time is given: its counter of rows, where it has no time.

    That is the only column that grows all along, in whole numbers and, but where rows are missing, by the same step. An
    encoder of a motor that turns one way grows, too, by other steps. Where there is no such column, or where a heading
    reads like a time, what was given is returned.

    Args:
        path: The file.
        time: Heading of the time as it was given, or `time`.
        named: Names of the columns that were named as states or inputs.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no table of text.
    """
    look = summarise_columns(path)
    if time != CLOCK or look.dated or clock_of(look.headings, time).heading in look.headings:
        return time
    columns = _finite(path, look)
    growing = [heading for heading, column in columns.items() if _grows(column)]
    if len(growing) != 1 or split_unit(growing[0])[0] in named or not is_counter(columns[growing[0]]):
        return time
    steps = np.diff(columns[growing[0]])
    step = np.median(steps)
    regular = (steps == step).mean() > REGULAR and bool((steps % step == 0).all())
    return growing[0] if regular else time


def guessed(path: Path, look: ColumnSummary, time: str | None, inputs: Sequence[str], dt: float | None = None) -> str:
    """Return a first guess at what is time, what an input and what a state: sentences, then words of the command line.

    Time is a column of dates, or the first column that grows all along, one that counts rows only where there is no
    other. The input is the column that is held longest, as only levels of an actuator are, or else the last one. Both
    are guesses, and what was found by its heading is none. A column that never changes or counts the rows is neither
    input nor state.

    Args:
        path: The file.
        look: Its columns.
        time: Heading of the time, None where it is not known.
        inputs: Names of inputs that were found.
        dt: Sampling time that was given [s].

    Raises:
        ValueError: The file is no table of text.
    """
    columns = _finite(path, look)
    growing = [heading for heading, column in columns.items() if _grows(column)]
    named = time is not None
    if time is None:
        time = next(iter([*look.dated, *sorted(growing, key=lambda heading: is_counter(columns[heading]))]), None)
    names = [split_unit(heading)[0] for heading in columns if heading not in (time, *look.counting)]
    hints: list[str] = []
    seconds = ""
    if not time:
        hints.append("No column grows from row to row, as time does: write the time of each row into the file")
    if dt is None and time in growing and not parts_of(time)[1] and is_counter(columns[time]):
        hints.append(f"{time} holds whole numbers, as a counter does: if it counts rows, give data.dt, too, in seconds")
        seconds = "" if named else " data.dt=SECONDS"  # what is called time may be one in whole seconds
    if not inputs and names:
        still = {split_unit(heading)[0]: float((np.diff(column) == 0).mean()) for heading, column in columns.items()}
        held = max(names, key=lambda name: still[name])
        inputs = [held] if still[held] > 0.5 else names[-1:]
        if still[held] <= 0.5:
            hints.append(
                "No column is held for some samples, as commands are: if the log has no command, log it, too, for "
                "without one nothing can be identified"
            )
    states = [name for name in names if name not in inputs]
    clock = split_unit(time)[0] if time else "HEADING"
    words = [] if named and clock == CLOCK else [f"data.time={_quoted(clock)}"]
    words += [f"data.{key}=[{','.join(map(_quoted, each))}]" for key, each in (("inputs", inputs), ("states", states))]
    told = "".join(f" {hint}." for hint in hints)
    return f"{told} This is a first guess, to be corrected: {' '.join(map(shlex.quote, words))}{seconds}"


def _finite(path: Path, look: ColumnSummary) -> dict[str, Array]:
    """Return the columns that move, by heading, without the rows that lack a value."""
    headings = [heading for heading in look.numeric if heading not in look.still]
    values = read_columns(path, headings).values if headings else np.empty((0, 0))
    return dict(zip(headings, values[np.isfinite(values).all(1)].T, strict=True))


def _grows(column: Array) -> bool:
    return len(column) > 1 and bool((np.diff(column) > 0).all())


def _quoted(name: str) -> str:
    """Return a name as the command line takes it: in quotation marks, unless it is one plain word."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name) else f'"{name}"'
