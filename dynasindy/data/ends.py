"""Inputs in the units of their actuators, such as volts or per cent, taken into [-1, 1], where planning needs them.

-1 is the lower end of the actuator and 1 the upper one; a log alone tells the range that it used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynasindy.data.table import split_unit

if TYPE_CHECKING:
    from dynasindy.data.csv import Column

Array = NDArray[np.float64]
Ends = tuple[float, float]
PLAIN: Ends = (-1.0, 1.0)
"""Ends of an input that is in [-1, 1] already."""
ROUNDED = 1e-3
"""Part by which an input may leave [-1, 1] and still be meant to be in it, as rounding makes it."""
EVEN = 0.8
"""Ratio of the ways to both sides of zero from which on an input is taken to go as far to either."""


def ends_of(path: str, u: Array, inputs: Mapping[str, Column], into_range: bool, notes: list[str]) -> list[Ends]:
    """Return what becomes -1 and 1 of each input, and note it.

    Args:
        path: The file, for messages.
        u: Inputs in their own units, `(N, n_u)`.
        inputs: Their columns by name, with the ends that the user gave.
        into_range: Whether an input that goes beyond [-1, 1] has the ends of its range where none were given.
        notes: Sentences on what was read; those on inputs are added.

    Raises:
        ValueError: An input is constant, or goes beyond the ends that were given; -1 and 1 keep it as it is.
    """
    found: dict[str, Ends] = {}
    for (name, given), column in zip(inputs.items(), u.T, strict=True):
        if np.ptp(column) == 0:
            raise ValueError(
                f"{path}: input {name} is constant at {column[0]:g}; allowed is an input that moves: excite it, or "
                "leave it out of `inputs`"
            )
        found[name] = _range_of(column) if into_range else PLAIN
        if given.low is not None and given.high is not None:
            found[name] = given.low, given.high
            _require_within(path, name, column, found[name])
        if found[name] == PLAIN and np.abs(column).max() > 1 + ROUNDED:
            notes.append(
                f"input {name} goes from {column.min():g} to {column.max():g}, beyond the [-1, 1] of a plant's inputs; "
                "the model holds for these numbers, or give its ends, low and high, in data.inputs"
            )
    notes += [
        f"{name} is taken into [-1, 1], where planning needs it: -1 is {low:.6g}, 1 is {high:.6g}"
        for name, (low, high) in found.items()
        if (low, high) != PLAIN
    ]
    if any(ends != PLAIN and inputs[name].low is None for name, ends in found.items()):
        notes.append(
            "these are the ends of the log; if an actuator goes further, give its own, and low: -1, high: 1 keeps the "
            f"numbers as they are: {_words(inputs, found)}"
        )
    return list(found.values())


def mapped(u: Array, ends: Sequence[Ends]) -> Array:
    """Return inputs with their ends at -1 and 1, those of [-1, 1] as they are, `(N, n_u)`.

    Args:
        u: Inputs in their own units, `(N, n_u)`.
        ends: Lower and upper end of each.
    """
    columns = [
        column if pair == PLAIN else (2 * column - (pair[0] + pair[1])) / (pair[1] - pair[0])
        for column, pair in zip(u.T, ends, strict=True)
    ]
    return np.stack(columns, -1)


def _range_of(values: Array) -> Ends:
    """Return the ends of an input that a log shows: those of [-1, 1] if it stays within, else those of its range."""
    low, high = float(values.min()), float(values.max())
    if max(-low, high) <= 1 + ROUNDED:
        return PLAIN
    if min(-low, high) >= EVEN * max(-low, high):  # zero stays zero
        return -max(-low, high), max(-low, high)
    return low, high


def _require_within(path: str, name: str, values: Array, ends: Ends) -> None:
    """Refuse ends that an input goes beyond, as they are then those of another unit."""
    (low, high), least, most = ends, float(values.min()), float(values.max())
    beyond = max(low - least, most - high)
    if ends != PLAIN and beyond > ROUNDED * (high - low) / 2:
        raise ValueError(
            f"{path}: input {name} was given low {low:g} and high {high:g}, its column goes from {least:.6g} to "
            f"{most:.6g} after scaling; allowed are ends that hold all of it: give low, high and scale of one unit"
        )


def _words(inputs: Mapping[str, Column], found: Mapping[str, Ends]) -> str:
    """Return the words of the command line that say these ends."""
    columns = []
    for name, (low, high) in found.items():
        column = inputs[name]
        heading, unit = split_unit(column.name)
        own = f'unit: "{column.unit}", ' if column.unit not in ("-", unit) else ""
        own += f"scale: {column.scale!r}, " if column.scale != 1 else ""
        columns.append(f"{name}: {{name: {heading}, {own}low: {low:.6g}, high: {high:.6g}}}")
    return f"'data.inputs={{{', '.join(columns)}}}'"
