"""Units that headings name: degrees become radians, which sines and cosines need, and all others stay as they are."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from dynasindy.data.headings import split_unit, units_of
from dynasindy.data.rates import is_rate_of
from dynasindy.findings import Finding, note
from dynasindy.systems.base import TURNS

if TYPE_CHECKING:
    from dynasindy.data.columns import Column

PER_MINUTE = ("rpm", "RPM", "rev/min")
"""Units of speeds that count turns in a minute; of what is no rate of an angle they stay, as of a fan."""


def in_radians(unit: str, turns: bool = True) -> tuple[str, float]:
    """Return the unit that a unit becomes, and the factor to it: rad or rad/s of angles and their rates.

    Args:
        unit: A unit, such as `deg/s`.
        turns: Whether turns per minute are those of an angle.
    """
    whole, per, time = unit.partition("/")
    if whole in TURNS and per + time in ("", "/s", "/s^2", "/s²"):
        return f"rad{per}{time}", TURNS[whole]
    if turns and unit in PER_MINUTE:
        return "rad/s", 2 * math.pi / 60
    return unit, 1.0


def with_units(
    columns: Mapping[str, Column],
    headings: Iterable[str],
    states: bool,
    known: Mapping[str, str] | None = None,
    rotors: bool = True,
) -> dict[str, Column]:
    """Return columns with the units of their headings; degrees of states become rad.

    A column keeps what was given of it: a scale, and a unit that is none of the two.

    Args:
        columns: Columns by name.
        headings: Headings of the file.
        states: Whether they are states; inputs stay in the units of their actuators.
        known: The rate of each state, as far as it is known.
        rotors: Whether turns per minute of which nobody says that they are the rate of an angle are those of a rotor;
            otherwise such a column has no unit yet, for the log has still to tell.
    """
    units, found = units_of(headings), dict(columns)
    inside = {name: units.get(column.name, "") for name, column in columns.items()}
    angles = [name for name in columns if "rad" in (columns[name].unit, in_radians(inside[name])[0])]
    for name, column in columns.items():
        turns = column.unit == "rad/s" or any(
            is_rate_of(angle, name) or (known or {}).get(angle) == name for angle in angles
        )
        if states and inside[name] in PER_MINUTE and not turns and not rotors:
            continue
        unit, factor = in_radians(inside[name], turns) if states else (inside[name], 1.0)
        if unit and column.scale == 1 and column.unit in ("-", unit):
            found[name] = replace(column, unit=unit, scale=factor)
        elif not column.name and in_radians(inside.get(column.derivative_of, ""), False)[1] != 1:
            found[name] = replace(column, unit=in_radians(column.unit)[0])  # the slope of what is in rad
    return found


def undecided(columns: Mapping[str, Column], headings: Iterable[str]) -> list[str]:
    """Return the columns in turns per minute that may be of an angle or of a rotor, as `with_units` left them.

    Args:
        columns: States by name.
        headings: Headings of the file.
    """
    units = units_of(headings)
    return [
        name
        for name, column in columns.items()
        if units.get(column.name) in PER_MINUTE and (column.unit, column.scale) == ("-", 1)
    ]


def as_map(columns: Mapping[str, Column], explicit: Collection[str]) -> dict[str, Any]:
    """Return the column map that says these states.

    Args:
        columns: States by name.
        explicit: Those whose unit and scale are written, as their headings do not tell them.
    """
    found: dict[str, Any] = {}
    for name, column in columns.items():
        keys: dict[str, Any] = {"name": split_unit(column.name)[0]} if column.name else {}
        keys |= {"derivative_of": column.derivative_of} if column.derivative_of else {}
        keys |= {"unit": column.unit} if name in explicit or not column.name else {}
        if column.scale != 1 and (name in explicit or not column.name):
            keys["scale"] = float(f"{column.scale:.7g}")
        found[name] = keys if len(keys) > 1 else split_unit(column.name)[0]
    return found


def conversions(columns: Mapping[str, Column], headings: Iterable[str]) -> list[Finding]:
    """Return which columns were converted, and the column map that keeps their units; nothing where none was.

    Args:
        columns: Columns by name, as `with_units` returns them.
        headings: Headings of the file.
    """
    units = units_of(headings)
    inside = {name: units.get(column.name, "") for name, column in columns.items()}
    changed = {name: unit for name, unit in inside.items() if _changed(unit, columns[name].unit, columns[name].scale)}
    if not changed:
        return []
    kept = {
        name: replace(column, unit=changed.get(name, column.unit), scale=1.0 if name in changed else column.scale)
        for name, column in columns.items()
        if column.name
    }
    both = {name: (unit, columns[name].unit) for name, unit in changed.items()}
    return [note("log.converted", units=both, kept=as_map(kept, changed))]


def _changed(before: str, unit: str, scale: float) -> bool:
    return before != unit and (unit, scale) == in_radians(before)
