"""Inputs in units of their own, against the straight line through the ends of an actuator."""

import csv
import math
import shlex

import numpy as np
import pytest
import yaml

from dynasindy.data.csv import CsvLog
from dynasindy.evaluation.identification import Logged

VALVE = {"valve": {"name": "valve", "low": 0, "high": 100}}


def written(path, values, heading="valve [%]"):
    """Write a log of a tank that a valve fills, and return its path."""
    rows = [(0.1 * k, math.sin(0.07 * k), float(value)) for k, value in enumerate(values)]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("time [s]", "level [m]", heading), *rows])
    return str(path)


def levels(low, high):
    return np.tile(np.repeat(np.linspace(low, high, 8), 5), 4)


def test_the_ends_of_an_actuator_become_minus_one_and_one(tmp_path):
    values = levels(20.0, 60.0)
    found = CsvLog(written(tmp_path / "log.csv", values), {"level": "level"}, VALVE).read()
    assert found.transitions.u[:, 0].numpy() == pytest.approx(values[:-1] / 50 - 1)  # 0 % at -1, 50 % at 0, 100 % at 1
    assert found.signature.input_ends == ((0.0, 100.0),)
    assert "-1 is 0, 1 is 100" in found.notes[0]


@pytest.mark.parametrize(
    ("low", "high", "ends"),
    [(20, 60, (20, 60)), (-12, 11, (-12, 12)), (-30, 70, (-30, 70)), (0, 255, (0, 255)), (-9, -3, (-9, -3))],
)
def test_a_log_alone_tells_the_range_that_an_input_used(tmp_path, low, high, ends):
    """Zero stays zero where an input goes about as far to either side."""
    values = levels(low, high)
    path = written(tmp_path / "log.csv", values)
    found = Logged(path, inputs=["valve"]).recording(None)
    assert found.signature.input_ends == (ends,)
    middle, half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
    assert middle + half * found.transitions.u[:, 0].numpy() == pytest.approx(values[:-1])
    assert f"'data.inputs={{valve: {{name: valve, low: {ends[0]:g}, high: {ends[1]:g}}}}}'" in found.notes[1]


@pytest.mark.parametrize("most", [0.4, 1.0, 1.0004])
def test_an_input_within_one_is_taken_as_it_is(tmp_path, most):
    values = levels(-most, most)
    found = Logged(written(tmp_path / "log.csv", values), inputs=["valve"]).recording(None)
    assert np.array_equal(found.transitions.u[:, 0].numpy(), values[:-1])
    assert found.signature.input_ends == () and not found.notes


def test_ends_of_minus_one_and_one_keep_the_numbers(tmp_path):
    values = levels(-12.0, 12.0)
    kept = {"valve": {"name": "valve", "low": -1, "high": 1}}
    found = Logged(written(tmp_path / "log.csv", values), inputs=kept).recording(None)
    assert np.array_equal(found.transitions.u[:, 0].numpy(), values[:-1])
    assert "beyond the [-1, 1]" in found.notes[0]


@pytest.mark.parametrize(
    "ends", [{"low": 0}, {"low": 5, "high": 5}, {"low": 0, "high": "x"}, {"low": 0, "high": math.inf}]
)
def test_ends_that_are_none_are_refused(tmp_path, ends):
    log = CsvLog(written(tmp_path / "log.csv", levels(0, 9)), {"level": "level"}, {"valve": {"name": "valve", **ends}})
    with pytest.raises(ValueError, match="both, low < high"):
        log.read()


def test_a_proposed_setting_reads_the_same_numbers(tmp_path):
    """Millivolts that were scaled stay scaled."""
    path = written(tmp_path / "log.csv", levels(-12_000.0, 12_000.0), "valve [mV]")
    scaled = {"valve": {"name": "valve", "unit": "V", "scale": 0.001}}
    first = Logged(path, inputs=scaled).recording(None)
    (word,) = shlex.split(first.notes[1].rpartition("as they are: ")[2])
    given = yaml.safe_load(word.removeprefix("data.inputs="))
    assert given["valve"] == {"name": "valve", "unit": "V", "scale": 0.001, "low": -12, "high": 12}
    second = Logged(path, inputs=given).recording(None)
    assert np.array_equal(first.transitions.u.numpy(), second.transitions.u.numpy())
    assert float(second.transitions.u.abs().max()) == pytest.approx(1.0)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (5, 100.5), (0, 99.9)])
def test_ends_that_the_column_goes_beyond_are_refused(tmp_path, low, high):
    path = written(tmp_path / "log.csv", levels(0.0, 100.0))
    log = CsvLog(path, {"level": "level"}, {"valve": {"name": "valve", "low": low, "high": high}})
    with pytest.raises(ValueError, match=rf"given low {low} and high {high}, its column goes from 0 to 100 after"):
        log.read()


def test_an_input_may_leave_its_ends_by_rounding(tmp_path):
    path = written(tmp_path / "log.csv", levels(0.0, 100.04))
    assert CsvLog(path, {"level": "level"}, VALVE).read().signature.input_ends == ((0.0, 100.0),)


def test_ends_of_a_state_are_refused(tmp_path):
    path = written(tmp_path / "log.csv", levels(0.0, 100.0))
    with pytest.raises(ValueError, match="state level was given low and high, which inputs alone have"):
        CsvLog(path, {"level": {"name": "level", "low": 0, "high": 2}}, VALVE).read()
