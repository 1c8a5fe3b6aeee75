import math

import pytest

from dynasindy.durations import in_words, unit_of


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.05, "0.05 s"),
        (20, "20 s"),
        (599, "599 s"),
        (600, "10 min"),
        (930, "15.5 min"),
        (1000, "1000 s"),
        (2000, "2000 s"),
        (2005, "33.42 min"),
        (9000, "2.5 h"),
        (10000, "2.778 h"),
        (-5400, "-90 min"),
        (7200, "2 h"),
        (86400 * 7, "168 h"),
        (3600 * 12345, "12345 h"),
        (math.inf, "inf s"),
        (math.nan, "nan s"),
    ],
)
def test_a_length_of_time_is_told_in_the_unit_that_suits_it(seconds, words):
    assert in_words(seconds) == words


@pytest.mark.parametrize(("seconds", "unit"), [(599.0, "s"), (600.0, "min"), (799.9999999, "s"), (2005.0, "min")])
def test_words_and_axes_of_a_run_have_the_same_unit(seconds, unit):
    """800 s are 13.33 min, so they are told in seconds, whatever the rounding of a sum of control periods."""
    assert unit_of(seconds).name == in_words(seconds).split()[1] == in_words(1.0, seconds).split()[1] == unit


def test_what_runs_on_changes_its_unit_once():
    names = [in_words(seconds, running=True).split()[1] for seconds in range(1, 3600)]
    assert names == ["s"] * 599 + ["min"] * 3000


def test_lengths_beside_each_other_have_the_unit_of_the_longest():
    assert in_words(900, longest=36000) == "0.25 h"
    assert (unit_of(36000).name, unit_of(36000).seconds) == ("h", 3600.0)
