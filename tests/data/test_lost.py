"""Moments without a sample stay, long stretches go, and slopes are those of cubics through what is there."""

import numpy as np
import pytest

from dynasindy.data.csv import holes, rates_beside


def lacking(n: int, *rows: slice | int) -> np.ndarray:
    column = np.arange(float(n))
    for each in rows:
        column[each] = np.nan
    return column


def test_a_stretch_of_ten_samples_is_a_moment_and_one_more_is_none():
    segment, notes = np.zeros(100, dtype=np.int64), []
    out = holes({"a": lacking(100, slice(20, 29), slice(60, 70)), "b": lacking(100)}, segment, notes)
    assert np.flatnonzero(out).tolist() == list(range(60, 70))
    assert notes == ["10 rows in stretches of more than 10 rows without a were left out"]


def test_what_is_long_depends_on_how_often_a_sensor_is_read():
    column = np.full(300, np.nan)
    column[::5] = 1.0
    column[101:149] = np.nan  # 50 rows from one sample to the next are ten usual distances
    notes = []
    assert not holes({"a": column, "b": lacking(300)}, np.zeros(300, dtype=np.int64), notes).any() and not notes
    column[150] = np.nan
    assert np.flatnonzero(holes({"a": column, "b": lacking(300)}, np.zeros(300, dtype=np.int64), notes)).tolist() == [
        *range(101, 155)
    ]


def test_a_segment_begins_and_ends_with_a_measured_row():
    segment = np.repeat([0, 1], 10)
    a, b = lacking(20, 0, 1, 9, 10, 19), lacking(20, 0, 9, 11, 19)
    assert np.flatnonzero(holes({"a": a, "b": b}, segment, [])).tolist() == [0, 9, 19]


def test_a_slope_needs_five_of_seven_samples():
    column = lacking(30, 10, 11, 12)
    rates = rates_beside(column, 7, 0.1)
    assert np.isnan(rates[9:14]).all() and np.isfinite(rates[[8, 14]]).all()
    assert rates[np.isfinite(rates)] == pytest.approx(10.0)
