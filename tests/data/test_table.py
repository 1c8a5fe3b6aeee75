"""A table is read cell by cell as it was written, with the units of its headings, and every mistake has its line."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dynasindy.data.headings import in_radians
from dynasindy.data.table import Table
from dynasindy.findings import LogError, weak
from dynasindy.identification.identify import LoggedData


def write(folder: Path, text: str) -> Path:
    (folder / "log.csv").write_text(text, newline="")
    return folder / "log.csv"


def test_cells_headings_and_lines_are_those_of_the_file(tmp_path):
    table = Table.read(write(tmp_path, "a [m],b,c\n1,2,3\n\n4,,x\n7\n")).select(["c", "a"])
    assert table.headings == ["c", "a [m]"] and table.frame.index.tolist() == [2, 4, 5]
    assert np.array_equal(table.frame, [[3, 1], [math.nan, 4], [math.nan, 7]], equal_nan=True)


def test_text_in_a_column_of_numbers_is_told_with_its_line(tmp_path):
    """What is empty or nan was not measured, and is no text."""
    table = Table.read(write(tmp_path, "time,a [m],b\n0,1,5\n1,off,nan\n2,,6\n3,ERR 4,7\n4,1,2\n"))
    found = table.select(["time", "a", "b"]).findings
    assert found == (weak("log.words", line=3, column="a [m]", text="off", count=2),)
    assert not Table.read(write(tmp_path, "time,a\n2024-02-28 23:59:59,1\n")).select(["time", "a"]).findings


@pytest.mark.parametrize(
    ("text", "headings", "lines"),
    [
        ("Motor test 3\na,b,c\n1,2,3\n", "a b c", [3]),
        ("Motor test 3, third run\nSolver; RK4\n\na;b;c\n1,5;2;3\n", "a b c", [5]),
        ("a,b,c\ns,V,-\n1,2,3\n", "a [s],b [V],c", [3]),
        ("a,b\np.u.,x\n1,2\n", "a [p.u.],b [x]", [3]),
        ("a,b,c\n(s),(V),(-)\n\n1,2,3\n", "a [s],b [V],c", [4]),
        ("a,b,c\n,,\n1,2,3\n", "a b c", [3]),
        ("a,b\nx,y\n", "a b", [2]),
        ("Sample rate,100,\na,b,c\n1,2,3\n4,5,6\n", "a b c", [3, 4]),
        ("Run 1,,,\nt,x,v,u\n1,2,3,4\n4,5,6,7\n", "t x v u", [3, 4]),
        ("# a b c\n1 2 3\n4 5 6\n", "a b c", [2, 3]),
        ("time,1,2,u\n1,2,3,4\n4,5,6,7\n", "time 1 2 u", [2, 3]),
        ("a,b,c\n1,N/A,N/A\n2,N/A,N/A\n3,4,5\n", "a b c", [2, 3, 4]),
        ("a,b\nsec,1/min\n1,2\n3,4\n", "a [sec],b [1/min]", [3, 4]),
        ("  a  b (m/s) c\n  1.5  2 3\n  4  5 6\n", "a,b (m/s),c", [2, 3]),
        ("a\tb\t\n1\t2\t\n", "a b", [2]),
        (",a,b\n0,1,2\n1,2,3\n2,3,4\n3,4,5\n4,5,6\n", "a b", [2, 3, 4, 5, 6]),
        (",time,a\n0.5,0,2\n0.7,1,3\n1.2,2,4\n", "time a", [2, 3, 4]),
    ],
)
def test_headings_are_found_below_a_title_above_units_and_between_any_separators(tmp_path, text, headings, lines):
    table = Table.read(write(tmp_path, text))
    assert list(table.headings) == headings.split("," if "," in headings else None)
    assert table.frame.index.tolist() == lines


def test_a_quote_within_a_value_is_a_letter(tmp_path):
    table = Table.read(write(tmp_path, 'a,pipe\n1,5" long\n2,6 long\n')).select(["a"])
    assert table.frame.index.tolist() == [2, 3]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("1,2,3,4\n3,4,5,6\n", "no line of headings"),
        ("a,b\n1,2,3\n", "line 2 has more values"),
        ('a,b\n1,2\n3,"4\n5,6\n', "quote opens in line 3"),
        ("a,a\n1,2\n", "2 columns 'a'"),
        ("b,c\n1,2\n", "no column 'a'; allowed are b, c"),
        ("a\0b\n", "is not text"),
    ],
)
def test_what_is_no_table_is_refused_at_its_line(tmp_path, text, said):
    with pytest.raises(ValueError, match=r".") as error:
        Table.read(write(tmp_path, text)).select(["a"])
    assert said in str(error.value) and str(tmp_path) in str(error.value) and "\n" not in str(error.value)


def test_dates_of_the_time_column_become_seconds(tmp_path):
    """Over midnight, with fractions and a zone; of another column they are no numbers."""
    text = "time,a\n2024-02-28 23:59:59.50,1\n2024-02-29T00:00:00.25,2\n2024-02-29 01:00:01+01:00,3\n"
    table = Table.read(write(tmp_path, text)).select(["time", "a"])
    assert np.diff(table.column("time")) == pytest.approx([0.75, 0.75], abs=1e-6)
    with pytest.raises(ValueError, match="words"):
        Table.read(write(tmp_path, text)).select(["a", "time"])


def test_an_index_without_a_heading_leaves_units_what_they_are(tmp_path):
    table = Table.read(write(tmp_path, ",time,a_deg\n0,0.0,1.5\n1,0.1,2.5\n2,0.2,3.5\n"))
    assert table.headings == ["time", "a [deg]"]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ('"t","a","b"\n"0,01","1,5","-2,25"\n"0,02","2","3,125"\n', [[0.01, 1.5, -2.25], [0.02, 2.0, 3.125]]),
        ('t,a,b\n0.5,"1,250",3\n1.5,2,3\n', [[0.5, np.nan, 3.0], [1.5, 2.0, 3.0]]),  # which of both it is
        ('t,a,b\n0.5,1.125,"3,4"\n1.5,2,2.1\n', [[0.5, 1.125, np.nan], [1.5, 2.0, 2.1]]),  # one slip
        ("t;a;b\n0,5;1.013,25;-1.234,5\n1,5;1.012,75;12,25\n", [[0.5, 1013.25, -1234.5], [1.5, 1012.75, 12.25]]),
        ("t;a\n0,5;1.000\n1,5;999,5\n2,5;1.000,5\n", [[0.5, 1000.0], [1.5, 999.5], [2.5, 1000.5]]),
        ("t;a;b\n0,5;1.125;3,1\n1,5;2;2,1\n2,5;3.375;2,1\n", [[0.5, 1.125, 3.1], [1.5, 2, 2.1], [2.5, 3.375, 2.1]]),
        ("t;a;b\n0,5;1.250;1.5\n1,5;1.000;2\n", [[0.5, 1.25, 1.5], [1.5, 1.0, 2.0]]),
    ],
)
def test_commas_and_points_are_decimals_or_between_thousands_as_a_column_tells(tmp_path, text, numbers):
    assert np.array_equal(Table.read(write(tmp_path, text)).frame.to_numpy(), numbers, equal_nan=True)


@pytest.mark.parametrize("day", ["%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%Y-%m-%d"])
def test_days_beside_times_of_day_go_on_over_midnight(tmp_path, day):
    times = pd.Timestamp(2025, 5, 6, 23, 59, 58) + pd.to_timedelta(np.arange(4), unit="s")
    rows = (f"{time.strftime(day)};{time:%H:%M:%S};{k},5" for k, time in enumerate(times))
    table = Table.read(write(tmp_path, "\n".join(["Datum;Uhrzeit;a", *rows])))
    (clock,) = table.of_kind("dates")
    assert np.diff(table.column(clock)).tolist() == [1.0] * 3


@pytest.mark.parametrize(
    ("headings", "plain"),
    [
        ("a_deg,rate_deg_s,u_pct", ["a [deg]", "rate [deg/s]", "u [%]"]),
        ("x_mm,tank_mbar,U/V", ["x [mm]", "tank [mbar]", "U [V]"]),
        ("x_bar,strain_mV/V,k_N/mm", ["x_bar", "strain_mV_V", "k_N_mm"]),  # a mean value, and units that are fractions
        ("a_deg,a_rad,q[0],q[1]", ["a_deg [deg]", "a_rad [rad]", "q_0", "q_1"]),
        ("/joint/q[1],/cmd/u,x_V [V]", ["joint_q_1", "cmd_u", "x_V [V]"]),
    ],
)
def test_the_end_of_a_name_is_its_unit_where_the_name_stays_its_own(tmp_path, headings, plain):
    count = len(plain)
    text = "\n".join([headings, *(",".join(map(str, range(k, k + count))) for k in range(3))])
    assert list(Table.read(write(tmp_path, text)).headings) == plain
    assert Table.read(tmp_path / "log.csv").frame.to_numpy().tolist() == [list(range(k, k + count)) for k in range(3)]
    assert Table.read(tmp_path / "log.csv").select(headings.split(",")).headings == plain


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


def test_samples_and_no_name_tell_which_turns_per_minute_move_an_angle(tmp_path):
    path, swing = swinging(tmp_path / "log.csv", "time [s],angle [deg],motor [rpm],speed [rpm],u", 30 / math.pi)
    found = LoggedData(path).recording(None)
    assert found.signature.state_units == ("rad", "rad/s", "rpm")
    assert found.transitions.x[:, :2].numpy() == pytest.approx(swing)
    kept = LoggedData(path, {"angle": "angle", "motor": {"name": "motor", "unit": "rpm"}, "speed": "speed"})
    assert kept.recording(None).signature.state_units == ("rad", "rpm", "rpm")


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
