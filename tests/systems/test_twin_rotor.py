import pytest

from dynasindy.systems.twin_rotor import beam_stops


def test_default_stops_are_those_of_the_vendors_simulation():
    stops = beam_stops()
    assert stops.high == pytest.approx((6.0, 1.5708), abs=1e-4)
    assert stops.low == tuple(-h for h in stops.high)


def test_a_beam_without_travel_is_refused():
    with pytest.raises(ValueError, match="half ranges"):
        beam_stops(azimuth=0.0)
