"""Columns of a log: which are states, which are inputs, and what is said of each."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.clock import CLOCK, clock_of, is_counter
from dynasindy.data.headings import (
    PLAIN_RATES,
    SECONDS,
    find_names,
    in_radians,
    is_clock,
    is_rate_of,
    named_by,
    parts_of,
    split_unit,
    units_of,
)
from dynasindy.data.table import REGULAR, ColumnSummary, read_columns, summarise_columns
from dynasindy.findings import Finding, LogError, note, weak

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """Say where a state or an input stands in the file.

    Attributes:
        name: heading of the column; empty for a state that no sensor sees: its samples are NaN, and a fit estimates
            them with the model.
        unit: unit of the state or input after scaling.
        scale: factor from the file's unit to this one, e.g. 0.0174533 from degrees to rad.
        low: lower end of an input's actuator after scaling; with `high`.
        high: its upper end.
        rest: what becomes 0 of an input, with both ends; zero if omitted, or the end next to zero.
    """

    name: str = ""
    unit: str = "-"
    scale: float = 1.0
    low: float | None = None
    high: float | None = None
    rest: float | None = None


def with_units(
    columns: Mapping[str, Column], headings: Iterable[str], states: bool, known: Mapping[str, str] | None = None
) -> dict[str, Column]:
    """Return columns with the units of their headings; degrees of states become rad.

    A column keeps what was given of it: a scale, and a unit that is none of the two. Turns per minute are those of an
    angle if the state is known or called to be its rate, as `speed` is beside a single one.

    Args:
        columns: Columns by name.
        headings: Headings of the file.
        states: Whether they are states; inputs stay in the units of their actuators.
        known: The rate of each state, as far as it is known.
    """
    units, found = units_of(headings), dict(columns)
    inside = {name: units.get(column.name, "") for name, column in columns.items()}
    angles = [name for name in columns if "rad" in (columns[name].unit, in_radians(inside[name])[0])]
    for name, column in columns.items():
        turns = column.unit == "rad/s" or (name in PLAIN_RATES and len(angles) == 1)
        turns |= any(is_rate_of(angle, name) or (known or {}).get(angle) == name for angle in angles)
        unit, factor = in_radians(inside[name], turns) if states else (inside[name], 1.0)
        if unit and column.scale == 1 and column.unit in ("-", unit):
            found[name] = replace(column, unit=unit, scale=factor)
    return found


def as_map(columns: Mapping[str, Column], headings: Iterable[str] = ()) -> dict[str, Any]:
    """Return the column map that says these columns: units and scales where the headings do not tell them, and ends.

    Args:
        columns: States, or inputs with their ends, by name.
        headings: Headings of the file, where the columns do not hold them.
    """
    units, found = units_of([*headings, *(column.name for column in columns.values())]), dict[str, Any]()
    for name, column in columns.items():
        heading, inside = split_unit(column.name)[0], units.get(column.name) or "-"
        keys: dict[str, Any] = {"name": heading} if column.name else {}
        read = in_radians(inside) if column.low is None else (inside, 1.0)
        if not column.name or (column.unit, column.scale) != read:
            keys |= {"unit": column.unit} if column.unit != "-" else {}
            keys |= {"scale": float(f"{column.scale:.7g}")} if column.scale != 1 else {}
        ends = {"low": column.low, "high": column.high, "rest": column.rest}
        keys |= {key: float(f"{value:.6g}") for key, value in ends.items() if value is not None}
        found[name] = heading if keys == {"name": heading} else keys
    return found


def _standing(column: Array) -> float:
    """Return the share of the rows in which a column has the same number as before."""
    return 1 - int(np.count_nonzero(np.diff(column))) / max(len(column) - 1, 1)


def _is_followed(column: Array, others: Iterable[Array]) -> bool:
    """Tell whether a column moves in steps that another one follows, as a reference does that a plant is taken to.

    After a step the other one is where the reference was before, and at the end of it where it was led; a slow sensor
    of the same is there from the beginning.
    """
    steps = np.flatnonzero(np.diff(column)) + 1
    if _standing(column) <= HELD or len(steps) < LEADS:
        return False
    steps, ends = steps[:-1], steps[1:] - 1
    size = np.abs(column[steps] - column[steps - 1])
    before, after = ([np.abs(x[rows] - column[steps]) / size for x in others] for rows in (steps, ends))
    pairs = zip(before, after, strict=True)
    return any(np.median(first) > AWAY and np.median(last) < 1 - AWAY for first, last in pairs)


def _stem(name: str) -> str:
    """Return what `Heater 1` and `Heater 2` have in common."""
    return re.sub(r"[\W_]*\d+$", "", name)


def _stepping(columns: Mapping[str, Array]) -> list[str]:
    """Return the columns that are inputs by how they move: in steps, where all others move in most rows.

    There is none where one may be a label, several are no array of the same, or what would be a state stands, too.
    """
    standing = {name: _standing(column) for name, column in columns.items()}
    steady = {name for name, share in standing.items() if share > 1 - RARE and not (columns[name] % 1).any()}  # labels
    found = [name for name, share in standing.items() if share > HELD and name not in steady]
    most = 0.5 * min((standing[name] for name in found), default=0.0)
    smooth = all(standing[name] < most for name in columns if name not in found)
    if not smooth or len(set(map(_stem, found))) != 1:
        return []
    pair = [name for name in columns if _stem(name) == _stem(found[0])]
    alone = found if len(found) < len(columns) else []
    return pair if len(pair) < len(columns) else alone  # columns of one matrix are no pair


def infer(
    path: str,
    time: str = CLOCK,
    inputs: Collection[str] | None = None,
    states: Collection[str] | None = None,
    findings: list[Finding] | None = None,
    dt: float | None = None,
) -> tuple[dict[str, Column], dict[str, Column]]:
    """Read the columns of states and inputs off the headings of a file, `name` or `name [unit]`.

    Inputs, unless they are named, are called u, u1, u_..., or input..., and where none is, cmd or command; where none
    is either, they are the columns that move in steps while all others move in most rows. References, predictions,
    columns without any number, those that never change and those that count the rows are left out; all other columns
    but time are states, unless they are named.

    Args:
        path: the file.
        time: heading of the time column.
        inputs: names or headings of the inputs, without their units or with them.
        states: those of the states.
        findings: what was decided; what is left out is added.
        dt: sampling time that was given [s]; the error then does not ask for it.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no heading is that of a state, none that of an input, one that is named does not exist, or an input
            holds words.
    """
    look = summarise_columns(Path(path))
    clock, _ = clock_of(look.headings, time)
    timed = clock in look.headings
    names = {h: name for h in look.headings if h and clock not in (h, name := split_unit(h)[0])}
    words = {names[h]: text for h, text in look.worded.items() if h in names}
    dates = [names[h] for h in look.dated if h in names]
    empty = [name for h, name in names.items() if h not in {*look.numeric, *look.worded}]
    named = {found for name in (*(inputs or ()), *(states or ())) for found in find_names(name, names.values())}
    driving = [found for name in inputs or () for found in find_names(name, words)]
    if worded := [name for name in words if name in driving or (inputs is None and INPUT.fullmatch(name))]:
        raise LogError("log.worded_input", file=path, column=worded[0], text=words[worded[0]])
    if dt is not None and not timed:  # even rows, unless a column may be a time by another name
        timed = not any(names[heading] not in named for heading in look.growing)
    if blank := [name for name in empty if name in named]:
        raise LogError("log.column_without_numbers", file=path, column=blank[0])
    others = {
        name: Column(h)
        for h, name in names.items()
        if h in look.numeric and not name.startswith(("reference_", "predicted_"))
    }
    counting = {*look.counting, *look.clocks(clock)}
    targets = [
        name
        for name in others
        if name not in named and REFERENCE.fullmatch(name) and not (INPUT.fullmatch(name) or COMMAND.fullmatch(name))
    ]
    free = {name: column.name for name, column in others.items() if name not in named}
    still = {name: look.still[h] for name, h in free.items() if h in look.still}
    counts = [name for name, h in free.items() if h in counting]
    if inputs is None:
        moving = {n: c for n, c in others.items() if n not in {*still, *counts}}
        found = {n: c for n, c in moving.items() if INPUT.fullmatch(n)}
        found = found or {n: c for n, c in moving.items() if COMMAND.fullmatch(n)}
        found = {n: c for n, c in found.items() if n[0].islower()} or found  # U_left beside u may be anything
    else:
        found = _chosen(others, inputs, path, "data.inputs")
    left = {n: c for n, c in others.items() if n not in found and n not in {*still, *counts}}
    free = {n: c.name for n, c in left.items() if n not in {*named, *targets}}
    labels = [n for n, h in free.items() if _is_label(look.moving[h])]
    moves = {n: look.moving[c.name] for n, c in left.items() if n not in {*targets, *labels}}
    led = [n for n in moves if n not in named and _is_followed(moves[n], [moves[m] for m in moves if m != n])]
    guessed = not found and inputs is None and timed
    if guessed:
        steps = _stepping(moves) or _stepping({n: x for n, x in moves.items() if n not in led})
        found = {n: left[n] for n in steps if n not in named}
        led = [n for n in led if n not in found]
    left = {n: c for n, c in left.items() if n not in {*found, *targets, *led}}
    free = {n: c.name for n, c in left.items() if n not in {*named, *labels}}
    labels += [n for n, h in free.items() if _is_label(look.moving[h], rarely=False)]
    columns = {n: look.moving[c.name] for n, c in left.items() if n not in labels}
    basis = [look.moving[others[n].name] for n in (*targets, *led) if others[n].name in look.moving]
    derived = [n for n in _derived(columns, basis) if n not in named]
    if states is None:
        left = {n: c for n, c in left.items() if n not in {*labels, *derived}}
    else:
        targets, led, labels, derived = [], [], [], []
        left = _chosen(left, states, path, "data.states")
        still = {name: value for name, value in still.items() if INPUT.fullmatch(name)}
        counts = [name for name in counts if INPUT.fullmatch(name)]
    left_out: dict[str, Any] = {
        "constant": still,
        "counter": counts,
        "words": [name for name in words if name not in dates],
        "empty": empty,
        "dates": dates if timed else dates[1:],  # the first is the time where nothing else is
        "reference": targets,
        "label": labels,
        "derived": derived,
    }
    out = [note("log.left_out", why=why, columns=columns) for why, columns in left_out.items() if columns]
    if not left or not found or not timed:
        live = {*look.numeric} - {*look.still, *look.counting, clock}
        lacks = "time" if not timed else "command" if len(live) < 2 else "states" if found else "inputs"
        facts: dict[str, Any] = {"columns": [*look.headings], "numbers": [*look.numeric], "clock": clock}
        if look.numeric and lacks != "command":
            facts["guess"] = _guess_columns(look, clock if timed else None, [*found], dt)
        raise LogError("log.no_roles", path=path, lacks=lacks, left_out=out, **facts)
    if led:
        out.append(weak("log.followed", columns=led, states=[*left, *led]))
    if guessed:
        out.append(weak("log.guessed_inputs", inputs=[*found], states=[*left]))
    if findings is not None:
        findings += out
    return left, found


def _is_label(column: Array, rarely: bool = True) -> bool:
    """Tell whether a column holds a few whole numbers, which change in hardly any row, or whenever they are two."""
    levels = len(np.unique(column)) if len(column) and not (column % 1).any() else 0
    return 1 < levels <= LABELS and _standing(column) > 1 - RARE if rarely else levels == 2


def _derived(columns: Mapping[str, Array], basis: Sequence[Array]) -> list[str]:
    """Return the columns that are sums of multiples of those before them and of a basis, but for their last digits."""
    every = slice(None, None, 1 + max(map(len, columns.values()), default=0) // LOOKED_AT)
    known, found = [column[every] for column in basis], list[str]()
    for name, column in columns.items():
        values = column[every]
        table = np.stack([np.ones_like(values), *known], -1)
        known.append(values)
        if len(values) > SURELY * len(known):
            factors = np.linalg.lstsq(table, values, rcond=None)[0]
            digits = _last_digit(values) + np.abs(factors) @ [0.0, *map(_last_digit, known[:-1])]
            if np.abs(values - table @ factors).max() <= min(digits, EXACT * np.ptp(values)):
                found.append(name)
                known.pop()
    return found


def _last_digit(column: Array) -> float:
    """Return the least distance between two numbers of a column, which its last digit makes, but for rounding."""
    steps = np.diff(np.unique(column))
    return float(steps[steps > 1e-12 * np.abs(column).max()].min()) if len(steps) else 0.0


LABELS = 10
"""Labels that there are at most; a state of fewer steps tells little."""
LOOKED_AT = 2000
"""Rows, about, by which it is judged whether columns are sums of others."""
SURELY = 20
"""Rows for each column from which on no sum of others is a column by chance."""
EXACT = 1e-3
"""Part of its range to which such a sum is one."""
RARE = 0.01
"""Share of the rows in which a label changes at most."""
INPUT = re.compile(r"(u|U|input)([_\d].*)?")
"""How inputs are called."""
COMMAND = re.compile(r"(.*_)?(cmd|command|input)([_ \d].*)?")
"""How they may be called where none is called so: beside an input, a command may be a target."""
REFERENCE = re.compile(
    r"(.*[_ .])?(ref|r[e\u00e9]f[e\u00e9]ren\w*|set[_ ]?point|sp|target|soll\w*|consign\w*)([_ .\d].*)?", re.I
)
"""What references are called, in several languages."""
HELD = 0.5
"""Share of the rows with the same number as before beyond which a column moves in steps."""
LEADS, AWAY = 4, 0.7
"""Steps of a reference that are followed at least; part of a step that is left after it, and gone at its end."""


def _chosen(columns: Mapping[str, Column], names: Collection[str], path: str, key: str) -> dict[str, Column]:
    """Return the columns of some names or headings, of which a setting names one that there may not be."""
    named = {name: find_names(name, columns) for name in names}
    if absent := [split_unit(name)[0] for name, found in named.items() if not found]:
        raise LogError("log.absent_column", key=key, column=absent[0], path=path, columns=[*columns])
    return {found[0]: columns[found[0]] for found in named.values()}


def find_clock(path: Path, time: str, named: Collection[str], dt: float | None) -> str:
    """Return the heading of the time of a log in which nothing is called one.

    It is the only column with a unit of time that rises throughout, and by much the same in most rows; dates are as
    good as a unit. Where the sampling time is given it is else the counter of rows: the only column that grows all
    along, in whole numbers and, but where rows are missing, by the same step. An encoder of a motor that turns one way
    grows, too, by other steps. Where there is no such column, or a choice, what was given is returned.

    Args:
        path: The file.
        time: Heading of the time as it was given, or `time`.
        named: Names of the columns that were named as states or inputs.
        dt: Sampling time that was given [s]; dates are looked at where there is none.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no table of text.
    """
    headings = read_columns(path).headings
    if time != CLOCK or any(map(is_clock, headings)) or named_by(time, headings):
        return time
    look = summarise_columns(path)
    columns = {h: look.moving[h] for h in look.growing if parts_of(h)[1].lower() in SECONDS}
    columns |= {h: look.table.column(h) for h in look.dated if dt is None}
    found = [h for h, column in columns.items() if split_unit(h)[0] not in named and _is_regular(column)]
    if dt is not None and not found and not look.dated and len(look.growing) == 1:
        found = [h for h in look.growing if split_unit(h)[0] not in named and _is_row_counter(look.moving[h])]
    return found[0] if len(found) == 1 else time


def _is_row_counter(column: Array) -> bool:
    """Tell whether a column grows by the same whole number in most rows, and by several of it in others."""
    steps = np.diff(column)
    step = np.median(steps)
    return is_counter(column) and (steps == step).mean() > REGULAR and bool((steps % step == 0).all())


def _is_regular(column: Array) -> bool:
    """Tell whether a column rises from row to row, by about the same in most of them."""
    steps = np.diff(column[np.isfinite(column)])
    return bool(len(steps) and (steps > 0).all() and (np.abs(steps / np.median(steps) - 1) < 0.5).mean() > HELD)


def _guess_columns(look: ColumnSummary, time: str | None, inputs: Sequence[str], dt: float | None) -> dict[str, Any]:
    """Return a first guess at what is time, what an input and what a state, as facts for a reader; given is none.

    Time is a column of dates, or the first column that grows all along, one that counts rows only where there is no
    other. The input is the column that is held longest, as only levels of an actuator are, or else the last one.
    """
    columns, named = look.moving, time is not None
    if time is None:
        time = next(iter([*look.dated, *sorted(look.growing, key=lambda heading: is_counter(columns[heading]))]), None)
    aside = {time, *look.clocks(time), *look.counting}
    still = {split_unit(h)[0]: _standing(column) for h, column in columns.items() if h not in aside}
    names, held = [*still], True
    counts = dt is None and time in look.growing and not parts_of(time)[1] and is_counter(columns[time])
    if not inputs and names:
        longest = max(names, key=lambda name: still[name])
        pair = [name for name in names if _stem(name) == _stem(longest)]
        held = still[longest] > HELD
        inputs = (pair if len(pair) < len(names) else [longest]) if held else names[-1:]  # one matrix is no pair
    return {
        "time": split_unit(time)[0] if time else None,
        "inputs": [*inputs],
        "states": [name for name in names if name not in inputs],
        "clock_known": named,  # what is called time may be one in whole seconds
        "counter": time if counts else "",
        "held": held,
    }
