"""The text of a figure and that of its threshold say which is less, as the verdict does."""

import pytest
import torch

from dynasindy.checking.check import Settings, check
from dynasindy.checking.verdict import Thresholds, error, least, most


@pytest.fixture(scope="module")
def good(loops):
    return check(loops(), Settings((-0.4,), (0.4,), points=2, seconds=8.0, grid=3, draws=2))


@pytest.mark.parametrize(
    ("pair", "said"),
    [
        (least(29.98, 30.0, 0), ("29.98", "30")),
        (least(30.02, 30.0, 0), ("30", "30")),
        (least(29.4, 30.0, 0), ("29", "30")),
        (most(30.02, 30.0, 0), ("30.02", "30")),
        (most(29.98, 30.0, 0), ("30", "30")),
        (most(2.5712, 2.5699, 3, "g", 3), ("2.571", "2.57")),
        (most(2.5699, 2.5712, 3, "g", 3), ("2.57", "2.57")),
        (most(2.5706, 2.5702, 3, "g", 3), ("2.571", "2.57")),
        (least(6.003, 6.0206, 1, of_limit=2), ("6.00", "6.02")),
        (least(7.5, 6.0206, 1, of_limit=2), ("7.5", "6")),
    ],
)
def test_a_figure_has_as_many_digits_as_its_verdict_takes(pair, said):
    assert pair == said


def test_an_error_that_is_just_too_large_is_shown_to_be(good):
    """The typical size of p is 2 m, of which a twentieth is allowed."""
    told = error(good, torch.tensor([[0.10003]], dtype=torch.float64), Thresholds())
    assert (told.word, told.allowed) == ("0.10003 m", "0.1 m, 5 % of 2 m, the typical size of p")
    assert told.share > 0.05 and error(good, torch.tensor([[torch.inf]]), Thresholds()).word == "no bound"
