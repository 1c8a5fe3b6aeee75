"""The time of a log, its unit and what is said of it, against times that were written into a file."""

import math
import shlex

import numpy as np
import pytest
import yaml

from dynasindy.data.clock import clock_of, period_of
from dynasindy.evaluation.identification import Logged


def written(path, heading, times, separator=","):
    """Write a swing and a held command at some times."""
    rows = enumerate(times)
    lines = [separator.join((str(t), f"{math.sin(0.03 * k)}", f"{k // 9 % 3 - 1}")) for k, t in rows]
    path.write_text("\n".join([separator.join((heading, "angle", "u")), *lines]))
    return str(path)


def test_the_period_of_a_log_is_the_decimal_number_that_was_written():
    t = np.array([float(f"{0.04 * k:.2f}") for k in range(300)])
    assert np.median(np.diff(t)) != 0.04 and period_of(t) == 0.04
    assert period_of(np.arange(9) / 3) == pytest.approx(1 / 3, rel=1e-11)  # and what is no such number stays what it is


@pytest.mark.parametrize(("unit", "seconds"), [("s", 1), ("ms", 1e-3), ("\u00b5s", 1e-6), ("min", 60), ("h", 3600)])
def test_a_unit_of_time_is_so_many_seconds(unit, seconds):
    assert clock_of([f"t [{unit}]"]).seconds("log.csv") == seconds
    assert clock_of([f"t ({unit.upper()})"]).seconds("log.csv") == seconds


@pytest.mark.parametrize(
    ("headings", "clock"),
    [
        (["time [s]", "Time"], "time [s]"),
        (["Time", "a"], "Time"),
        (["a", "Time (s)"], "Time (s)"),
        (["t [ms]", "T [degC]"], "t [ms]"),
        (["TIME [S]", "a"], "TIME [S]"),
        (["Timestamp", "a"], "Timestamp"),
        (["T [s]", "a"], "T [s]"),
        (["T", "a"], "time"),  # a temperature
        (["t", "Time"], "time"),  # which?
        (["t [degC]", "a"], "time"),
        (["t_ms", "T_h"], "time"),  # which?
        (["a", "time_us", "T"], "time_us"),
        (["millis", "a"], "millis"),
        (["s", "h", "a"], "time"),  # a way and a height
        (["rise_time", "a_t"], "time"),
    ],
)
def test_time_is_found_where_only_one_heading_can_mean_it(headings, clock):
    assert clock_of(headings).heading == clock
    assert clock_of(headings, "a").heading == "a"


@pytest.mark.parametrize(
    ("heading", "per_second", "how"),
    [
        ("t_ms", 1e3, "in ms"),
        ("t [ms]", 1e3, "in ms"),
        ("time_us", 1e6, "in us"),
        ("Time ms", 1e3, "in ms"),
        ("millis", 1e3, "in millis"),
        ("t", 1.0, "taken as seconds"),
        ("time [s]", 1.0, "in s"),
    ],
)
def test_the_column_of_time_and_its_unit_are_always_said(tmp_path, heading, per_second, how):
    """Samples every 20 ms, whatever they are counted in."""
    path = written(tmp_path / "log.csv", heading, [f"{0.02 * k * per_second:.6g}" for k in range(100)])
    found = Logged(path).recording(None)
    assert found.transitions.dt == pytest.approx(0.02)
    assert found.notes[0] == f"time is the column {heading.split(' [')[0]}, {how}: 0.02 s between rows"


def test_a_counter_gets_a_hint_and_what_the_hint_says_mends_it(tmp_path):
    path = written(tmp_path / "log.csv", "t", range(100))
    found = Logged(path).recording(None)
    assert found.transitions.dt == 1.0 and "taken as seconds: 1 s between rows. It holds whole" in found.notes[0]
    counted = Logged(path, dt=0.05).recording(None)
    assert counted.transitions.dt == 0.05 and len(counted.transitions) == 99
    assert "a counter of rows: 0.05 s between rows" in counted.notes[0]
    (word,) = (w for w in shlex.split(found.notes[0].replace(",", " ")) if w.startswith("data.time="))
    named = Logged(path, time=yaml.safe_load(word.removeprefix("data.time="))).recording(None)
    assert named.transitions.dt == pytest.approx(1e-3) and named.notes[0].endswith("in ms: 0.001 s between rows")


def test_a_counter_that_lost_rows_keeps_its_gaps(tmp_path):
    """Every second count is logged, and five counts are lost: 0.1 s between rows, and one gap."""
    counts = [k for k in range(0, 300, 2) if not 100 <= k < 106]
    found = Logged(written(tmp_path / "log.csv", "t", counts), dt=0.1).recording(None)
    assert found.transitions.dt == 0.1 and found.transitions.segment.unique().tolist() == [0, 1]


def test_dates_with_points_are_read_with_the_day_first(tmp_path):
    """Four samples a second over the end of a leap February."""
    days = [
        ("28.02.2024 23:59", 60 - 12.5 + 0.25 * k) if k < 50 else ("29.02.2024 00:00", 0.25 * (k - 50))
        for k in range(100)
    ]
    times = [f"{day}:{second:05.2f}" for day, second in days]
    found = Logged(written(tmp_path / "log.csv", "t", times)).recording(None)
    assert found.transitions.dt == pytest.approx(0.25) and found.transitions.segment.unique().tolist() == [0]
    assert found.notes == ("time is the column t, read as dates: 0.25 s between rows",)


@pytest.mark.parametrize("heading", ["Time [ms]", "Time (ms)"])
@pytest.mark.parametrize("named", ["Time", "Time [ms]", "Time (ms)", "Time[ms]"])
def test_a_time_is_named_with_its_unit_or_without(heading, named):
    found = clock_of([heading, "T [degC]", "u"], named)
    assert (found.heading, found.seconds("log.csv")) == (heading, 1e-3)
    assert clock_of([heading, "T [degC]", "u"], "Time [s]").heading not in (heading, "Time")
