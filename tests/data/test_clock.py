"""The time of a log, its unit and what is said of it, against times that were written into a file."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

import dynasindy
from dynasindy.data.clock import clock_of
from dynasindy.data.table import Table
from dynasindy.findings import note, weak
from dynasindy.identification.identify import LoggedData
from dynasindy.sindy import Refinement, Regression, SindyModel


def written(path, heading, times, separator=","):
    """Write a swing and a held command at some times."""
    rows = enumerate(times)
    lines = [separator.join((str(t), f"{math.sin(0.03 * k)}", f"{k // 9 % 3 - 1}")) for k, t in rows]
    path.write_text("\n".join([separator.join((heading, "angle", "u")), *lines]))
    return str(path)


def test_the_period_of_a_log_is_the_decimal_number_that_was_written(tmp_path):
    stamps = [f"{0.04 * k:.2f}" for k in range(300)]
    assert np.median(np.diff([float(stamp) for stamp in stamps])) != 0.04
    assert LoggedData(written(tmp_path / "log.csv", "time", stamps)).recording().transitions.dt == 0.04
    for period, logged in ((0.02, 0.02), (1 / 64, 1 / 64), (1 / 60, 0.016667)):
        dates = [f"2024-03-05T14:02:{period * k:09.6f}Z" for k in range(300)]
        path = written(tmp_path / "log.csv", "time", dates)
        assert period == 1 / 64 or np.median(np.diff(Table.read(Path(path)).column("time"))) != logged
        assert LoggedData(path).recording().transitions.dt == logged


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
    assert clock_of(headings)[0] == clock
    assert clock_of(headings, "a")[0] == "a"


@pytest.mark.parametrize(
    ("heading", "per_second", "unit"),
    [
        ("t_ms", 1e3, "ms"),
        ("t [ms]", 1e3, "ms"),
        ("time_us", 1e6, "us"),
        ("Time ms", 1e3, "ms"),
        ("millis", 1e3, "millis"),
        ("t", 1.0, ""),
        ("time [s]", 1.0, "s"),
        ("time (MS)", 1e3, "MS"),
        ("time[µs]", 1e6, "µs"),
        ("time [min]", 1 / 60, "min"),
        ("time [h]", 1 / 3600, "h"),
    ],
)
def test_the_column_of_time_and_its_unit_are_always_said(tmp_path, heading, per_second, unit):
    """Samples every 20 ms, whatever they are counted in."""
    path = written(tmp_path / "log.csv", heading, [f"{0.02 * k * per_second:.12g}" for k in range(100)])
    found = LoggedData(path).recording(None)
    assert found.transitions.dt == pytest.approx(0.02)
    column = heading.partition("[")[0].partition(" (")[0].strip()
    told = note("log.time", column=column, unit=unit, dates=False, dt=pytest.approx(0.02))
    assert found.findings == (told,)


def test_a_counter_gets_a_hint_and_what_the_hint_says_mends_it(tmp_path):
    path = written(tmp_path / "log.csv", "t", range(100))
    found = LoggedData(path).recording(None)
    assert found.transitions.dt == 1.0 and found.findings[1:] == (weak("log.whole_seconds", column="t"),)
    counted = LoggedData(path, dt=0.05).recording(None)
    assert counted.transitions.dt == 0.05 and len(counted.transitions) == 99
    assert counted.findings == (note("log.row_counter", column="t", dt=0.05),)
    named = LoggedData(path, time=f"{found.findings[1].values['column']} [ms]").recording(None)
    assert named.transitions.dt == pytest.approx(1e-3) and named.findings[0].values["unit"] == "ms"


def decimals(places):
    return lambda t: f"{t:.{places}f}"


def logged(path, times, stamp, heading="time", rows=None, dt=None):
    """Write a spring a' = w, w' = -7 a - 0.6 w + 5 u, solved exactly, and return what is read of some of its rows."""
    rng, a, b = np.random.default_rng(5), np.array([[0.0, 1.0], [-7.0, -0.6]]), np.array([[0.0], [5.0]])
    u = np.repeat(rng.uniform(-1, 1, len(times) // 15 + 1), 15)[: len(times)]
    x, lines = np.zeros(2), [f"{heading},a [rad],w [rad/s],u"]
    lasts, steps = np.append(np.diff(times), 0.01), {}
    for t, push, step in zip(times, u, lasts, strict=True):
        lines.append(f"{stamp(t)},{x[0]:.9g},{x[1]:.9g},{push:.9g}")
        if round(step, 12) not in steps:
            steps[round(step, 12)] = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), step)[:2]
        forth, by = steps[round(step, 12)]
        x = forth @ x + by[:, 0] * push
    rows = range(len(times)) if rows is None else rows
    path.write_text("\n".join([lines[0], *(lines[1 + k] for k in rows)]))
    return dynasindy.read(str(path), **({} if dt is None else {"dt": dt}))


def fitted(log):
    """Return the coefficients of w'."""
    refinement = Refinement("one_step", longest_delay=0.0)
    model = SindyModel(log.signature, ["a", "w", "u"], Regression("bic"), refinement, {"a": "w"})
    model.fit(log.training)
    return dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True))


def even(hertz, first=0.0, rows=800):
    return first + np.arange(rows) / hertz


def ticks_of_windows(t):
    """Return a time that moves 64 times a second, in ms."""
    return f"{math.floor(t * 64) / 64:.3f}"


@pytest.mark.parametrize(
    ("hertz", "first", "stamp", "heading"),
    [
        *((hertz, 3.0, decimals(2), "time") for hertz in (80, 33.3, 160)),
        (85, 0.0, lambda t: f"{math.floor(100 * t) / 100:.2f}", "time"),
        (333, 0.0, lambda t: str(int(1000 * t)), "t_ms"),
        (110, 9.5e4, lambda t: repr(float(np.float32(t))), "time"),
        (80, 1.7e9, decimals(2), "time [s]"),
        (20, 0.0, ticks_of_windows, "time"),
    ],
)
def test_an_even_log_in_coarse_stamps_tells_its_rate_and_its_equations(tmp_path, hertz, first, stamp, heading):
    log = logged(tmp_path / "log.csv", even(hertz, first), stamp, heading)
    assert log.training.dt == pytest.approx(1 / hertz, rel=1e-3)
    assert len(log.training.segment.unique()) == 1
    assert fitted(log) == pytest.approx({"a": -7.0, "w": -0.6, "u": 5.0}, rel=0.01)


@pytest.mark.parametrize(("hertz", "rows"), [(21, 4000), (60, 50_000)])
def test_a_long_log_in_ms_tells_its_rate_to_more_digits_than_a_short_one(tmp_path, hertz, rows):
    stamps = [f"{round(1000 * t)}" for t in even(hertz, 0.0, rows)]
    log = LoggedData(written(tmp_path / "log.csv", "t_ms", stamps)).recording()
    assert log.transitions.dt * rows == pytest.approx(rows / hertz, abs=0.002)


@pytest.mark.parametrize("lost", [0.005, 0.2])
def test_lost_rows_of_a_coarse_clock_need_the_sampling_time_and_are_gaps_then(tmp_path, lost):
    times, stamp, hertz = even(80, rows=1000), decimals(2), 80
    rows = sorted(np.random.default_rng(2).choice(1000, round(1000 * (1 - lost)), replace=False))
    with pytest.raises(ValueError, match="dt"):
        logged(tmp_path / "log.csv", times, stamp, rows=rows)
    log = logged(tmp_path / "log.csv", times, stamp, rows=rows, dt=1 / hertz)
    assert fitted(log)["u"] == pytest.approx(5.0, rel=0.01)


def test_rows_that_a_fine_clock_lost_at_random_are_gaps(tmp_path):
    rng = np.random.default_rng(3)
    for places, lost in ((2, 0.05), (3, 0.2)):
        rows = sorted(rng.choice(1000, round(1000 * (1 - lost)), replace=False))
        log = logged(tmp_path / "log.csv", even(50 if places == 3 else 100, rows=1000), decimals(places), rows=rows)
        assert log.training.dt == pytest.approx(0.02 if places == 3 else 0.01)
        assert fitted(log)["u"] == pytest.approx(5.0, rel=0.01)


@pytest.mark.parametrize("places", [3, 6])
def test_a_clock_that_is_truly_uneven_is_believed(tmp_path, places):
    rng = np.random.default_rng(4)
    times = np.round(0.02 * np.arange(900) + 0.004 * rng.uniform(-1, 1, 900), places)
    log = logged(tmp_path / "log.csv", times, decimals(places))
    assert "log.resampled" in [each.code for each in log.findings]
    assert fitted(log)["u"] == pytest.approx(5.0, rel=0.01)


def test_rows_that_alternate_between_two_distances_are_not_taken_as_even(tmp_path):
    times = np.cumsum(np.tile([0.011, 0.022], 200))
    log = LoggedData(written(tmp_path / "log.csv", "time", [f"{t:.3f}" for t in times])).recording()
    assert "log.coarse_clock" not in [each.code for each in log.findings]


def test_a_doubled_row_is_left_out_and_equal_stamps_of_a_coarse_clock_are_not(tmp_path):
    once = logged(tmp_path / "once.csv", even(100), decimals(2), rows=range(800))
    twice = logged(tmp_path / "log.csv", even(100), decimals(2), rows=sorted([*range(800), 200]))
    assert twice.training.x.equal(once.training.x)
    (copies,) = [each for each in twice.findings if each.code == "log.copies"]
    assert copies.values == {"count": 1, "line": 203}
    log = logged(tmp_path / "log.csv", even(250), decimals(2))
    assert log.training.dt == pytest.approx(0.004, rel=1e-3) and fitted(log)["u"] == pytest.approx(5.0, rel=0.01)
