"""Durations."""

import math

import pytest

from dynasindy.text import format_duration


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.05, "0.05 s"),
        (20, "20 s"),
        (599, "599 s"),
        (600, "10 min"),
        (930, "15.5 min"),
        (1000, "16.67 min"),
        (2005, "33.42 min"),
        (9000, "2.5 h"),
        (10000, "2.778 h"),
        (-5400, "-90 min"),
        (7200, "2 h"),
        (3600 * 12345, "12345 h"),
        (math.inf, "inf s"),
        (math.nan, "nan s"),
    ],
)
def test_a_length_of_time_is_told_in_the_unit_that_suits_it(seconds, words):
    assert format_duration(seconds) == words
