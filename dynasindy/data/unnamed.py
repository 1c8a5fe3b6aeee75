"""A log whose headings do not tell time or inputs: the settings that do, filled in by what its numbers look like."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.table import CLOCK, read_table, split_unit

Array = NDArray[np.float64]


def settings_for(path: Path, headings: Sequence[str], time: str | None, inputs: Sequence[str]) -> str:
    """Return the words of the command line that say what is time, what an input and what a state.

    Time is the first column that grows all along. The input is the column that is held longest, as only levels of an
    actuator are, or else the last one. Both are guesses, and what was found by its heading is none.

    Args:
        path: The file.
        headings: Those of columns with numbers.
        time: Heading of the time, None where it is not known.
        inputs: Names of inputs that were found.

    Raises:
        ValueError: The file is no table of text.
    """
    values = read_table(path, headings).values
    columns = dict(zip(headings, values[np.isfinite(values).all(1)].T, strict=True))
    if time is None:
        time = next((heading for heading, column in columns.items() if _grows(column)), None)
    names = [split_unit(heading)[0] for heading in columns if heading != time and split_unit(heading)[0] != time]
    if not inputs:
        still = {split_unit(heading)[0]: float((np.diff(column) == 0).mean()) for heading, column in columns.items()}
        held = max(names, key=lambda name: still[name], default="")
        inputs = [held] if names and still[held] > 0.5 else names[-1:]
    states = [name for name in names if name not in inputs]
    clock = split_unit(time)[0] if time else "HEADING"
    words = [] if clock == CLOCK else [f"data.time={_quoted(clock)}"]
    words += [f"data.{key}=[{','.join(map(_quoted, each))}]" for key, each in (("inputs", inputs), ("states", states))]
    return " ".join(map(shlex.quote, words))


def _grows(column: Array) -> bool:
    return len(column) > 1 and bool((np.diff(column) > 0).all())


def _quoted(name: str) -> str:
    """Return a name as the command line takes it: in quotation marks, unless it is one plain word."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name) else f'"{name}"'
