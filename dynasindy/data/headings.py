"""What the headings of a log leave open: columns summarised, and the settings for time and inputs filled in."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.clock import CLOCK, clock_of, is_counter, parts_of
from dynasindy.data.table import ColumnSummary, grows, read_columns, split_unit, summarise_columns

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
    columns = finite_columns(path, look)
    growing = [heading for heading, column in columns.items() if grows(column)]
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
    columns = finite_columns(path, look)
    growing = [heading for heading, column in columns.items() if grows(column)]
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
        stem = re.sub(r"[\W_]*\d+$", "", held)  # of Heater 1 and Heater 2
        inputs = [name for name in names if name == held or re.fullmatch(re.escape(stem) + r"[\W_]*\d+", name)]
        inputs = inputs if len(inputs) < len(names) else [held]  # columns of one matrix are no pair
        inputs = inputs if still[held] > 0.5 else names[-1:]
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


def finite_columns(path: Path, look: ColumnSummary) -> dict[str, Array]:
    """Return the columns that move, by heading, without the rows that lack a value."""
    headings = [heading for heading in look.numeric if heading not in look.still]
    values = (
        np.stack([read_columns(path).column(heading) for heading in headings], -1) if headings else np.empty((0, 0))
    )
    return dict(zip(headings, values[np.isfinite(values).all(1)].T, strict=True))


def _quoted(name: str) -> str:
    """Return a name as the command line takes it: in quotation marks, unless it is one plain word."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name) else f'"{name}"'
