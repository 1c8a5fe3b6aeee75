"""Inputs in the units of their actuators, such as volts or per cent, and what of them becomes 0 and 1.

Zero stays zero: a heater of 0 to 100 % becomes one of 0 to 1, so that what begins at zero, rests at zero or answers
zero is a heater that is off. What the actuator does not reach, the part from -1 to 0 here, are limits of the input.

| name         | what it is                                       | of 0 to 12 V | of -2 to 10 V | of 4 to 20 mA |
| ------------ | ------------------------------------------------ | ------------ | ------------- | ------------- |
| `rest`       | what 0 is, the value of the range nearest to 0   | 0 V          | 0 V           | 4 mA          |
| `unit`       | by how much 1 is more                            | 12 V         | 10 V          | 16 mA         |
| `limits`     | least and largest input of the model             | 0, 1         | -0.2, 1       | 0, 1          |
| `both`       | what -1 and 1 are, in reach or not               | -12, 12 V    | -10, 10 V     | -12, 20 mA    |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dynasindy.systems.base import UNIT, WHOLE


@dataclass(frozen=True)
class ActuatorScaling:
    """Say what an actuator reaches, in its own unit, and what of it becomes 0 and 1.

    Attributes:
        low: least value.
        high: largest value.
        rest: value that becomes 0.
    """

    low: float
    high: float
    rest: float

    @classmethod
    def of(cls, low: float, high: float, rest: float | None = None) -> ActuatorScaling:
        """Return what lies between two ends; it rests at zero, or at the end next to zero.

        Args:
            low: least value.
            high: largest value.
            rest: where it rests instead.

        Raises:
            ValueError: it is said to rest where the actuator does not reach.
        """
        if rest is not None and not low <= rest <= high:
            raise ValueError(
                f"an actuator from low {low:g} to high {high:g} was given rest {rest:g}, which it does not reach; give "
                "a rest within both ends, in their unit, or leave it out"
            )
        return cls(low, high, min(max(0.0, low), high) if rest is None else rest)

    @property
    def unit(self) -> float:
        """How much one is, in the own unit of the input."""
        return max(self.high - self.rest, self.rest - self.low)

    @property
    def both(self) -> tuple[float, float]:
        """What -1 and 1 are, whether the actuator reaches them or not."""
        return self.rest - self.unit, self.rest + self.unit

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest input in [-1, 1]."""
        return (self.low - self.rest) / self.unit, (self.high - self.rest) / self.unit


PLAIN = ActuatorScaling(-1.0, 1.0, 0.0)
"""An input that is in [-1, 1] already."""


def actuator_units(found: Sequence[ActuatorScaling], units: Sequence[str]) -> dict[str, tuple[Any, ...]]:
    """Return what a signature holds of inputs with units of their own; nothing of what is as in every plant.

    Args:
        found: What each input reaches.
        units: Their units; what is no unit is left out.
    """
    held: dict[str, tuple[Any, ...]] = {
        "input_ends": tuple(reach.both for reach in found),
        "input_limits": tuple(reach.limits for reach in found),
        "input_units": tuple(unit if UNIT.fullmatch(unit) else "-" for unit in units),
    }
    usual = (WHOLE, WHOLE, "-")
    return {key: values for (key, values), plain in zip(held.items(), usual, strict=True) if set(values) != {plain}}
