"""What of an actuator becomes 0 and 1, against the straight line through its rest and its farther end."""

import pytest

from dynasindy.systems import BlackBox
from dynasindy.systems.actuator_scaling import PLAIN, ActuatorScaling, actuator_units


@pytest.mark.parametrize(
    ("low", "high", "given", "rest", "one", "limits"),
    [
        (0, 12, None, 0, 12, (0, 1)),
        (-2, 10, None, 0, 10, (-0.2, 1)),
        (4, 20, None, 4, 16, (0, 1)),
        (-100, -4, None, -4, 96, (-1, 0)),
        (1000, 2000, 1500, 1500, 500, (-1, 1)),
        (1000, 2000, 1000, 1000, 1000, (0, 1)),
        (0, 12, 12, 12, 12, (-1, 0)),
    ],
)
def test_zero_stays_zero_or_becomes_what_is_said_on_a_rig_as_in_a_log(low, high, given, rest, one, limits):
    reach = ActuatorScaling.of(low, high, given)
    assert (reach.rest, reach.unit, reach.both) == (rest, one, (rest - one, rest + one))
    assert reach.limits == pytest.approx(limits)
    signature = BlackBox({"h": "m"}, {"pump": {"low": low, "high": high, "rest": given, "unit": "V"}}).signature
    assert signature.in_own_units([0.0])[0] == rest and signature.in_own_units([1.0])[0] == rest + one
    assert signature.in_own_units([limits[0]]) == pytest.approx([low])
    assert signature.input_units == ("V",)


def test_what_is_as_in_every_plant_is_left_out():
    assert actuator_units([PLAIN, PLAIN], ["-", "-"]) == {}
    assert actuator_units([ActuatorScaling.of(0, 1)], ["<b>"]) == {"input_limits": ((0.0, 1.0),)}
