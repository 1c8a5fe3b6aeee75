"""A plant whose equations nobody knows: what it measures and what moves it, in names and units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from dynasindy.systems.actuator_scaling import ActuatorScaling, actuator_units
from dynasindy.systems.base import UNIT, Signature, System

Actuator = Sequence[float] | Mapping[str, Any]
"""The two ends of an actuator, or `low` and `high` with, if wanted, `rest` and `unit`."""


class BlackBox(System):
    """Names and units of a rig; equations are found from its logs, and so are the ranges of its states.

    Args:
        states: What the rig measures, in the order in which it sends it: the unit of each state.
        inputs: What moves it, in the order in which it takes it: names, or each name with the two ends of its actuator
            in the actuator's own unit, such as `{"pump": [0, 12]}` of a pump in V. As in a log, zero stays zero, or
            the end next to it is taken for zero; `{"servo": {"low": 1000, "high": 2000, "rest": 1500, "unit": "us"}}`
            says another value that is, and the unit.

    Raises:
        ValueError: There is no state or no input, or a name, a unit or an end is none.
    """

    known = False

    def __init__(self, states: Mapping[str, str], inputs: Sequence[str] | Mapping[str, Actuator]) -> None:
        if not states or not inputs:
            raise ValueError(
                f"a rig has states {dict(states or {})} and inputs {inputs}; give one or more of each, such as "
                "system.states={angle: rad} and system.inputs=[motor]"
            )
        given = inputs if isinstance(inputs, Mapping) else dict.fromkeys(inputs, (-1.0, 1.0))
        made = [_actuator(name, said) for name, said in given.items()]
        ends = actuator_units([reach for reach, _ in made], [unit for _, unit in made])
        super().__init__(Signature(tuple(states), tuple(states.values()), tuple(inputs), (1.0,) * len(states), **ends))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Refuse to say how the plant moves.

        Raises:
            RuntimeError: Always, as nobody knows.
        """
        raise RuntimeError(
            "nobody knows its equations, so it cannot be simulated; fly the rig with rig.py, or plan from a log of it "
            "with data=csv"
        )


def _actuator(name: str, given: Actuator) -> tuple[ActuatorScaling, str]:
    """Return what an actuator reaches, and its unit."""
    keys = ("low", "high", "rest", "unit")
    pairs = given.items() if isinstance(given, Mapping) else zip(keys, given, strict=False)
    said = dict(pairs) if isinstance(given, Mapping) or len(given) == 2 else {}
    unit, rest = said.get("unit", "-"), said.get("rest")
    ends = [said.get("low"), said.get("high"), 0.0 if rest is None else rest]
    numbers = [float(end) for end in ends if isinstance(end, int | float) and math.isfinite(end)]
    if len(numbers) < 3 or not numbers[0] < numbers[1] or not set(said) <= set(keys) or not UNIT.fullmatch(str(unit)):
        raise ValueError(
            f"system.inputs has {name}: {given}; give the two ends of its actuator, a lower and a higher number, such "
            "as {pump: [0, 12]}, or with more words {pump: {low: 0, high: 12, rest: 0, unit: V}}"
        )
    return ActuatorScaling.of(numbers[0], numbers[1], None if rest is None else numbers[2]), str(unit)
