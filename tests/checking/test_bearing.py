"""Lines on margins have figures that are on the side of their thresholds that the verdict says."""

import re
from dataclasses import replace

import pytest

from dynasindy.checking import check_verdict
from dynasindy.checking.check import Settings, check
from dynasindy.checking.linear_loop import Margins


@pytest.fixture(scope="module")
def good(loops):
    return check(loops(), Settings((-0.4,), (0.4,), points=2, seconds=8.0, grid=3, draws=2))


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"gain": 1.9996}, "gain margin"),
        ({"lower": 0.50004}, "gain reduction"),
        ({"phase": 29.998}, "phase margin"),
        ({"delay": 0.099996}, "delay margin"),
        ({"disk": 0.49997}, "disk margin"),
    ],
)
def test_a_margin_that_is_just_too_small_is_shown_to_be(good, changed, name):
    """The first number of the line is on the side of the last that its mark says, and the other way round."""
    sound = Margins(5.0, 0.2, 60.0, 0.5, 1.0)
    found = check_verdict(replace(good, margins=[[sound], [replace(sound, **changed)]]))
    (line,) = (each for each in found if each.name == name)
    value = float(re.search(r"(?:the least is|may fall to) ([\d.]+)", line.words)[1])
    limit = float(re.search(r"threshold: ([\d.]+)", line.words)[1])
    assert line.weak and (value > limit if name == "gain reduction" else value < limit), line.words
