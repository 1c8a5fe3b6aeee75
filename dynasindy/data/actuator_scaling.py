"""Inputs of a log in the units of their actuators, taken into [-1, 1], where planning needs them.

Zero stays zero, as `dynasindy.systems.actuator_scaling` says. A log alone tells the range that it used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.columns import Column, columns_of
from dynasindy.data.headings import split_unit, units_of
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
    path: str, u: Array, inputs: Mapping[str, Column], into_range: bool, notes: list[str]
) -> tuple[list[ActuatorScaling], str]:
    """Return what each input reaches and what becomes 0 and 1 of it, and note it.

    Beside it stand the words that give these ends, empty where nobody has to say whether they are right.

    Args:
        path: The file, for messages.
        u: Inputs in their own units, `(N, n_u)`.
        inputs: Their columns by name, with the ends that the user gave.
        into_range: Whether an input that goes beyond [-1, 1] has the ends of its range where none were given.
        notes: Sentences on what was read; those on inputs are added.

    Raises:
        ValueError: An input is constant, or goes beyond the ends that were given; -1 and 1 keep it as it is.
    """
    found: dict[str, ActuatorScaling] = {}
    sided: dict[str, ActuatorScaling] = {}
    for (name, given), column in zip(inputs.items(), u.T, strict=True):
        if np.ptp(column) == 0:
            raise ValueError(
                f"{path}: input {name} is constant at {column[0]:g}; allowed is an input that moves: excite it, or "
                "leave it out of `inputs`"
            )
        notes += _two_levels(name, column)
        found[name] = _range_of(column) if into_range else PLAIN
        if given.low is not None and given.high is not None:
            found[name] = ActuatorScaling.of(given.low, given.high, given.rest)
            _require_within(path, name, column, found[name])
            notes += _too_wide(name, column, found[name])
        if found[name] == PLAIN and np.abs(column).max() > 1 + ROUNDED:
            notes.append(
                f"input {name} goes from {column.min():g} to {column.max():g}, beyond the [-1, 1] of a plant's inputs; "
                "the model holds for these numbers, or give its ends, low and high, in data.inputs"
            )
        elif found[name] == PLAIN and into_range and given.low is None and column.min() * column.max() >= 0:
            sided[name] = ActuatorScaling.of(0.0, 1.0) if column.max() > 0 else ActuatorScaling.of(-1.0, 0.0)
    words = _words(inputs, found | sided)
    notes += [
        f"input {name} goes from {column.min():g} to {column.max():g}; its actuator is taken to reach from -1 to 1. If "
        f"it does not, as a valve from 0 to 1, say so: {words}"
        for name, column in zip(inputs, u.T, strict=True)
        if name in sided
    ]
    notes += [_told(name, inputs[name], reach) for name, reach in found.items() if reach != PLAIN]
    if of_log := any(reach != PLAIN and inputs[name].low is None for name, reach in found.items()):
        notes.append(
            "these are the ends of the log; if an actuator goes further, give its own, and low: -1, high: 1 keeps the "
            f"numbers as they are: {words}"
        )
    return list(found.values()), words if sided or of_log else ""


def with_actuator_ranges(
    inputs: Mapping[str, Column | Mapping[str, object] | str], headings: Sequence[str], plant: Signature
) -> dict[str, Column]:
    """Return columns of inputs with the ends that a plant says of its actuators.

    A column whose heading has the unit `[-]` holds the numbers that a rig gets, as its logs do, and keeps them.

    Args:
        inputs: Columns by name, as they were given.
        headings: Headings of the file.
        plant: Names, ends and units of the inputs.

    Raises:
        ValueError: Other ends, or another unit, were given of an input.
    """
    columns = columns_of(inputs, may_be_rates=False)
    inside = units_of(headings)
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


def acting_as(log: Signature, plant: Signature) -> Signature:
    """Return what a log has, with the ends and limits of a plant's actuators where the plant says any."""
    if log.input_names != plant.input_names or not (plant.input_ends or plant.input_limits):
        return log
    units = plant.input_units or log.input_units
    return replace(log, input_ends=plant.input_ends, input_limits=plant.input_limits, input_units=units)


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


def _require_within(path: str, name: str, values: Array, reach: ActuatorScaling) -> None:
    """Refuse ends that an input goes beyond, as they are then those of another unit."""
    low, high, least, most = reach.low, reach.high, float(values.min()), float(values.max())
    beyond = max(low - least, most - high)
    if reach != PLAIN and beyond > ROUNDED * (high - low) / 2:
        raise ValueError(
            f"{path}: input {name} was given low {low:g} and high {high:g}, its column goes from {least:.6g} to "
            f"{most:.6g} after scaling; allowed are ends that hold all of it: give low, high and scale of one unit"
        )


def _too_wide(name: str, values: Array, reach: ActuatorScaling) -> list[str]:
    """Ask whether ends are right of which a log uses hardly anything."""
    least, most = float(values.min()), float(values.max())
    if reach.high - reach.low < WIDE * (most - least):
        return []
    return [
        f"input {name} was given low {reach.low:g} and high {reach.high:g}, and its column goes from {least:.6g} to "
        f"{most:.6g} only, {100 * (most - least) / (reach.high - reach.low):.1g} % of that; check that both are in one "
        "unit. What a model says so far beyond a log is a guess: log more of the range, or give narrower ends"
    ]


def _two_levels(name: str, values: Array) -> list[str]:
    """Say that an input of two levels, as a relay or a random binary signal has, tells nothing of those between."""
    low, high = float(values.min()), float(values.max())
    if ((values != low) & (values != high)).any():
        return []
    return [
        f"the log shows only two levels of input {name}, {low:g} and {high:g}, so nothing is known of the values "
        "between them, which a controller uses. Log some of these, too; where the actuator can only switch, pulse it "
        "and log the share of the time that it is on"
    ]


def _told(name: str, column: Column, reach: ActuatorScaling) -> str:
    """Say what 0 and 1 are of an input, and between which ends it is set."""
    unit = "" if column.unit == "-" else f" {column.unit}"
    return (
        f"{name} is taken into [-1, 1], where planning needs it: 0 is {reach.rest:.6g}{unit}, 1 is "
        f"{reach.rest + reach.unit:.6g}{unit}; a controller keeps it from {reach.low:.6g} to {reach.high:.6g}{unit}"
    )


def _words(inputs: Mapping[str, Column], found: Mapping[str, ActuatorScaling]) -> str:
    """Return the words of the command line that say these ends."""
    columns = []
    for name, reach in found.items():
        column = inputs[name]
        heading, unit = split_unit(column.name)
        own = f'unit: "{column.unit}", ' if column.unit not in ("-", unit) else ""
        own += f"scale: {column.scale!r}, " if column.scale != 1 else ""
        # A log that has not tried zero keeps it all the same; an actuator that rests there reaches it.
        low, high = min(reach.low, reach.rest), max(reach.high, reach.rest)
        rest = f", rest: {reach.rest:.6g}" if reach.rest != ActuatorScaling.of(low, high).rest else ""
        columns.append(f"{name}: {{name: {heading}, {own}low: {low:.6g}, high: {high:.6g}{rest}}}")
    return f"'data.inputs={{{', '.join(columns)}}}'"
