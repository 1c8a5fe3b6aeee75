"""Inputs of a log in the units of their actuators, taken into [-1, 1], where planning needs them.

Zero stays zero, as `dynasindy.systems.actuator_scaling` says. A log alone tells the range that it used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.columns import Column
from dynasindy.data.headings import split_unit, units_of
from dynasindy.findings import Finding, LogError, note, weak
from dynasindy.systems.actuator_scaling import PLAIN, ActuatorScaling
from dynasindy.systems.base import WHOLE, Signature

Array = NDArray[np.float64]
ROUNDED = 1e-3
"""Part by which an input may leave its ends and still be meant to be within them, as rounding makes it."""
EVEN = 0.8
"""Ratio of the ways to both sides of zero from which on an input is taken to go as far to either."""
WIDE = 20.0
"""Range of an actuator, as a multiple of that in its log, from which on a note asks whether it is the right one."""


def reaches(
    path: str, u: Array, inputs: Mapping[str, Column], into_range: bool, findings: list[Finding]
) -> tuple[list[ActuatorScaling], dict[str, dict[str, Any]] | None]:
    """Return what each input reaches and what becomes 0 and 1 of it, and the findings on it.

    Beside it stands the column map that gives these ends, None where nobody has to say whether they are right.

    Args:
        path: The file, for messages.
        u: Inputs in their own units, `(N, n_u)`.
        inputs: Their columns by name, with the ends that the user gave.
        into_range: Whether an input that goes beyond [-1, 1] has the ends of its range where none were given.
        findings: What was decided; that of inputs is added.

    Raises:
        ValueError: An input is constant, or goes beyond the ends that were given; -1 and 1 keep it as it is.
    """
    found: dict[str, ActuatorScaling] = {}
    sided: dict[str, ActuatorScaling] = {}
    for (name, given), column in zip(inputs.items(), u.T, strict=True):
        if np.ptp(column) == 0:
            raise LogError("log.constant_input", file=path, input=name, value=float(column[0]))
        ends = {"input": name, "least": float(column.min()), "most": float(column.max())}
        if not ((column != ends["least"]) & (column != ends["most"])).any():
            findings.append(weak("log.two_levels", input=name, low=ends["least"], high=ends["most"]))
        found[name] = _range_of(column) if into_range else PLAIN
        if given.low is not None and given.high is not None:
            found[name] = ActuatorScaling.of(given.low, given.high, given.rest)
            _require_within(path, name, column, found[name])
            findings += _too_wide(column, found[name], ends)
        if found[name] == PLAIN and np.abs(column).max() > 1 + ROUNDED:
            findings.append(weak("log.beyond_ends", **ends))
        elif found[name] == PLAIN and into_range and given.low is None and np.ptp(column) * WIDE < 2:
            findings.append(weak("log.small_input", inputs=_words({name: given}, {name: _tried(column)}), **ends))
        elif found[name] == PLAIN and into_range and given.low is None and column.min() * column.max() >= 0:
            sided[name] = ActuatorScaling.of(0.0, 1.0) if column.max() > 0 else ActuatorScaling.of(-1.0, 0.0)
    words = _words(inputs, found | sided)
    findings += [
        note("log.one_sided", input=name, least=float(column.min()), most=float(column.max()), inputs=words)
        for name, column in zip(inputs, u.T, strict=True)
        if name in sided
    ]
    for name, reach in found.items():
        if reach != PLAIN:
            scale = {"rest": reach.rest, "one": reach.rest + reach.unit, "low": reach.low, "high": reach.high}
            findings.append(note("log.scaled", input=name, unit=inputs[name].unit, **scale))
    if of_log := any(reach != PLAIN and inputs[name].low is None for name, reach in found.items()):
        findings.append(note("log.guessed_ends", inputs=words))
    return list(found.values()), words if sided or of_log else None


def with_actuator_ranges(inputs: Mapping[str, Column], headings: Sequence[str], plant: Signature) -> dict[str, Column]:
    """Return columns of inputs with the ends that a plant says of its actuators.

    A column whose heading has the unit `[-]` holds the numbers that a rig gets, as its logs do, and keeps them.

    Args:
        inputs: Columns by name.
        headings: Headings of the file.
        plant: Names, ends and units of the inputs.

    Raises:
        ValueError: Other ends, or another unit, were given of an input.
    """
    columns, inside = dict(inputs), units_of(headings)
    for place, (name, own) in enumerate(zip(plant.input_names, _units(plant), strict=True)):
        column, reach = columns.get(name), _reach_of(plant, place)
        if column is None or reach == PLAIN:
            continue
        unit = inside.get(column.name, "") if column.unit == "-" else column.unit
        if column.low is not None and column.high is not None:
            _require_same(name, ActuatorScaling.of(column.low, column.high, column.rest), reach)
        elif unit != "-":
            if unit and own not in ("-", unit):
                given = f"{{{name}: {{name: {split_unit(column.name)[0]}, unit: {own}, scale: NUMBER}}}}"
                raise ValueError(
                    f"input {name} is in {unit} in the log, and in {own} in system.inputs; give the factor from one to "
                    f"the other: 'data.inputs={given}'"
                )
            columns[name] = replace(column, unit=unit or own, low=reach.low, high=reach.high, rest=reach.rest)
    return columns


def _require_same(name: str, given: ActuatorScaling, plant: ActuatorScaling) -> None:
    """Refuse ends of a column that are not those of the plant."""
    rounding = 1e-9 * (plant.high - plant.low)
    pairs = (given.low, plant.low), (given.high, plant.high), (given.rest, plant.rest)
    if not all(math.isclose(*pair, abs_tol=rounding) for pair in pairs):
        raise ValueError(
            f"input {name} goes from {given.low:g} to {given.high:g} and rests at {given.rest:g} in data.inputs, and "
            f"from {plant.low:g} to {plant.high:g} and at {plant.rest:g} in system.inputs; give the ends once"
        )


def _units(plant: Signature) -> tuple[str, ...]:
    """Return the unit of each input, `-` where none is known."""
    return plant.input_units or ("-",) * plant.n_u


def _reach_of(plant: Signature, place: int) -> ActuatorScaling:
    """Return what an input of a plant reaches, in its own unit, and what is zero of it."""
    limits = np.array(plant.input_limits or (WHOLE,) * plant.n_u)
    low, high = (float(plant.in_own_units(ends)[place]) for ends in limits.T)
    return ActuatorScaling(low, high, float(plant.in_own_units(np.zeros(plant.n_u))[place]))


def scaled(u: Array, found: Sequence[ActuatorScaling]) -> Array:
    """Return inputs with their rest at 0 and one unit at 1, those of [-1, 1] as they are, `(N, n_u)`.

    Args:
        u: Inputs in their own units, `(N, n_u)`.
        found: What each reaches.
    """
    columns = [
        column if reach.rest == 0 and reach.unit == 1 else (column - reach.rest) / reach.unit
        for column, reach in zip(u.T, found, strict=True)
    ]
    return np.stack(columns, -1)


def _range_of(values: Array) -> ActuatorScaling:
    """Return what an input reaches as far as a log shows: [-1, 1] if it stays within, else its range.

    Zero stays zero even where the log has it not, unless it is farther off than the log is wide.
    """
    low, high = float(values.min()), float(values.max())
    if max(-low, high) <= 1 + ROUNDED:
        return PLAIN
    if min(-low, high) >= EVEN * max(-low, high):
        low, high = -max(-low, high), max(-low, high)
    return ActuatorScaling(low, high, 0.0) if max(low, -high) <= high - low else ActuatorScaling.of(low, high)


def _tried(values: Array) -> ActuatorScaling:
    """Return the range that an input has in a log, whatever it is."""
    return ActuatorScaling.of(float(values.min()), float(values.max()))


def _require_within(path: str, name: str, values: Array, reach: ActuatorScaling) -> None:
    """Refuse ends that an input goes beyond, as they are then those of another unit."""
    low, high, least, most = reach.low, reach.high, float(values.min()), float(values.max())
    beyond = max(low - least, most - high)
    if reach != PLAIN and beyond > ROUNDED * (high - low) / 2:
        raise LogError("log.input_ends", file=path, input=name, low=low, high=high, least=least, most=most)


def _too_wide(values: Array, reach: ActuatorScaling, ends: Mapping[str, Any]) -> list[Finding]:
    """Ask whether ends are right of which a log uses hardly anything."""
    share = float(np.ptp(values)) / (reach.high - reach.low)
    if share * WIDE > 1:
        return []
    return [weak("log.hardly_moved", low=reach.low, high=reach.high, percent=100 * share, **ends)]


def _words(inputs: Mapping[str, Column], found: Mapping[str, ActuatorScaling]) -> dict[str, dict[str, Any]]:
    """Return the column map of the inputs that says these ends."""
    columns = {}
    for name, reach in found.items():
        column = inputs[name]
        heading, unit = split_unit(column.name)
        own: dict[str, Any] = {"name": heading}
        columns[name] = own
        own |= {"unit": column.unit} if column.unit not in ("-", unit) else {}
        own |= {"scale": column.scale} if column.scale != 1 else {}
        # A log that has not tried zero keeps it all the same; an actuator that rests there reaches it.
        low, high = min(reach.low, reach.rest), max(reach.high, reach.rest)
        own |= {"low": float(f"{low:.6g}"), "high": float(f"{high:.6g}")}
        own |= {"rest": float(f"{reach.rest:.6g}")} if reach.rest != ActuatorScaling.of(low, high).rest else {}
    return columns
