"""Logs of any plant, from files of many programs, as transitions; nothing is lost without a word.

A row without a time or an input is skipped. One without a state stays, NaN there, for its inputs act all the same.

Samples at uneven times are taken to even ones, so that what a held input did to the states stays what it did. A digital
controller that is late now and then sets its input late, too: the input jumps between two even times, and with it the
slopes of the states. A spline over such a jump swings, and the value of an input at the beginning of an even step is
not what acted during that step.

| of       | taken is                                                                                        |
| -------- | ----------------------------------------------------------------------------------------------- |
| a state  | a cubic spline over the samples between two jumps of an input; straight lines between single ones |
| an input | its mean over the step, held from each sample to the next: to first order in the step the same    |
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from dynasindy.data.clock import CLOCK, clock_of, in_seconds, period_of
from dynasindy.data.columns import Column, as_map, find_clock, infer
from dynasindy.data.headings import NAME, find_names, in_radians, is_rate_of, named_by, split_unit
from dynasindy.data.rates import ALIKE, RPM, compare_rate, require_consistent_rates
from dynasindy.data.table import Table, correct_map
from dynasindy.findings import Finding, LogError, note, weak
from dynasindy.sentences import setting
from dynasindy.systems.actuator_scaling import PLAIN, ActuatorScaling, actuator_units
from dynasindy.systems.base import WHOLE, Signature, turn_of
from dynasindy.systems.transitions import Transitions

Array = NDArray[np.float64]
ROUNDED = 1e-3
"""Part by which an input may leave its ends and still be meant to be within them, as rounding makes it."""
SIMILAR = 3.0
"""Times as far as another that an input may go to be one of its kind."""
WIDE = 20.0
"""Range of an actuator, as a multiple of that in its log, from which on a note asks whether it is the right one."""
LEAST = 50
"""Fewest transitions that are worth a fit, and samples of each state."""
FAULTY = 0.05
"""Part of the samples in which a sensor fails at most, and of the range by which it is off at least."""
FAR = 10
"""Times the largest other step between rows from which on one is none that a plant makes."""
LONG = 10
"""Usual distances between two samples of a state from which on what lies between them is a gap."""
GAP = 1.5
"""Sampling times from which on what lies between two samples is lost."""
EVEN = 0.02
"""Part of a sampling time by which samples may be early or late and are taken as they are."""
FEWEST = 4
"""Samples in a stretch from which on it is resampled."""
JUMP = 0.05
"""Part of its range by which an input changes from sample to sample where it jumps; one that moves less is smooth."""


@dataclass(frozen=True)
class Recording:
    """Hold what a file gave.

    Attributes:
        transitions: the samples, in unbroken segments; NaN where a state was not measured.
        signature: names, units and ranges.
        findings: what was skipped, masked, resampled, converted or reconstructed.
    """

    transitions: Transitions
    signature: Signature
    findings: tuple[Finding, ...] = ()


class _Part(NamedTuple):
    path: str
    states: dict[str, Column]
    inputs: dict[str, Column]
    t: Array
    x: dict[str, Array]
    u: Array
    findings: list[Finding]


@dataclass(frozen=True)
class LogReader:
    """Read a recording from a file, or from several.

    Attributes:
        path: the file, text or another format of `dynasindy.data.files`. Several files with the same columns are one
            recording.
        states: columns of the states by name, in the order of x: the heading, or the keys of a `Column`. A list names
            columns as they are. Without either the names are those of the plant, or what the headings say where no
            plant is named.
        inputs: columns of the inputs, likewise.
        time: heading of the time column, with another unit than seconds as in `count [ms]`; `Time` or `t`, too, where
            nobody says one.
        dt: sampling time [s]; by default what the times tell, their median unless a coarse clock wrote them. Where the
            time counts rows it is the time between two.
        known: equations that are known, by state. A state that is the rate of another one needs no column: one that
            has none is estimated with the model.

    Raises:
        ValueError: there is no path, a column is named twice, or a setting is not allowed.
    """

    path: str | Sequence[str] | None
    states: Mapping[str, Any] | Sequence[str] | None = None
    inputs: Mapping[str, Any] | Sequence[str] | None = None
    time: str = CLOCK
    dt: float | None = None
    known: Mapping[str, str] | None = None

    def __post_init__(self) -> None:
        if not self.path:
            raise ValueError(
                f"there is no {setting('data.path')}; allowed is a file, or a list of some: give "
                f"{setting('data.path')}=log.csv"
            )
        for key in ("states", "inputs"):
            given = getattr(self, key)
            if given is not None and not (given and len(set(given)) == len(given)):
                raise ValueError(
                    f"{setting(f'data.{key}')} is {given}; allowed are the names of columns, each once, or null, where "
                    "the headings are to tell: correct it"
                )
        if self.dt is not None and not 0 < self.dt < math.inf:
            raise ValueError(f"{setting('data.dt')} is {self.dt} s; allowed is a time > 0, or none for the file's own")

    @property
    def paths(self) -> tuple[str, ...]:
        """Return the files."""
        return (self.path,) if isinstance(self.path, str) else tuple(self.path or ())

    def known_rates(self, names: Sequence[str]) -> dict[str, str]:
        """Return what is known by the names of the states, which may have been given as the headings are.

        Args:
            names: Names of the states; of what is none of them the name stays.
        """
        given = (self.known or {}).items()
        return {next(iter(find_names(s, names)), s): next(iter(find_names(r, names)), r) for s, r in given}

    def recording(self, plant: Signature | None = None) -> Recording:
        """Read the file, or all files, each of which is segments of its own.

        Args:
            plant: Names, units and ends of the plant that it is of; the file itself has to tell them where there is
                none: inputs that go beyond [-1, 1] are then taken into it by their range in the file. Of states without
                a column the ranges are used, too.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: a column is missing, time does not increase, an input is constant or leaves its ends, a state
                has ends, there are too few samples, files differ in their units or sampling times, or a known rate is
                in other units than its state.
        """
        tables, left_out = [Table.read(Path(path)) for path in self.paths], list[Finding]()
        time, states, inputs = self._columns(tables, plant, left_out)
        given_units = {name: column.unit for name, column in states.items()}
        columns = [*states.items(), *inputs.items()]
        names, headings = [name for name, _ in columns], [column.name for _, column in columns if column.name]
        for name, column in columns:  # a function or number in an equation, or twice
            if not NAME.fullmatch(name) or names.count(name) > 1 or headings.count(column.name) > 1:
                raise LogError("log.name", file=str(self), name=name)
        parts = [self._part(table, time, states, inputs, plant) for table in tables]
        _, states, inputs, *_ = parts[0]
        dt = _one_period(parts, self.dt)
        u = np.concatenate([part.u for part in parts])
        ranges = _actuator_ranges(str(self), u, inputs, plant is None, of_inputs := list[Finding]())
        rest, unit = np.array([(each.rest, each.unit) for each in ranges]).T
        pieces, sizes = [], np.zeros(len(states))
        for part in parts:
            t, x, u, segment = _resample(part.t, part.x, (part.u - rest) / unit, dt, part.findings)
            usable = ~(_long_gaps(x, segment, part.findings) | _stops(x, part.findings))
            for state, values in x.items():
                part.findings.extend(_jumps(state, states[state].unit, values, t, u, usable))
            full = np.stack([x.get(name, np.full(len(t), np.nan)) for name in states], -1)
            sizes = np.maximum(sizes, np.abs(np.nan_to_num(full)).max(0, initial=0.0))
            whole = torch.from_numpy((segment[1:] == segment[:-1]) & usable[1:] & usable[:-1])
            states_, inputs_ = (torch.from_numpy(np.ascontiguousarray(each)) for each in (full, u))
            labels = torch.from_numpy(segment[:-1].astype(np.int64))
            pieces.append(Transitions(states_[:-1], inputs_[:-1], states_[1:], dt, labels).select(whole))
        data = pieces[0] if len(pieces) == 1 else Transitions.cat(pieces)
        for k, name in enumerate(states):
            if given_units[name] == "-" and _is_angular_speed(data, k, [*states.values()]):
                data.x[:, k], data.x_next[:, k], sizes[k] = RPM * data.x[:, k], RPM * data.x_next[:, k], RPM * sizes[k]
                states[name] = replace(states[name], unit="rad/s", scale=RPM * states[name].scale)
        findings = [
            replace(each, values={**each.values, "file": part.path}) if len(parts) > 1 else each
            for part in parts
            for each in part.findings
        ]
        findings += [*of_inputs, *_conversions(states)]
        findings += (note("log.unmeasured", state=name) for name in states if name not in parts[0].x)
        samples = dict(zip(states, data.x_next.isfinite().sum(0).tolist(), strict=True))
        few: list[dict[str, Any]] = [{"count": len(data)}] if len(data) < LEAST else []
        if few := few + [{"count": n, "state": s} for s, n in samples.items() if states[s].name and n < LEAST]:
            left_out = [each for each in findings if each.code != "log.time"]
            raise LogError("log.too_few", path=str(self), least=LEAST, left_out=left_out, **few[0])
        units = tuple(c.unit for c in states.values())
        scale = tuple(size or 1.0 for size in sizes.tolist())
        reach = actuator_units(ranges, [column.unit for column in inputs.values()])
        signature = Signature(tuple(states), units, tuple(inputs), scale, **reach)
        require_consistent_rates(data, signature, self.known_rates([*states]), states, str(self))
        if plant is not None:
            signature = _of_plant(signature, plant, data.x.isnan().all(0).tolist())
        return Recording(data, signature, (*findings, *left_out))

    def _columns(
        self, tables: Sequence[Table], plant: Signature | None, findings: list[Finding]
    ) -> tuple[str, dict[str, Column], dict[str, Column]]:
        """Return the heading of the time, states and inputs: those that were given, of the plant, or else inferred."""
        mapped = [isinstance(given, Mapping) for given in (self.states, self.inputs)]
        states, inputs = (
            _columns_of(given if isinstance(given, Mapping) else {name: name for name in given or ()}, states)
            for given, states in ((self.states, True), (self.inputs, False))
        )
        taken = [split_unit(column.name or name)[0] for name, column in {**states, **inputs}.items()]
        time = find_clock(tables[0], self.time, taken, self.dt)
        if plant is not None:
            headings, rates = tables[0].headings, set((self.known or {}).values())
            states = states or {
                name: Column("" if name in rates and not named_by(name, headings) else name, unit)
                for name, unit in zip(plant.state_names, plant.state_units, strict=True)
            }
            inputs = inputs or {name: Column(name) for name in plant.input_names}
            return time, states, inputs
        if not (states and inputs and all(mapped)):
            named = [column.name for column in inputs.values()] or None, None if mapped[0] else [*states] or None
            inferred, refused = [], list[ValueError]()
            for table in tables:
                try:
                    inferred.append(infer(table, time, *named, self.dt))
                except ValueError as error:
                    refused.append(error)
            if not inferred:
                raise refused[0]
            # Of the file in which most of them move: what stands still in one may move in another.
            *both, left_out = max(inferred, key=lambda each: len(each[0]) + len(each[1]))
            findings += left_out
            states, inputs = (
                given if given and is_map else found
                for given, is_map, found in zip((states, inputs), mapped, both, strict=True)
            )
        return time, states, inputs

    def __str__(self) -> str:
        return ", ".join(self.paths)

    def _part(
        self, file: Table, time: str, states: dict[str, Column], inputs: dict[str, Column], plant: Signature | None
    ) -> _Part:
        path, (clock, unit) = str(file.path), clock_of(file.headings, time)
        names = [clock, *(c.name for c in (*states.values(), *inputs.values()) if c.name)]
        table = file.select(names, self.dt)
        findings, driving = [*table.findings], slice(len(names) - len(inputs), None)
        full = dict(zip(names[1:], table.headings[1:], strict=True)) | {"": ""}
        states, inputs = (
            {name: replace(column, name=full[column.name]) for name, column in columns.items()}
            for columns in (states, inputs)
        )
        states = _with_units(states, True, self.known_rates([*states]))
        inputs = _with_units(inputs if plant is None else _with_actuator_ranges(inputs, plant), False)
        frame = table.frame.where(np.isfinite(table.frame))
        frame = _without_copies(_hold_inputs(frame, driving, findings), driving, findings)
        frame = _with_times(frame, driving, findings)
        t, of_time = in_seconds(replace(table, frame=frame), unit, self.dt)
        if (np.diff(t) < 0).any():
            frame = _in_order(frame, driving, findings)
            t, of_time = in_seconds(replace(table, frame=frame), unit, self.dt)
        whole = frame.iloc[:, driving].notna().all(axis=1).to_numpy()
        t, lines, values = t[whole], frame.index[whole], frame.to_numpy()[whole].T
        if len(t) < 2:
            raise LogError("log.too_few", path=path, count=0, least=LEAST, left_out=[])
        if (back := np.diff(t) <= 0).any():
            k = int(back.argmax())
            place = {"line": int(lines[k + 1]), "column": clock}
            raise LogError("log.time_order", file=path, **place, after=float(t[k + 1]), before=float(t[k]))
        columns = dict(zip(table.headings[1:], values[1:], strict=True))
        measured = {name: (columns[c.name] * c.scale, c.unit) for name, c in states.items() if c.name}
        sound = ((name, _without_spikes(name, x, unit, lines, findings), unit) for name, (x, unit) in measured.items())
        x = {name: _unwrap_angle(name, column, unit, findings) for name, column, unit in sound}
        u = np.stack([columns[c.name] * c.scale for c in inputs.values()], -1)
        return _Part(path, states, inputs, t, x, u, [*of_time, *findings])


def _with_times(frame: pd.DataFrame, driving: slice, findings: list[Finding]) -> pd.DataFrame:
    """Return rows with a time, all of which tell a clock; what is missing in them, as inputs are, is counted."""
    bad = frame.isna().to_numpy()
    needed = np.zeros(bad.shape[1], dtype=bool)
    needed[0] = needed[driving] = True
    skipped = np.asarray(bad[:, needed].any(1))
    for rows, skips in ((skipped, True), (bad.any(1) & ~skipped, False)):
        if rows.any():
            counts = bad[rows].sum(0)
            facts = {
                "rows": int(rows.sum()),
                "total": len(frame),
                "counts": {heading: int(k) for heading, k in zip(frame, counts, strict=True) if k},
                "line": int(frame.index[rows.argmax()]),
                "skipped": skips,
            }
            findings.append(note("log.missing", **facts))
    return frame[~bad[:, 0]]


def _without_copies(frame: pd.DataFrame, driving: slice, findings: list[Finding]) -> pd.DataFrame:
    """Return a table without rows that stand there twice; of two that differ in an input the second one stays."""
    values = frame.to_numpy()[:, : driving.start]
    again = ((values[1:] == values[:-1]) | np.isnan(values[1:]) & np.isnan(values[:-1])).all(1)
    kept = np.append(~again, True)
    if not again.any() or (np.diff(values[kept, 0]) <= 0).any():
        return frame
    findings.append(note("log.copies", count=int(again.sum()), line=int(frame.index[1:][again.argmax()])))
    return frame[kept]


def _in_order(frame: pd.DataFrame, driving: slice, findings: list[Finding]) -> pd.DataFrame:
    """Return rows in the order of their times, unless steps are shorter then, as where a clock was set back."""
    said = list[Finding]()
    ordered = _without_copies(frame.sort_values(frame.columns[0], kind="stable"), driving, said)
    steps, late = np.diff(ordered.iloc[:, 0]), np.diff(frame.iloc[:, 0]) < 0
    if steps.min() < 0.6 * np.median(steps):
        return frame
    findings += [note("log.sorted", count=int(late.sum()), line=int(frame.index[1:][late][0])), *said]
    return ordered


def _hold_inputs(frame: pd.DataFrame, driving: slice, findings: list[Finding]) -> pd.DataFrame:
    """Return a table whose inputs are held where rows of another stream have none: a command stands until the next."""
    measured = frame.iloc[:, 1 : driving.start].notna().any(axis=1).to_numpy()
    for k in range(driving.start, frame.shape[1]):
        column = frame.iloc[:, k]
        rows = np.flatnonzero(column.notna())
        if not 0 < len(rows) <= 0.8 * len(frame):  # few rows without one are lost
            continue
        steps = np.diff(rows)
        evenly = len(steps) == 0 or (steps == np.median(steps)).mean() >= 0.8
        alone = measured[rows].mean() <= 0.2
        longest = np.diff(np.append(rows, len(frame))).max()
        if (evenly or alone) and longest <= LONG * len(frame) / len(rows):
            frame = frame.copy()
            frame.isetitem(k, column.ffill())
            findings.append(note("log.zero_order_hold", column=column.name, rows=len(rows), total=len(frame)))
    return frame


def _without_spikes(name: str, x: Array, unit: str, lines: pd.Index, findings: list[Finding]) -> Array:
    """Return samples without those at which a state leaves its course for one row, as a sensor that fails writes."""
    measured = np.isfinite(x)
    value = x if measured.all() else x[measured]
    if len(value) < 7:
        return x
    turn = turn_of(unit)  # an angle that passes a whole turn to and fro, as noise moves it, leaves no course
    course = np.unwrap(value, period=turn) if np.ptp(value) <= 1.001 * turn < np.inf else value
    around = np.pad(course, 1, mode="edge")  # at the ends nothing tells a fault from a start
    before, after = around[:-2], around[2:]
    off = np.abs(course - 0.5 * (before + after))
    usual, (low, high) = float(np.quantile(off, 0.9)), np.quantile(value, [0.1, 0.9])
    far = (off > max(20 * usual, FAULTY * (high - low))) & (np.abs(after - before) < 0.1 * off)
    if not usual or not 0 < far.sum() <= FAULTY * len(value):
        return x
    codes, counts = np.unique(value[far], return_counts=True)
    codes = codes[(counts > 1) & ((codes < low) | (codes > high))]  # of a sensor that fails, also twice in a row
    spikes = np.union1d(np.flatnonzero(measured)[far], np.flatnonzero(np.isin(x, codes)))
    found = {"count": len(spikes), "line": int(lines[spikes[0]]), "value": float(x[spikes[0]])}
    findings.append(note("log.spikes", state=name, **found))
    left = x.copy()
    left[spikes] = np.nan
    return left


def _unwrap_angle(name: str, x: Array, unit: str, findings: list[Finding]) -> Array:
    """Return samples of a place that goes round, which go on where they jumped by a whole turn or their range."""
    measured = np.isfinite(x)
    values = x[measured]
    width, steps = float(np.ptp(values)) if len(values) else 0.0, np.diff(values)
    inside = np.abs(values - values.min(initial=np.inf) - 0.5 * width) < 0.25 * width
    if not width or not (np.abs(steps) > 0.5 * width).any() or inside.mean() <= 0.05:  # two levels are no angle
        return x
    turns = {"rad": (2 * np.pi,), "deg": (360.0,), "turn": (1.0,), "-": (2 * np.pi, 360.0)}.get(unit, ())
    for turn in (*turns, *_turn_seen(steps, np.diff(np.flatnonzero(measured)), width)):
        jumps = np.abs(steps) > 0.5 * turn
        left = np.abs(steps - turn * np.round(steps / turn))
        begins = min(abs(values.min()), abs(values.min() + 0.5 * turn))  # from 0, or from minus half a turn
        if not jumps.any() or not 0.9 * turn <= width <= 1.001 * turn or (unit == "-" and begins > 0.05 * turn):
            continue
        if left.max() <= 0.25 * turn and left[jumps].max() <= 3 * np.abs(steps[~jumps]).max():
            found = x.copy()
            found[measured] = np.unwrap(values, period=turn)
            seen = {"times": int(jumps.sum()), "counts": turn not in turns}
            findings.append(note("log.unwrapped", state=name, turn=turn, **seen))
            return found
    return x


def _jumps(name: str, unit: str, x: Array, t: Array, u: Array, usable: NDArray[np.bool_]) -> list[Finding]:
    """Tell of a few steps from row to row that are far beyond all others at which an input jumps, or none does."""
    rows = np.flatnonzero(np.isfinite(x) & usable)
    steps, ahead = np.abs(np.diff(x[rows])), np.diff(t[rows])
    driven = (np.abs(np.diff(u[rows], axis=0)) > JUMP * np.ptp(u, axis=0)).any(1)
    for alike in (driven, ~driven) if len(steps) else ():
        alike = alike & (ahead < GAP * np.median(ahead))
        few = min(2 + int(FAULTY * alike.sum()), int(alike.sum()))
        sizes = np.sort(np.partition(steps[alike], -few)[-few:])[::-1] if few else steps[:0]
        far = np.flatnonzero(sizes[:-1] > FAR * sizes[1:])
        if len(far) and sizes[far[-1] + 1] > 0:
            after = float(t[rows[1 + (alike & (steps >= sizes[far[-1]])).argmax()]] - t[0])
            facts = {"times": int(far[-1]) + 1, "size": float(sizes[0]), "usual": float(sizes[far[-1] + 1])}
            turn = {name: {"name": name, "unit": "turn", "scale": float(f"{1 / np.ptp(x[rows]):.4g}")}}
            states = {} if "/" in unit or unit == "rpm" else turn
            return [weak("log.jumps", state=name, after=after, **facts, states=states)]
    return []


def _turn_seen(steps: Array, rows: NDArray[np.int64], width: float) -> tuple[float, ...]:
    """Return the length of a turn by what jumps lack to the steps beside them, which is about the same."""
    slopes = np.pad(steps / rows, 2, mode="edge")  # as those around a jump tell, to the fourth order
    beside = (4 * (slopes[1:-3] + slopes[3:-1]) - slopes[:-4] - slopes[4:]) * rows / 6
    far = np.abs(steps) > 0.5 * width
    lacking, usual = np.abs(beside - steps)[far], float(np.median(np.abs(beside[far])))
    turn = float(np.median(lacking))
    spread = float(np.median(np.abs(lacking - turn)))
    # What is set to 0 at an end lacks up to a step more or less, and a quarter of one in the median.
    if len(lacking) < 3 or spread > 0.1 * usual:
        return ()
    known = (2.0 ** round(math.log2(turn)), *(float(f"{turn:.{k}g}") for k in range(1, 13)), turn)
    return (next(each for each in known if abs(each - turn) <= max(spread, 1e-3 * usual)),)


def _resample(
    t: Array, x: dict[str, Array], u: Array, dt: float, findings: list[Finding]
) -> tuple[Array, dict[str, Array], Array, NDArray[np.int64]]:
    """Return times, states, inputs and segments of samples at even times; segments break at gaps.

    States `(N,)` are NaN where one was not measured, and so are even times next to such a sample; inputs, `(N, n_u)`,
    are held from each sample to the next.
    """
    breaks = np.diff(t) > GAP * dt
    if breaks.any():
        findings.append(note("log.gaps", count=int(breaks.sum())))
    segment = np.concatenate([[0], np.cumsum(breaks)])
    uneven = np.abs(np.diff(t)[~breaks] - dt) > EVEN * dt
    if not uneven.any():
        return t, x, u, segment
    findings.append(note("log.resampled", count=int(uneven.sum()), total=len(t) - 1, dt=dt))
    parts, wide = [], np.ptp(u, axis=0)
    for label, rows in enumerate(np.split(np.arange(len(t)), np.flatnonzero(breaks) + 1)):
        if len(t[rows]) < FEWEST:
            continue
        grid = np.arange(t[rows][0], t[rows][-1] + 1e-9 * dt, dt)
        # The mean of held inputs over each even step; no step follows the last row.
        at, held = t[rows], u[rows]
        whole = np.concatenate([np.zeros((1, u.shape[1])), np.cumsum(held[:-1] * np.diff(at)[:, None], 0)])
        sums = np.stack([np.interp(grid, at, column) for column in whole.T], -1)
        means = np.append(np.diff(sums, axis=0) / dt, held[-1:], 0)
        jumps = (np.abs(np.diff(held, axis=0)) > JUMP * wide).any(-1)
        moved = np.stack([_between_jumps(at, column[rows], jumps, grid) for column in x.values()], -1)
        parts.append((grid, moved, means, np.full(len(grid), label)))
    if not parts:
        raise LogError("log.uneven", dt=dt)
    times, found, inputs, labels = (np.concatenate(column) for column in zip(*parts, strict=True))
    return times, {name: found[:, k] for k, name in enumerate(x)}, inputs, labels


def _between_jumps(t: Array, column: Array, jumps: NDArray[np.bool_], grid: Array) -> Array:
    """Return a state at even times, `(n,)`, NaN where it was lost and no sample is within half a step.

    `jumps` says at which samples but the first an input jumps.
    """
    from scipy.interpolate import CubicSpline  # half a second of imports that most logs do without

    measured = np.isfinite(column)
    if measured.sum() < FEWEST:
        return np.full(len(grid), np.nan)
    steps, at, x = np.append(0, np.cumsum(jumps))[measured], t[measured], column[measured]  # jumps until each sample
    found = np.interp(grid, at, x)
    for start, end in pairwise([0, *(np.flatnonzero(np.diff(steps)) + 1).tolist(), len(at) - 1]):
        if end - start > 1:  # of two samples alone the line is all that is known
            here = slice(*np.searchsorted(grid, (at[start], at[end] * (1 + 1e-12))))
            found[here] = CubicSpline(at[start : end + 1], x[start : end + 1])(grid[here])
    if measured.all():
        return found
    off = np.abs(at[np.searchsorted(0.5 * (at[1:] + at[:-1]), grid)] - grid)
    return np.where(off > 0.5001 * np.ptp(grid) / max(len(grid) - 1, 1), np.nan, found)


def _one_period(parts: Sequence[_Part], dt: float | None) -> float:
    periods = [_period_of_samples(part) if dt is None else dt for part in parts]
    units = [
        ", ".join(f"{name} [{column.unit}]" for name, column in {**part.states, **part.inputs}.items())
        for part in parts
    ]
    for part, period, own in zip(parts, periods, units, strict=True):
        if abs(period - periods[0]) > EVEN * periods[0] or own != units[0]:
            raise ValueError(
                f"{parts[0].path} has a row every {periods[0]:g} s in {units[0]}, {part.path} every {period:g} s in "
                f"{own}; allowed are the same: fit them one by one, or write them alike"
            )
    return periods[0]


def _period_of_samples(part: _Part) -> float:
    """Return the time between two rows, or between samples of a state where rows of several streams lie unevenly."""
    steps, usual = np.diff(part.t), period_of(part.t)
    most = max(part.x.values(), key=lambda column: int(np.isfinite(column).sum()))
    streams = (np.abs(steps - usual) < 0.2 * usual).mean() < 0.9 and 1 < np.isfinite(most).sum() < 0.9 * len(most)
    return period_of(part.t[np.isfinite(most)]) if streams else usual


def _long_gaps(x: Mapping[str, Array], segment: NDArray[np.int64], findings: list[Finding]) -> NDArray[np.bool_]:
    """Tell which rows lie in a gap that is long for its state, or before or after a recording, `(N,)`."""
    out = np.zeros(len(segment), dtype=bool)
    for name, column in x.items():
        measured = np.isfinite(column)
        rows = np.flatnonzero(measured)
        if len(rows) in (len(column), 0, 1):
            continue
        longest, gaps = LONG * np.median(np.diff(rows)), np.diff(np.concatenate([[-1], rows, [len(column)]]))
        long = np.repeat(gaps > longest, gaps)[:-1] & ~measured
        if long.any():
            findings.append(note("log.long_gap", rows=int(long.sum()), longest=float(longest), state=name))
            out |= long
    any_state = pd.Series(np.isfinite(np.stack([*x.values()])).any(0).astype(int))
    begun, ahead = any_state.groupby(segment).cummax(), any_state[::-1].groupby(segment[::-1]).cummax()[::-1]
    return np.asarray(out | (begun * ahead == 0))


def _conversions(columns: Mapping[str, Column]) -> list[Finding]:
    changed = {
        name: unit
        for name, column in columns.items()
        if (unit := split_unit(column.name)[1]) and (column.unit, column.scale) == in_radians(unit) != (unit, 1)
    }
    if not changed:
        return []
    logged = {name: column for name, column in columns.items() if column.name}
    kept = logged | {name: replace(columns[name], unit=unit, scale=1.0) for name, unit in changed.items()}
    both = {name: (unit, columns[name].unit) for name, unit in changed.items()}
    return [note("log.converted", units=both, kept=as_map(kept))]


def _of_plant(log: Signature, plant: Signature, unmeasured: Sequence[bool]) -> Signature:
    """Return what a log has, with a plant's ends of actuators, and its ranges of states that nothing measures."""
    if log.input_names == plant.input_names and (plant.input_ends or plant.input_limits):
        units = plant.input_units or log.input_units
        log = replace(log, input_ends=plant.input_ends, input_limits=plant.input_limits, input_units=units)
    if log.state_names != plant.state_names:
        return log
    ranges = zip(unmeasured, plant.x_scale, log.x_scale, strict=True)
    return replace(log, x_scale=tuple(theirs if missing else own for missing, theirs, own in ranges))


def _stops(x: dict[str, Array], findings: list[Finding]) -> NDArray[np.bool_]:
    """Tell at which rows a state rests exactly at a stop, at the end of its range, `(N,)`."""
    mask = np.zeros(len(next(iter(x.values()))), dtype=bool)
    for name, column in x.items():
        rows = np.flatnonzero(np.isfinite(column))  # lost samples say nothing of a stop, and do not end it
        value = column[rows]
        if not len(value) or np.ptp(value) == 0:
            continue
        begins = np.flatnonzero(np.diff(value, prepend=np.nan))
        runs = np.stack([begins, np.append(begins[1:], len(value))], -1)
        runs = runs[np.diff(runs)[:, 0] >= 5]
        for end in (value.min(), value.max()):
            same = runs[value[runs[:, 0]] == end].tolist()
            rests = [pair for pair in same if pair[0] == 0 or _is_stop(value, *pair)]
            # The start of a recording at rest is no stop, unless the state rests there again.
            if not any(first for first, _ in rests):
                continue
            own = np.zeros_like(mask)
            for first, last in rests:
                own[rows[first] : rows[last - 1] + 1] = True
            findings.append(note("log.stop", count=int(own.sum()), state=name, value=float(end)))
            mask |= own
    return mask


def _is_stop(value: Array, first: int, last: int) -> bool:
    """Tell a stop that a moving state meets, or leaves at once, from the peak of a swing that is read in steps."""
    # A smooth peak that lasts n samples within a step leaves it slowly: it takes a fifth of n for the next step.
    steps, beside = np.abs(np.diff(value)), max(1, (last - first) // 10)
    step = steps[steps > 1e-9 * np.ptp(value)].min()  # others are of rounding
    neighbours = [k for k in (first - beside, last - 1 + beside) if 0 <= k < len(value)]
    return bool((np.abs(value[neighbours] - value[first]) > 2.5 * step).any())


def _with_units(
    columns: Mapping[str, Column], states: bool, known: Mapping[str, str] | None = None
) -> dict[str, Column]:
    """Return columns with the units of their headings; degrees of states become rad.

    A column keeps what was given of it: a scale, and a unit that is none of the two. Turns per minute are those of an
    angle if the state is known or called to be its rate; of others the samples tell, later.
    """
    inside, found = {name: split_unit(column.name)[1] for name, column in columns.items()}, dict(columns)
    angles = [name for name in columns if "rad" in (columns[name].unit, in_radians(inside[name])[0])]
    for name, column in columns.items():
        turns = column.unit == "rad/s" or any(is_rate_of(a, name) or (known or {}).get(a) == name for a in angles)
        unit, factor = in_radians(inside[name], turns) if states else (inside[name], 1.0)
        if unit and column.scale == 1 and column.unit in ("-", unit):
            found[name] = replace(column, unit=unit, scale=factor)
    return found


def _is_angular_speed(data: Transitions, place: int, columns: Sequence[Column]) -> bool:
    """Tell whether a column in turns per minute moves a measured angle, one way or the other, as its rate does."""
    if columns[place].unit != "rpm":
        return False
    angles = (i for i, column in enumerate(columns) if column.name and column.unit == "rad")
    ties = (compare_rate(data, angle, place) for angle in angles)
    return any(abs(correlation) > ALIKE and abs(abs(factor) / RPM - 1) < 0.05 for factor, correlation in ties)


def _columns_of(group: Mapping[str, Any], states: bool) -> dict[str, Column]:
    """Return columns of what was given of states, of which some may have no heading, or of inputs, which have ends."""
    made = dict[str, Column]()
    for name, given in group.items():
        try:
            keys = {"name": given} if isinstance(given, str) else given
            column = given if isinstance(given, Column) else Column(**keys)
            if states and column.low is not None:
                raise ValueError("a state has no ends")
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{name} is given as {given!r}; allowed is a heading, or the keys name, unit, scale (a number, not 0), "
                f"and of inputs alone low and high (both, low < high), with these rest, a number: {correct_map()}"
            ) from error
        made[name] = column
    for name, column in made.items():
        if not (column.name or (states and any(other.name for other in made.values()))):
            raise ValueError(f"{name} has no column; allowed is the name of one: {correct_map()}")
    return made


def _actuator_ranges(
    path: str, u: Array, inputs: Mapping[str, Column], guess: bool, findings: list[Finding]
) -> list[ActuatorScaling]:
    """Return the range of each input `(N, n_u)`, as it was given or, if asked, as the log shows it; add findings.

    Inputs of one unit that are named alike but for a number, and go about as far, as motors of a drone, share a range.
    """
    kinds = [(re.sub(r"\d", "", name), given.unit) for name, given in inputs.items()]
    widths = np.ptp(u, axis=0)
    found, one_sided, extents = dict[str, ActuatorScaling](), dict[str, ActuatorScaling](), dict[str, Any]()
    for (name, given), kind, width, values in zip(inputs.items(), kinds, widths, u.T, strict=True):
        near = (widths <= SIMILAR * width) & (width <= SIMILAR * widths)
        same = np.array([kind == other for other in kinds]) & near
        alike = values if given.unit == "-" else u[:, same]
        least, most = float(values.min()), float(values.max())
        extent = extents[name] = {"input": name, "least": least, "most": most}
        if least == most:
            raise LogError("log.constant_input", file=path, input=name, value=least)
        if np.isin(values, (least, most)).all():
            findings.append(weak("log.two_levels", input=name, low=least, high=most))
        reach = _guess_range(float(alike.min()), float(alike.max()), given.unit) if guess else PLAIN
        if given.low is not None and given.high is not None:
            reach = ActuatorScaling.of(given.low, given.high, given.rest)
            if reach != PLAIN and max(reach.low - least, most - reach.high) > ROUNDED * (reach.high - reach.low) / 2:
                raise LogError("log.input_ends", file=path, low=reach.low, high=reach.high, **extent)
        found[name], share = reach, (most - least) / (reach.high - reach.low)
        if reach == PLAIN and max(-least, most) > 1 + ROUNDED:
            findings.append(weak("log.beyond_ends", **extent))
        elif share * WIDE <= 1 and (guess or given.low is not None):
            ends = as_map({name: _with_ends(given, ActuatorScaling.of(least, most))})
            facts = {"low": reach.low, "high": reach.high, "percent": 100 * share, "inputs": ends}
            findings.append(weak("log.hardly_moved", **facts, **extent))
        elif reach == PLAIN and guess and given.low is None and least * most >= 0:
            one_sided[name] = ActuatorScaling.of(0.0, 1.0) if most > 0 else ActuatorScaling.of(-1.0, 0.0)
    ranges = as_map({name: _with_ends(inputs[name], reach) for name, reach in (found | one_sided).items()})
    findings += [note("log.one_sided", **extents[name], inputs=ranges) for name in one_sided]
    for name, reach in found.items():
        if reach != PLAIN:
            scale = {"rest": reach.rest, "one": reach.rest + reach.unit, "low": reach.low, "high": reach.high}
            findings.append(note("log.scaled", input=name, unit=inputs[name].unit, **scale))
    if any(reach != PLAIN and inputs[name].low is None for name, reach in found.items()):
        findings.append(note("log.guessed_ends", inputs=ranges))
    return list(found.values())


def _guess_range(low: float, high: float, unit: str) -> ActuatorScaling:
    """Return what an input reaches: [-1, 1] of no unit if it stays within, else its range, with zero unless far off."""
    if max(-low, high) <= 1 + ROUNDED and unit == "-":
        return PLAIN
    if min(-low, high) >= 0.8 * max(-low, high):  # as far to either side
        low, high = -max(-low, high), max(-low, high)
    return ActuatorScaling(low, high, 0.0) if max(low, -high) <= high - low else ActuatorScaling.of(low, high)


def _with_ends(column: Column, reach: ActuatorScaling) -> Column:
    """Return a column with these ends and its rest, but zero; an actuator reaches where it rests, tried or not."""
    low, high = min(reach.low, reach.rest), max(reach.high, reach.rest)
    return replace(column, low=low, high=high, rest=reach.rest or None)


def _with_actuator_ranges(inputs: Mapping[str, Column], plant: Signature) -> dict[str, Column]:
    """Return columns of inputs with the ends of a plant's actuators; those in `[-]` hold what a rig gets, and stay."""
    columns = dict(inputs)
    limits = np.array(plant.input_limits or (WHOLE,) * plant.n_u).T
    ends = plant.in_own_units(np.stack([*limits, np.zeros(plant.n_u)]))  # and what is zero of each
    for place, (name, own) in enumerate(zip(plant.input_names, plant.input_units or "-" * plant.n_u, strict=True)):
        column, reach = columns.get(name), ActuatorScaling(*ends[:, place].tolist())
        if column is None or reach == PLAIN:
            continue
        unit = split_unit(column.name)[1] if column.unit == "-" else column.unit
        if column.low is not None and column.high is not None:
            given = ActuatorScaling.of(column.low, column.high, column.rest)
            both = (given.low, given.high, given.rest), (reach.low, reach.high, reach.rest)
            if not np.allclose(*both, rtol=1e-9, atol=1e-9 * (reach.high - reach.low)):
                raise ValueError(
                    f"input {name} goes from {given.low:g} to {given.high:g} and rests at {given.rest:g} in "
                    f"data.inputs, and from {reach.low:g} to {reach.high:g} and at {reach.rest:g} in "
                    "system.inputs; give them once"
                )
        elif unit != "-":
            if unit and own not in ("-", unit):
                mended = f"{{{name}: {{name: {split_unit(column.name)[0]}, unit: {own}, scale: NUMBER}}}}"
                raise ValueError(
                    f"input {name} is in {unit} in the log, and in {own} in system.inputs; give the factor from one to "
                    f"the other: 'data.inputs={mended}'"
                )
            columns[name] = replace(column, unit=unit or own, low=reach.low, high=reach.high, rest=reach.rest)
    return columns
