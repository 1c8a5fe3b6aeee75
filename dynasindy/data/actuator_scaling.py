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

from dynasindy.data.columns import Column, as_map
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


def actuator_ranges(
    path: str, u: Array, inputs: Mapping[str, Column], guess: bool, findings: list[Finding]
) -> tuple[list[ActuatorScaling], dict[str, Any] | None]:
    """Return the range of each input and what becomes 0 and 1 of it: as it was given, or else -1 and 1.

    Beside it stands the column map that gives these ends, None where nobody has to say whether they are right.

    Args:
        path: The file, for messages.
        u: Inputs in their own units, `(N, n_u)`.
        inputs: Their columns by name, with the ends that the user gave.
        guess: Whether an input that goes beyond [-1, 1] has the ends of its range where none were given.
        findings: What was decided; that of inputs is added.

    Raises:
        LogError: An input is constant, or goes beyond the ends that were given; -1 and 1 keep it as it is.
    """
    found, one_sided, extents = dict[str, ActuatorScaling](), dict[str, ActuatorScaling](), dict[str, Any]()
    for (name, given), values in zip(inputs.items(), u.T, strict=True):
        least, most = float(values.min()), float(values.max())
        extent = extents[name] = {"input": name, "least": least, "most": most}
        if least == most:
            raise LogError("log.constant_input", file=path, input=name, value=least)
        if np.isin(values, (least, most)).all():
            findings.append(weak("log.two_levels", input=name, low=least, high=most))
        reach = _guess_range(least, most) if guess else PLAIN
        if given.low is not None and given.high is not None:
            reach = ActuatorScaling.of(given.low, given.high, given.rest)
            width, ends = reach.high - reach.low, {"low": reach.low, "high": reach.high}
            if reach != PLAIN and max(reach.low - least, most - reach.high) > ROUNDED * width / 2:
                raise LogError("log.input_ends", file=path, **ends, **extent)
            if (most - least) / width * WIDE <= 1:
                findings.append(weak("log.hardly_moved", **ends, percent=100 * (most - least) / width, **extent))
        found[name] = reach
        if reach == PLAIN and max(-least, most) > 1 + ROUNDED:
            findings.append(weak("log.beyond_ends", **extent))
        elif reach != PLAIN or not guess or given.low is not None:
            continue
        elif (most - least) * WIDE < 2:
            ends = as_map({name: _with_ends(given, ActuatorScaling.of(least, most))})
            findings.append(weak("log.small_input", inputs=ends, **extent))
        elif least * most >= 0:
            one_sided[name] = ActuatorScaling.of(0.0, 1.0) if most > 0 else ActuatorScaling.of(-1.0, 0.0)
    ranges = as_map({name: _with_ends(inputs[name], reach) for name, reach in (found | one_sided).items()})
    findings += [note("log.one_sided", **extents[name], inputs=ranges) for name in one_sided]
    for name, reach in found.items():
        if reach != PLAIN:
            scale = {"rest": reach.rest, "one": reach.rest + reach.unit, "low": reach.low, "high": reach.high}
            findings.append(note("log.scaled", input=name, unit=inputs[name].unit, **scale))
    if guessed := any(reach != PLAIN and inputs[name].low is None for name, reach in found.items()):
        findings.append(note("log.guessed_ends", inputs=ranges))
    return list(found.values()), ranges if one_sided or guessed else None


def _guess_range(low: float, high: float) -> ActuatorScaling:
    """Return what an input reaches as far as a log shows: [-1, 1] if it stays within, else its range.

    Zero stays zero even where the log has it not, unless it is farther off than the log is wide.
    """
    if max(-low, high) <= 1 + ROUNDED:
        return PLAIN
    if min(-low, high) >= EVEN * max(-low, high):
        low, high = -max(-low, high), max(-low, high)
    return ActuatorScaling(low, high, 0.0) if max(low, -high) <= high - low else ActuatorScaling.of(low, high)


def _with_ends(column: Column, reach: ActuatorScaling) -> Column:
    """Return a column with these ends; an actuator reaches where it rests, whether the log has tried it or not."""
    low, high = min(reach.low, reach.rest), max(reach.high, reach.rest)
    rest = None if reach.rest == ActuatorScaling.of(low, high).rest else reach.rest
    return replace(column, low=low, high=high, rest=rest)


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
    for place, (name, own) in enumerate(zip(plant.input_names, plant.input_units or "-" * plant.n_u, strict=True)):
        column, reach = columns.get(name), _reach_of(plant, place)
        if column is None or reach == PLAIN:
            continue
        unit = inside.get(column.name, "") if column.unit == "-" else column.unit
        if column.low is not None and column.high is not None:
            given = ActuatorScaling.of(column.low, column.high, column.rest)
            pairs = (given.low, reach.low), (given.high, reach.high), (given.rest, reach.rest)
            if not all(math.isclose(*pair, abs_tol=1e-9 * (reach.high - reach.low)) for pair in pairs):
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


def _reach_of(plant: Signature, place: int) -> ActuatorScaling:
    """Return what an input of a plant reaches, in its own unit, and what is zero of it."""
    limits = np.array(plant.input_limits or (WHOLE,) * plant.n_u)
    low, high = (float(plant.in_own_units(ends)[place]) for ends in limits.T)
    return ActuatorScaling(low, high, float(plant.in_own_units(np.zeros(plant.n_u))[place]))
