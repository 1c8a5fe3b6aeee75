"""Columns of a log: which are states, which are inputs, and what is said of each."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain, combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from dynasindy.data.clock import CLOCK, OVERFLOWS, clock_of, date_unit, is_counter
from dynasindy.data.headings import (
    COMMAND,
    INPUT,
    SECONDS,
    find_names,
    in_radians,
    is_clock,
    named_by,
    parts_of,
    split_unit,
)
from dynasindy.data.table import COUNTED, Table, counts, grows
from dynasindy.findings import Finding, LogError, note, weak
from dynasindy.safe_io import checked_class
from dynasindy.sentences import LEFT_OUT

Array = NDArray[np.float64]


@checked_class
@dataclass(frozen=True, config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
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

    Raises:
        ValueError: the scale is zero, or there is one end alone, a rest without ends, or ends the wrong way round.
    """

    name: str = ""
    unit: str = "-"
    scale: float = 1.0
    low: float | None = None
    high: float | None = None
    rest: float | None = None

    def __post_init__(self) -> None:
        ends = self.low is not None and self.high is not None and self.low < self.high
        if not self.scale or not (ends or self.low is self.high is self.rest is None):
            raise ValueError("allowed are a scale that is not 0, and low < high, with them a rest, or none of these")


def as_map(columns: Mapping[str, Column]) -> dict[str, Any]:
    """Return the column map that says these columns: units and scales where the headings do not tell them, and ends.

    Args:
        columns: States, or inputs with their ends, by name.
    """
    found = dict[str, Any]()
    for name, column in columns.items():
        heading, inside = split_unit(column.name)
        keys: dict[str, Any] = {"name": heading} if column.name else {}
        read = in_radians(inside or "-") if column.low is None else (inside or "-", 1.0)
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
    """Tell whether a column moves in steps that another one follows, as a reference does that a plant is taken to."""
    # Unlike a plant, a slow sensor of the same is there from the beginning of a step.
    steps = np.flatnonzero(np.diff(column)) + 1
    if _standing(column) <= HELD or len(steps) < 4:
        return False
    rows, level = np.stack([steps[:-1], steps[1:] - 1]), column[steps[:-1]]
    size = np.abs(level - column[steps[:-1] - 1])
    left = (np.median(np.abs(x[rows] - level) / size, axis=1) for x in others)
    return any(first > 0.7 and last < 0.3 for first, last in left)


def _alike(name: str, units: Mapping[str, str]) -> list[str]:
    """Return the names of one unit that differ in the number at their end alone, as `Heater 2` from `Heater 1`."""
    number = re.compile(r"[\W_]*\d+$")
    return [n for n in units if (number.sub("", n), units[n]) == (number.sub("", name), units[name])]


def _is_actuator(name: str, unit: str) -> bool:
    return bool(ACTUATOR.fullmatch(name)) and not _is_measured(name, unit)


def _is_measured(name: str, unit: str) -> bool:
    return bool(MEASURED.search(name) or MEASURED_UNIT.fullmatch(unit))


def _predicted_by(driver: Array, column: Array) -> float:
    """Return the part of the variance of a column, some rows ahead, that another one predicts beside its own past.

    That is Granger causality (1969).
    """
    driver, column = (each / (each.std() or 1.0) for each in (driver, column))
    share = 0.0
    for ahead in (1, 4, 16) if len(column) > 200 else ():
        rows = np.arange(2, len(column) - ahead, 1 + len(column) // 5000)
        table = np.stack([np.ones(len(rows)), *(x[rows - k] for x in (column, driver) for k in range(3))], 1)
        y, parts = column[rows + ahead], (table[:, :4], table)
        own, both = (float(np.square(y - part @ np.linalg.lstsq(part, y, rcond=None)[0]).sum()) for part in parts)
        # What lies that far apart counts once.
        share = max(share, 1 - both / own - CHANCE * ahead / len(rows) if own else 0.0)
    return share


def _influence(name: str, columns: Mapping[str, Array]) -> tuple[float, float]:
    """Return the largest part of another column's variance that a column predicts, and of its own that another does."""
    own, others = columns[name], [column for other, column in columns.items() if other != name]
    pairs = [(_predicted_by(own, other), _predicted_by(other, own)) for other in others]
    acts, moved = zip(*pairs, strict=True) if pairs else ((0.0,), (0.0,))
    return max(acts), max(moved)


def _actuators(columns: Mapping[str, Array], units: Mapping[str, str]) -> list[str]:
    """Return columns that are called as actuators are and follow none that is called so, if one of them moves others.

    A measured current follows the voltage, and so it is a state.
    """
    named = [name for name in columns if _is_actuator(name, units[name])]
    shares = {(a, b): _predicted_by(columns[a], columns[b]) for a in named for b in columns if a != b}
    driven = {b for (a, b), share in shares.items() if b in named and share > DRIVEN and shares[b, a] < share / 3}
    found = [name for name in named if not {*_alike(name, units)} <= driven]
    acts = any(share > 0 for (a, b), share in shares.items() if a in found and b not in found)
    return found if acts else []


def _in_steps(columns: Mapping[str, Array], units: Mapping[str, str]) -> list[str]:
    """Return columns that move in steps where all others move in most rows, as inputs; none if one may be a label."""
    standing = {name: _standing(column) for name, column in columns.items()}
    labels = {name for name, share in standing.items() if share > 1 - RARE and not (columns[name] % 1).any()}
    found = [name for name, share in standing.items() if share > HELD and name not in labels]
    found = [name for name in found if not _is_measured(name, units[name])] or found
    standing = {name: share for name, share in standing.items() if name in found or not _is_measured(name, units[name])}
    most = 0.5 * min((standing[name] for name in found), default=0.0)
    if not found or any(share >= most for name, share in standing.items() if name not in found):
        return []
    kind = {*_alike(found[0], units), *_find_similar(found[0], columns, units)}
    pair = [name for name in columns if name in kind]
    if not {*found} <= kind:  # what moves nothing, as the voltage of a battery, is no input
        idle = [name for name in found if _influence(name, columns)[0] <= 0]
        rest = {name: column for name, column in columns.items() if name not in idle}
        return _in_steps(rest, units) if 0 < len(idle) < len(found) else []
    found = pair if len(pair) < len(columns) else found  # columns of one matrix are no pair
    return found if len(found) < len(columns) else []


def _find_similar(name: str, columns: Mapping[str, Array], units: Mapping[str, str]) -> list[str]:
    """Return columns of one unit in steps, or of one name but for a word, that act more than they are moved.

    `V_yaw [V]` beside `V_pitch [V]` is one. An input that a controller makes of states moves in every row, and these
    predict little of it.
    """
    words = {each: re.findall(r"[^\W\d_]+|\d+", each) for each in columns}
    found = list[str]()
    for each, own in words.items():
        differ = sum(a != b for a, b in zip(own, words[name])) if len(own) == len(words[name]) > 1 else 2
        in_steps, moves = bool(units[each]) and _standing(columns[each]) > HELD, np.abs(np.diff(columns[each]))
        if (differ > 1 and not in_steps) or units[each] != units[name] or _is_measured(each, units[each]):
            continue
        # No state jumps, however noisy it is.
        acts, moved = _influence(each, columns)
        if acts > 2 * moved and moves.max() > JUMP * np.quantile(moves, 0.95):
            found.append(each)
    return found


def infer(
    table: Table,
    time: str = CLOCK,
    inputs: Collection[str] | None = None,
    states: Collection[str] | None = None,
    dt: float | None = None,
) -> tuple[dict[str, Column], dict[str, Column], list[Finding]]:
    """Read the columns of states and inputs off the headings of a file, `name` or `name [unit]`, and what is left out.

    Inputs, unless they are named, are called u, u1, u_..., or input..., and where none is, cmd or command; where none
    is either, as an actuator, such as a torque, and move others, or they are the columns that move in steps while all
    others move in most rows, and others of their kind. References, predictions, columns without any number, those that
    never change and those that count the rows are left out; all other columns but time are states, unless they are
    named.

    Args:
        table: the file.
        time: heading of the time column.
        inputs: names or headings of the inputs, without their units or with them.
        states: those of the states.
        dt: sampling time that was given [s]; the error then does not ask for it.

    Raises:
        ValueError: no heading is that of a state, or none that of an input.
    """
    path, names = str(table.path), [split_unit(heading)[0] for heading in table.headings]
    if double := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{path} has {', '.join(map(repr, double))} twice in its headings; rename all but one")
    clock, _ = clock_of(table.headings, time)
    timed = clock in table.headings
    own = ("reference_", "predicted_")  # in logs of ours
    columns = {name: Column(h) for name, h in zip(names, table.headings) if clock not in (h, name)}
    columns = {name: column for name, column in columns.items() if not name.startswith(own)}
    units = {name: split_unit(column.name)[1] for name, column in columns.items()}
    named = {found for name in (*(inputs or ()), *(states or ())) for found in find_names(name, columns)}
    kinds = {name: table.kinds[column.name] for name, column in columns.items()}
    moves = {name: moves for h, moves in table.moving().items() if (name := split_unit(h)[0]) in columns}
    if timed or dt is not None:
        t = table.column(clock) if timed else np.arange(len(table.frame), dtype=np.float64)
        kinds |= {name: "counter" for name in moves if _keeps_time(table.column(columns[name].name), t)}
    if dt is not None and not timed:  # even rows, unless a column may be a time by another name
        timed = not any(grows(column) for name, column in moves.items() if name not in named)
    numeric = {name: columns[name] for name, kind in kinds.items() if kind not in ("words", "dates", "empty")}
    why = {name: kind for name, kind in kinds.items() if kind != "moving" and not (name in named and name in numeric)}

    def leave(reason: str, out: Iterable[str]) -> None:
        why.update({name: reason for name in out if name not in named and name not in why})

    def left() -> dict[str, Array]:
        return {name: column for name, column in moves.items() if name not in why and name not in found}

    commands = [[name for name in numeric if called.fullmatch(name)] for called in (INPUT, COMMAND)]
    leave("reference", (n for n in numeric if REFERENCE.fullmatch(n) and n not in chain(*commands)))
    if inputs is None:
        found = next(filter(None, ([name for name in some if name not in why] for some in commands)), [])
        found = [name for name in found if name[0].islower()] or found  # U_left beside u may be anything
    else:
        found = _chosen(columns, inputs)
    leave("label", [name for name, column in left().items() if _is_label(column)])
    rest = left()
    followed = [n for n in rest if n not in named and _is_followed(rest[n], [rest[m] for m in rest if m != n])]
    guessed = not found and inputs is None and timed
    if guessed:
        free = {n: column for n, column in rest.items() if n not in followed and n not in named}
        acting = [n for n in _actuators(rest, units) if n not in named]
        # What moves in steps and no other follows is no reference, and drives what is called as an actuator, too.
        stepping = _in_steps(free, units)
        # A place that an encoder reads stands still as well.
        read = all(_is_measured(name, units[name]) for name in stepping)
        found = (acting if read else stepping) or stepping or _in_steps(rest, units)
        found, acting = [n for n in found if n not in named], found if found == acting else []
    led = [name for name in followed if name not in found]
    leave("followed", led)
    leave("label", [name for name, column in left().items() if _is_label(column, rarely=False)])
    references = [moves[name] for name, reason in why.items() if reason in ("reference", "followed") and name in moves]
    for reason, names in _dependent(left(), references, [moves[name] for name in found if name in moves]).items():
        leave(reason, names)
    driven = [name for name, column in left().items() if _acts_at_once(column, [moves[n] for n in found if n in moves])]
    leave("direct", driven if len(driven) < len(left()) else ())
    if states is None:
        chosen = [name for name in numeric if name not in why and name not in found]
    else:
        chosen = _chosen([name for name in columns if name not in found], states)
        why = {
            name: kind
            for name, kind in why.items()
            if name not in numeric or (kind in ("constant", "counter") and INPUT.fullmatch(name))
        }
        led = []
    out = list[Finding]()
    for reason in LEFT_OUT:
        those: Any = [name for name, kind in why.items() if kind == reason]
        if reason == "constant":
            those = {name: float(np.nanmax(table.column(columns[name].name))) for name in those}
        elif reason == "dates" and not timed:
            those = those[1:]  # the first is the time where nothing else is
        out += [note("log.left_out", why=reason, columns=those)] if those else []
    if not chosen or not found or not timed:
        lacks = "time" if not timed else "states" if found else "inputs"
        numbers = table.of_kind("constant", "counter", "moving")
        facts: dict[str, Any] = {"columns": table.headings, "numbers": numbers, "clock": clock}
        follow = [name for name, reason in why.items() if reason in ("reference", "derived")]
        if numbers and (guess := _guess_columns(table, clock if timed else None, found, follow))["states"]:
            facts["guess"] = guess
        raise LogError("log.no_roles", path=path, lacks=lacks, left_out=out, **facts)
    moving = min((_standing(moves[name]) for name in chosen if name in moves), default=1.0) < HELD
    still = [name for name in left() if name in chosen and states is None and _is_held(moves[name], moving)]
    if still:
        out.append(weak("log.held_states", states=still))
    if led:
        out.append(weak("log.followed", columns=led, states=[*chosen, *led]))
    if guessed:
        out.append(weak("log.guessed_inputs", inputs=found, states=chosen, named=bool(acting)))
    driving = {name: columns.get(name, Column(name)) for name in found}
    return {name: columns.get(name, Column(name)) for name in chosen}, driving, out


def _is_label(column: Array, rarely: bool = True) -> bool:
    """Tell whether a column holds a few whole numbers, which change in hardly any row, or whenever they are two."""
    levels = len(np.unique(column)) if len(column) and not (column % 1).any() else 0
    return 1 < levels <= 10 and _standing(column) > 1 - RARE if rarely else levels == 2


def _is_held(column: Array, others_move: bool) -> bool:
    """Tell whether a column stands in most rows, between all moves or while others move, as no coarse sensor does."""
    moves, steps = np.flatnonzero(np.diff(column)), np.abs(np.diff(column))
    if len(moves) < 2 or _standing(column) <= HELD or np.median(steps[moves]) <= 2 * _last_digit(column):
        return False
    return others_move or bool(np.median(np.diff(moves)) > 1)


def _acts_at_once(column: Array, inputs: Sequence[Array]) -> bool:
    """Tell whether a column jumps in the very rows in which an input does, and by as much: a state moves after them."""
    for u in inputs if len(column) > 20 else ():
        moved, jumps = np.diff(column), np.abs(np.diff(u)) > 0.05 * np.ptp(u)
        if 10 <= jumps.sum() < 0.5 * len(moved):
            far = np.median(np.abs(moved[jumps])) > 5 * np.median(np.abs(moved[~jumps]))
            if far and abs(np.corrcoef(moved[jumps], np.diff(u)[jumps])[0, 1]) > 0.9:
                return True
    return False


def _dependent(
    columns: Mapping[str, Array], references: Sequence[Array], inputs: Sequence[Array]
) -> dict[str, list[str]]:
    """Return columns that hold one before them a row earlier or later, that follow from others, and that are noise.

    Those that follow are sums of a few of those before them and of references, sums of products of any others, roots of
    such, and integrals of an error. Other sums with inputs are none: of an input that a controller makes of states any
    of these is one.
    """
    names, every = [*columns], 1 + max(map(len, columns.values()), default=0) // 2000
    whole = (*columns.values(), *references, *inputs)
    before, x = (np.array([column[k : len(column) - 1 + k : every] for column in whole]) for k in (0, 1))
    if not names or x.shape[1] < 100:
        return {}
    count, width, own = len(names), len(x), len(x) - len(inputs)
    noisy, mine = _noisy(before, x, count, own), (before[:count], x[:count])
    moves = (mine[0] != mine[1]).mean(1) > 0.9  # another episode may begin now and then
    both = (mine, mine[::-1])
    shifted = [k for k in range(count) if moves[k] and any(((a[:k] == b[k]).mean(1) > 0.9).any() for a, b in both)]
    pairs = np.array([*combinations_with_replacement(range(width * (width <= WIDEST)), 2)], int).reshape(-1, 2).T
    low, high = np.append(np.tile(np.arange(width), (2, 1)), pairs, 1)  # columns of each term
    plain, driven, referred = np.arange(len(high)) < width, high >= own, high >= count
    size, half = np.quantile(np.abs(x), 0.99, 1), 0.5 * np.array([*map(_last_digit, x)])
    halves = np.append(half, (size[pairs] * half[pairs[::-1]]).sum(0))  # of the last digit, as rounding makes it
    found = {*shifted}

    def level(values: Array) -> Array:
        return values - values.mean(-1, keepdims=True)

    def products(values: Array) -> Array:
        return np.concatenate([values, values[pairs[0]] * values[pairs[1]]])

    def few_terms(k: int, y: Array, terms: Array, free: NDArray[np.bool_], digit: float, exact: float = EXACT) -> Array:
        """Return factors of the fewest terms whose sum a column is, but for rounding; zeros where it is none."""
        free = free & ~np.isin(low, [k, *found]) & ~np.isin(high, [k, *found])
        norms, few = np.where(free, np.linalg.norm(terms, axis=1) + 1e-300, np.inf), list[int]()
        rest, wide, factors = y, float(np.ptp(np.quantile(y, [0.01, 0.99]))), np.zeros(len(terms))
        while wide and len(few) < min(FEW, int(free.sum())):
            few.append(int((np.abs(terms @ rest) / norms).argmax()))
            factors[few] = np.linalg.lstsq(terms[few].T, y, rcond=None)[0]
            rest = y - factors[few] @ terms[few]
            if rest.std() <= min(max(math.hypot(digit, *factors[few] * halves[few]), exact * wide), 1e-3 * wide):
                return factors
        return 0 * factors

    terms = products(x)
    table = level(terms)
    for k in reversed(range(count)):
        before_it = plain & ~driven & ((high < k) | referred)
        total = few_terms(k, level(x[k]), table, before_it, half[k], 0.0).any()
        factors = few_terms(k, level(x[k]), table, high >= 0, half[k])[width:]
        root = x[k].min() >= 0 and few_terms(k, x[k] ** 2, terms, high >= 0, 2 * size[k] * half[k]).any()
        if total or root or (factors @ table[width:]).std() > 0.01 * x[k].std():
            found.add(k)
    for late in (0.0, 0.5, 1.0) if references else ():
        table = level(products(x + late * (before - x)))
        for k in range(count):
            if few_terms(k, level(x[k] - before[k]), table, ~driven, 2 * half[k])[referred].any():
                found.add(k)

    out = {"shifted": shifted, "derived": sorted(found - {*shifted}), "noise": noisy}
    return {reason: [names[k] for k in places] for reason, places in out.items()}


def _noisy(before: Array, x: Array, count: int, own: int) -> list[int]:
    """Return which of the first `count` columns no row before foretells, beside smooth ones; inputs begin at `own`."""
    then, now = np.clip([before, x], *np.quantile(x, [0.05, 0.95], axis=1)[..., None])  # without spikes
    table = np.concatenate([np.ones_like(x[:1]), then, now[own:]])
    if x.shape[1] <= 20 * len(table):
        return []
    rest = now[:count] - np.linalg.lstsq(table.T, now[:count].T, rcond=None)[0].T @ table
    missed = rest.var(1) / (now[:count].var(1) + 1e-300)
    return [int(k) for k in np.flatnonzero((missed > NOISE) & (missed.min() < 0.1))]


def _last_digit(column: Array) -> float:
    """Return the least distance between two numbers of a column, which its last digit makes, but for rounding."""
    steps = np.diff(np.unique(column))
    steps = steps[steps > 1e-12 * np.abs(column).max(initial=0.0)]
    return float(steps.min(initial=np.inf)) if len(steps) else 0.0


ACTUATOR = re.compile(
    r"(.*[_ .])?(torque|tau|voltage|volts?|current|duty|pwm|pump|valve|heater|throttle|force|thrust|steering"
    r"|motor|fan|servo|actuator|drive)([_ .\d].*)?",
    re.I,
)
"""How inputs may be called where none is called an input or a command, if they move what is called otherwise."""
MEASURED = re.compile(
    r"position|angle|speed|veloc|rate|rpm|temp|press|level|flow|height|accel|encoder|(?<![a-z])enc(?![a-z])|sensor|meas"
    "|actual|feedback",
    re.I,
)
MEASURED_UNIT = re.compile(r"rad|deg|°|counts?|px|[cmk]?m|°?C|degC|K|rpm|.+/s")
"""What the name of a measurement holds, though it is one of an actuator, and its unit."""
CHANCE = 30.0
"""Rows of a log whose part of a variance counts as chance."""
DRIVEN = 0.5
"""Part of the variance of what is called an actuator from which on another one that predicts it is the input."""
RARE = 0.01
"""Share of the rows in which a label changes at most."""
REFERENCE = re.compile(
    r"(.*[_ .])?(ref|desired|demand|r[e\u00e9]f[e\u00e9]ren\w*|set[_ ]?point|sp|target|soll\w*|consign\w*)([_ .\d].*)?",
    re.I,
)
"""What references are called, in several languages."""
FEW, WIDEST, EXACT = 5, 40, 1e-5
"""Terms of which a column may be a sum, columns up to which their products are looked for, and the part of its range by
which it may differ, as one of few digits does."""
NOISE = 0.7
"""Part of its variance that no row before foretells by which a column is noise beside smooth ones."""
JUMP = 5.0
"""Times by which an input changes most beyond what nearly all of its changes are; of noise it is twice."""
HELD = 0.5
"""Share of the rows with the same number as before beyond which a column moves in steps."""


def _chosen(columns: Collection[str], names: Collection[str]) -> list[str]:
    return [next(iter(find_names(name, columns)), name) for name in names]  # what is not there is refused on reading


def find_clock(table: Table, time: str, named: Collection[str], dt: float | None) -> str:
    """Return the heading of the time of a log in which nothing is called one.

    It is the only column with a unit of time that rises throughout, and by much the same in most rows; dates are as
    good as a unit, and so are numbers that only a date can be. Where the sampling time is given it is else the counter
    of rows: the only column that grows all along, in whole numbers and, but where rows are missing, by the same step.
    An encoder of a motor that turns one way grows, too, by other steps. Where there is no such column, or a choice,
    what was given is returned.

    Args:
        table: The file.
        time: Heading of the time as it was given, or `time`.
        named: Names of the columns that were named as states or inputs.
        dt: Sampling time that was given [s]; dates are looked at where there is none.
    """
    if time != CLOCK or any(map(is_clock, table.headings)) or named_by(time, table.headings):
        return time
    growing = {heading: column for heading, column in table.moving().items() if grows(column)}
    columns = {h: column for h, column in growing.items() if parts_of(h)[1].lower() in SECONDS or date_unit(column)}
    columns |= {h: c for h, c in growing.items() if h.lower() in (*SECONDS, "t") and _is_regular(c, 0.02)}
    columns |= {h: table.column(h) for h in table.dated if dt is None}
    found = [h for h, column in columns.items() if _is_regular(column)]
    if dt is not None and not found and not table.dated and len(growing) == 1:  # whole numbers, by one step
        ((only, column),) = growing.items()
        found = [only] * (is_counter(column) and counts(column, float(np.median(np.diff(column)))))
    found = [h for h in found if split_unit(h)[0] not in named]
    return found[0] if len(found) == 1 else time


def _is_regular(column: Array, within: float = 0.5) -> bool:
    steps = np.diff(column[np.isfinite(column)])
    return bool(len(steps) and (steps > 0).all() and (np.abs(steps / np.median(steps) - 1) < within).mean() > HELD)


def _keeps_time(column: Array, t: Array) -> bool:
    """Tell whether a column grows as a time does, on a straight line or in even ticks of more than a row."""
    rows = np.isfinite(column) & np.isfinite(t)
    x, t = column[rows], t[rows]
    if len(t) < COUNTED or (np.diff(x[:1000]) < 0).mean() > 0.1 or not grows(t):
        return False
    x = np.unwrap(x, period=next((size for size in OVERFLOWS if np.ptp(x) < size), np.inf))
    steps = np.diff(x)
    if not (steps >= 0).all():
        return False
    off = np.abs(x - x[0] - np.ptp(x) / (t[-1] - t[0]) * (t - t[0])).max()
    ticks = steps.max() if (steps > 0).sum() >= 3 else 0.0
    return bool(steps.max() > 0 and off <= max(ticks, 1e-3 * np.ptp(x)))


def _guess_columns(table: Table, time: str | None, inputs: Sequence[str], left_out: Collection[str]) -> dict[str, Any]:
    """Return a first guess at time, a column that grows, inputs, which act more than they are moved, and states."""
    columns = table.moving()
    growing = sorted((h for h in columns if grows(columns[h])), key=lambda heading: is_counter(columns[heading]))
    time = time or next(iter([*table.of_kind("dates"), *growing]), None)
    t = table.column(time) if time else np.zeros(0)
    aside = {time, *table.of_kind("counter"), *(h for h in columns if time and _keeps_time(table.column(h), t))}
    own = {name: x for h, x in columns.items() if (name := split_unit(h)[0]) not in left_out and h not in aside}
    names = [*own]
    if not inputs and names:
        held = sorted((name for name in names if _standing(own[name]) > HELD), key=lambda name: -_standing(own[name]))
        candidates = held or (names[::-1] if len(names) <= WIDEST else names[-1:])
        acting = max(candidates, key=lambda name: np.subtract(*_influence(name, own)))
        units = dict(map(split_unit, columns))
        first = next((name for name in names if _is_actuator(name, units[name])), acting)
        pair = [name for name in _alike(first, units) if name in names]
        inputs = pair if len(pair) < len(names) else [first]  # one matrix is no pair
    states = [name for name in names if name not in inputs]
    return {"time": split_unit(time)[0] if time else None, "inputs": [*inputs], "states": states}
