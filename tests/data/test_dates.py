"""Dates as seconds, against the calendar."""

import math

import pytest

from dynasindy.data.table import seconds_of_date


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-02", 86400.0),
        ("02.01.1970", 86400.0),
        ("2.1.1970 0:00", 86400.0),
        ("01.01.1970 00:00:01.25", 1.25),
        ("01.01.1970 00:00:01,25", 1.25),
        ("01.03.2024 00:00:00", 1709251200.0),
        ("1970-01-01T02:00:00+02:00", 0.0),
    ],
)
def test_a_date_is_so_many_seconds_after_1970(text, seconds):
    assert seconds_of_date(text) == pytest.approx(seconds, abs=1e-6)


@pytest.mark.parametrize("text", ["", "off", "31.02.2024 12:00:00", "31/05/2024 12:00:00", "1.2", "12.5.3"])
def test_what_is_no_date_or_has_no_clear_month_is_none(text):
    assert math.isnan(seconds_of_date(text))
