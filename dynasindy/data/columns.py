"""Columns of a log: which are states, which are inputs, and what is said of each."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from dynasindy.data.table import CLOCK, MAP, all_headings, clock_of, numeric_headings, split_unit
from dynasindy.data.units import with_units
from dynasindy.data.unnamed import settings_for


@dataclass(frozen=True)
class Column:
    """Say where a state or an input stands in the file.

    Attributes:
        name: heading of the column; empty for a state that has none. Without `derivative_of` no sensor sees it: its
            samples are NaN, and a fit estimates them with the model.
        unit: unit of the state or input after scaling.
        scale: factor from the file's unit to this one, e.g. 0.0174533 from degrees to rad.
        derivative_of: state that this one is reconstructed from, as its derivative.
        low: lower end of an input's actuator after scaling; with `high`.
        high: its upper end.
        rest: what becomes 0 of an input, with both ends; zero if omitted, or the end next to zero.
    """

    name: str = ""
    unit: str = "-"
    scale: float = 1.0
    derivative_of: str = ""
    low: float | None = None
    high: float | None = None
    rest: float | None = None


def infer(
    path: str, time: str = CLOCK, inputs: Collection[str] | None = None
) -> tuple[dict[str, Column], dict[str, Column]]:
    """Read the columns of states and inputs off the headings of a file, `name` or `name [unit]`.

    Inputs, unless they are named, are called u, u1, u_..., or input...; references, predictions and columns without any
    number are left out; all other columns but time are states.

    Args:
        path: the file.
        time: heading of the time column.
        inputs: names or headings of the inputs, without their units or with them.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no heading is that of a state, none that of an input, or one that is named does not exist.
    """
    given = {heading: split_unit(heading) for heading in numeric_headings(Path(path))}
    headings = all_headings(Path(path))
    clock = clock_of(headings, time)
    columns = {name: Column(heading) for heading, (name, _) in given.items()}
    others = {
        n: c for n, c in columns.items() if n != split_unit(clock)[0] and not n.startswith(("reference_", "predicted_"))
    }
    if inputs is None:
        found = {n: c for n, c in others.items() if re.fullmatch(r"(u|U|input)([_\d].*)?", n)}
    else:
        found = chosen(others, inputs, path, "data.inputs")
    timed = any(clock in (heading, split_unit(heading)[0]) for heading in headings)
    states = with_units({n: c for n, c in others.items() if n not in found}, given, states=True)
    found = with_units(found, given, states=False)
    if not states or not found or not timed:
        lacking = _LACKING["time" if not timed else "inputs" if not found else "states"]
        filled = settings_for(Path(path), list(given), clock if timed else None, list(found)) if given else ""
        guess = f" This is a first guess, to be corrected: {filled}" if filled else ""
        raise ValueError(
            f"{path} has the columns {', '.join(headings)}, with numbers in {', '.join(given) or 'none'}; {lacking}. "
            "Allowed are a column of time, one state or more, and one input or more: say which is which, by data.time, "
            f"data.inputs and data.states.{guess}"
        )
    return states, found


_LACKING = {
    "time": "none of them is called time",
    "inputs": "none of them is called u, u_... or input_..., as inputs are",
    "states": "besides time and inputs none is left, which would be a state",
}


def chosen(columns: Mapping[str, Column], names: Collection[str], path: str, key: str) -> dict[str, Column]:
    """Return the columns of some names or headings.

    Args:
        columns: all columns, by name.
        names: which of them, with or without their units.
        path: the file.
        key: the setting that names them.

    Raises:
        ValueError: there is no such column.
    """
    wanted = [split_unit(name)[0] for name in names]
    if absent := [name for name in wanted if name not in columns]:
        raise ValueError(f"{key} names '{absent[0]}'; {path} has {', '.join(columns)}: name columns of the file")
    return {name: columns[name] for name in wanted}


def columns_of(
    group: Mapping[str, Column | Mapping[str, object] | str], may_be_rates: bool = True
) -> dict[str, Column]:
    """Return columns of what was given of states or inputs.

    Args:
        group: A heading, the keys of a column or a column, by name.
        may_be_rates: Whether they may do without a heading, as rates of others and states that no sensor sees.

    Raises:
        ValueError: One is no column, or has no heading and needs one.
    """
    made = {name: _column(given) for name, given in group.items()}
    logged = [name for name, column in made.items() if column.name] if may_be_rates else []
    for name, column in made.items():
        unseen = may_be_rates and logged and not column.derivative_of  # no sensor sees it
        if not column.name and column.derivative_of not in logged and not unseen:
            states = f", or to be the derivative of a logged state ({', '.join(logged)})" if may_be_rates else ""
            raise ValueError(
                f"{name} has no column and is the derivative of {column.derivative_of or 'nothing'!r}; allowed is a "
                f"column name{states}: {MAP}"
            )
    return made


def _column(given: object) -> Column:
    if isinstance(given, str):
        return Column(given)
    column = given if isinstance(given, Column) else None
    if isinstance(given, Mapping) and given.keys() <= {f.name for f in fields(Column)}:
        column = Column(**given)
    if column is None or not _is_sound(column):
        raise ValueError(
            f"a column is {given!r}; allowed is a heading, or the keys name, unit, scale (a number, not 0), "
            f"derivative_of, and of inputs low and high (both, low < high), with these rest, a number: {MAP}"
        )
    return column


def _is_sound(column: Column) -> bool:
    words: list[object] = [column.name, column.unit, column.derivative_of]
    scale: object = column.scale
    if not all(isinstance(word, str) for word in words) or isinstance(scale, bool):
        return False
    given: list[object] = [value for value in (column.low, column.high, column.rest) if value is not None]
    numbers = [v for v in given if isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)]
    if given and (column.low is None or column.high is None or len(numbers) < len(given) or numbers[0] >= numbers[1]):
        return False
    return isinstance(scale, int | float) and 0 < abs(scale) < math.inf


def require_names(names: list[str], path: str) -> None:
    """Refuse names that could not be told from functions and numbers in an equation.

    Args:
        names: Names of states or inputs.
        path: File that they are of.

    Raises:
        ValueError: A name is not allowed, or there twice.
    """
    for name in names:
        if not re.fullmatch(r"[^\W\d][\w .-]*", name) or names.count(name) > 1:
            raise ValueError(
                f"{path}: a state or input is called {name!r}; allowed are names that begin with a letter, hold no "
                "signs of arithmetic and differ: name it in data.states or data.inputs, as {angle: HEADING}"
            )
