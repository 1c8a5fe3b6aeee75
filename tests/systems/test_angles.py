"""A turn in each unit of angles."""

import math

import pytest

from dynasindy.systems.base import turn_of


@pytest.mark.parametrize(("unit", "turn"), [("rad", 6.2831853), ("deg", 360), ("mrad", 6283.1853), ("turns", 1)])
def test_a_turn_in_units_of_angles(unit: str, turn: float) -> None:
    assert turn_of(unit) == pytest.approx(turn)


@pytest.mark.parametrize("unit", ["m", "rad/s", "deg/s", "-", "K"])
def test_what_is_no_angle_never_comes_round(unit: str) -> None:
    assert turn_of(unit) == math.inf
