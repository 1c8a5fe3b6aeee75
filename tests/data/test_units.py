"""Units of headings: angles become radians and say so, whatever the plant; all others stay."""

import math

import numpy as np
import pytest

from dynasindy.data.headings import in_radians
from dynasindy.data.table import Table
from dynasindy.findings import LogError
from dynasindy.identification.identify import LoggedData

TURN = 2 * math.pi


@pytest.mark.parametrize(
    ("unit", "becomes", "turn"),
    [
        ("deg", "rad", 360),
        ("°", "rad", 360),
        ("degrees/s", "rad/s", 360),
        ("deg/s^2", "rad/s^2", 360),
        ("rev/s", "rad/s", 1),
        ("mrad", "rad", TURN * 1000),
        ("rpm", "rad/s", 60),
    ],
)
def test_a_turn_is_two_pi_in_any_unit(unit, becomes, turn):
    """A turn per second is 60 rpm."""
    found, factor = in_radians(unit)
    assert found == becomes and turn * factor == pytest.approx(TURN)


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [("Temp °C", "Temp", "°C"), ("Pump %", "Pump", "%"), ("arm°", "arm", "°"), ("Level", "Level", "")],
)
def test_a_sign_at_the_end_is_the_unit(tmp_path, heading, name, unit):
    (tmp_path / "log.csv").write_text("\n".join([f"time,{heading}", "0,1", "1,3"]))
    assert Table.read(tmp_path / "log.csv").headings == ["time", f"{name} [{unit}]" if unit else name]


def written(path, headings):
    """Write an angle of 1 rad/s of which each column has 1 deg/s for a degree, and an input."""
    t = 0.01 * np.arange(200)
    rows = np.stack([t, np.degrees(np.sin(t)), np.degrees(np.cos(t)), np.arange(200) // 9 % 3 - 1.0], -1)
    path.write_text("\n".join([headings, *(",".join(map(repr, map(float, row))) for row in rows)]))
    return str(path), t


def test_a_log_in_degrees_is_read_in_radians_and_says_so_in_a_line(tmp_path):
    path, t = written(tmp_path / "log.csv", "time [s],angle [deg],rate (deg/s),u")
    found = LoggedData(path).recording(None)
    assert found.signature.state_units == ("rad", "rad/s")
    assert found.transitions.x.numpy() == pytest.approx(np.stack([np.sin(t), np.cos(t)], -1)[:-1])
    (_, told) = found.findings
    assert told.code == "log.converted"
    assert told.values["units"] == {"angle": ("deg", "rad"), "rate": ("deg/s", "rad/s")}
    kept = LoggedData(path, told.values["kept"]).recording(None)
    assert kept.signature.state_units == ("deg", "deg/s") and not kept.findings[1:]
    assert kept.transitions.x.numpy() == pytest.approx(np.degrees(np.stack([np.sin(t), np.cos(t)], -1)[:-1]))


def swinging(path, headings, speed=30 / math.pi, noise=0.0):
    """Write a swing of two frequencies in degrees, its rate in a unit of its own, a rotor that lags behind, a command.

    The pendulum hangs from a spring and is linear, so that all is closed form: a rad/s is 30 / pi turns a minute.
    """
    t = 0.01 * np.arange(2001)
    angle, rate = np.sin(2 * t) + 0.3 * np.sin(7 * t), 2 * np.cos(2 * t) + 2.1 * np.cos(7 * t)
    rough = rate + noise * rate.std() * np.random.default_rng(0).standard_normal(len(t))
    columns = [t, np.degrees(angle), speed * rough, 900 + 400 * np.sin(3 * t), np.arange(2001) // 9 % 3 - 1.0]
    rows = np.stack(columns, -1)
    path.write_text("\n".join([headings, *(",".join(map(repr, map(float, row))) for row in rows)]))
    return str(path), np.stack([angle, rate], -1)[:-1]


@pytest.mark.parametrize(
    ("name", "known"),
    [("speed", None), ("speed", {"angle": "speed"}), ("motor", {"angle": "motor"}), ("angle_rate", None)],
)
@pytest.mark.parametrize("turned", [1, -1])
def test_turns_per_minute_that_are_the_slope_of_an_angle_are_read_in_radians(tmp_path, name, known, turned):
    """The rotor, in turns per minute as well, is the slope of nothing; a speed of the other sign is a speed."""
    headings = f"time [s],angle [deg],{name} [rpm],rotor [rpm],u"
    path, swing = swinging(tmp_path / "log.csv", headings, turned * 30 / math.pi)
    if known and turned < 0:
        with pytest.raises(LogError) as error:
            LoggedData(path, known=known).recording(None)
        assert error.value.finding.code == "log.rate_units"
        return
    found = LoggedData(path, known=known).recording(None)
    assert found.signature.state_units == ("rad", "rad/s", "rpm")
    x = found.transitions.x.numpy()
    assert x[:, :2] == pytest.approx(swing * [1, turned]) and 1299 < x[:, 2].max() < 1301
    assert found.signature.x_scale[1] == pytest.approx(4.1, abs=0.01)  # both rates are largest at the start
    (told,) = (each.values for each in found.findings if each.code == "log.converted")
    assert told["units"] == {"angle": ("deg", "rad"), name: ("rpm", "rad/s")}
    kept = LoggedData(path, told["kept"]).recording(None)
    assert kept.signature.state_units == ("deg", "rpm", "rpm")


@pytest.mark.parametrize(
    ("headings", "speed", "scale"),
    [
        ("time [s],angle,speed [rpm],rotor [rpm],u", 30 / math.pi, 6.0),  # 360 degrees in 60 s
        ("time [s],angle [deg],speed [rad/s],rotor [rpm],u", 180 / math.pi, math.radians(1)),
        ("time [s],angle [deg],speed [rpm],rotor [rpm],u", 17 * 30 / math.pi, 2 * math.pi / 60 / 17),
    ],
)
def test_a_known_rate_in_other_units_stops_with_the_setting_that_mends_it(tmp_path, headings, speed, scale):
    path, swing = swinging(tmp_path / "log.csv", headings, speed)
    with pytest.raises(LogError) as error:
        LoggedData(path, known={"angle": "speed"}).recording(None)
    assert error.value.finding.code == "log.rate_units" and "\n" not in str(error.value)
    states = error.value.finding.values["states"]
    assert states["speed"]["scale"] == pytest.approx(scale, rel=0.01)
    found = LoggedData(path, states, known={"angle": "speed"}).recording(None)
    whole = 1.0 if found.signature.state_units[0] == "rad" else 180 / math.pi
    assert found.transitions.x[:, :2].numpy() == pytest.approx(whole * swing, rel=0.01)
    assert found.signature.state_units[2] == "rpm"
