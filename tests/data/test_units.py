"""Units of headings: angles become radians and say so, whatever the plant; all others stay."""

import math
import shlex

import numpy as np
import pytest
import yaml

from dynasindy.data.columns import Column
from dynasindy.data.units import conversions, in_radians, with_units
from dynasindy.evaluation.identification import Logged
from dynasindy.systems import Pendulum

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


@pytest.mark.parametrize("unit", ["rad", "rad/s", "m", "degC", "°C", "deg C", "deg/min", "", "-"])
def test_other_units_stay(unit):
    assert in_radians(unit) == (unit, 1.0)


def test_turns_per_minute_are_those_of_an_angle_or_stay():
    """A rotor's speed is no rate of the pitch that it moves."""
    headings = ["pitch [deg]", "pitch_rate [rpm]", "rotor [rpm]", "motor [rpm]"]
    columns = {name: Column(name) for name in ("pitch", "pitch_rate", "rotor", "motor")}
    found = with_units(columns, headings, True, {"pitch": "motor"})
    assert {name: column.unit for name, column in found.items()} == {
        "pitch": "rad",
        "pitch_rate": "rad/s",
        "rotor": "rpm",
        "motor": "rad/s",
    }


def test_what_is_given_of_a_column_stays():
    given = {
        "kept": Column("a", "deg"),
        "scaled": Column("a", "rad", 0.5),
        "named": Column("a", "rad"),
        "free": Column("a"),
        "other": Column("a", "m"),
    }
    found = with_units(given, ["a [deg]"], states=True)
    units = {name: (column.unit, column.scale) for name, column in found.items()}
    degree = ("rad", pytest.approx(math.radians(1)))
    assert units == {"kept": ("deg", 1), "scaled": ("rad", 0.5), "named": degree, "free": degree, "other": ("m", 1)}
    assert with_units(found, ["a [deg]"], states=True) == found
    assert with_units({"rudder": Column("a")}, ["a [deg]"], states=False) == {"rudder": Column("a", "deg")}


def written(path, headings):
    """Write an angle of 1 rad/s of which each column has 1 deg/s for a degree, and an input."""
    t = 0.01 * np.arange(200)
    rows = np.stack([t, np.degrees(np.sin(t)), np.degrees(np.cos(t)), np.arange(200) // 9 % 3 - 1.0], -1)
    path.write_text("\n".join([headings, *(",".join(map(repr, map(float, row))) for row in rows)]))
    return str(path), t


def test_a_log_in_degrees_is_read_in_radians_and_says_so_in_a_line(tmp_path):
    path, t = written(tmp_path / "log.csv", "time [s],angle [deg],rate (deg/s),u")
    found = Logged(path).recording(None)
    assert found.signature.state_units == ("rad", "rad/s")
    assert found.transitions.x.numpy() == pytest.approx(np.stack([np.sin(t), np.cos(t)], -1)[:-1])
    (_, note) = found.notes
    assert note.startswith("converted: angle from deg to rad, rate from deg/s to rad/s. Targets and limits are to be")
    (word,) = [word for word in shlex.split(note) if word.startswith("data.states=")]
    given = yaml.safe_load(word.removeprefix("data.states="))
    kept = Logged(path, given).recording(None)
    assert kept.signature.state_units == ("deg", "deg/s") and not kept.notes[1:]
    assert kept.transitions.x.numpy() == pytest.approx(np.degrees(np.stack([np.sin(t), np.cos(t)], -1)[:-1]))


def test_a_rate_that_is_known_or_differentiated_is_one_of_radians(tmp_path):
    path, t = written(tmp_path / "log.csv", "time [s],angle [deg],speed [deg/s],u")
    alone = Logged(path, ["angle"], known={"angle": "angle_rate"}).load(None, None)
    assert alone.signature.state_units == ("rad", "rad/s")
    states = {"angle": "angle", "w": {"derivative_of": "angle", "unit": "deg/s"}}
    slope = Logged(path, states).recording(None)
    assert slope.signature.state_units == ("rad", "rad/s")
    assert slope.transitions.x[:, 1].numpy() == pytest.approx(np.cos(t)[:-1], abs=1e-4)


def test_a_plant_that_is_named_reads_degrees_too(tmp_path):
    path, t = written(tmp_path / "log.csv", "time [s],theta [°],Omega [°/s],u")
    found = Logged(path).recording(Pendulum().signature)
    assert found.transitions.x[:, 0].numpy() == pytest.approx(np.sin(t)[:-1])
    assert len(found.notes) == 2 and "theta from ° to rad" in found.notes[1]


def test_nothing_is_said_where_nothing_was_converted():
    assert conversions({"a": Column("a", "rad"), "b": Column("b [deg]", "deg")}, ["a [rad]", "b [deg]"]) == []
