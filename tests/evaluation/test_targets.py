"""Targets that are proposed lie where the log was, and nothing that was given is proposed again."""

import pytest
import torch

from dynasindy.data.csv import Recording
from dynasindy.evaluation.source import Source
from dynasindy.evaluation.targets import targets_like
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

NONE = {"outputs": None, "low": None, "high": None}


@pytest.fixture
def source():
    """A ramp of q from 0 to 1000, its rate w, a temperature T from 20 to 21 beside it, and h that nobody measured."""
    ramp = torch.linspace(0, 1, 1001, dtype=torch.float64)
    x = torch.stack([1000 * ramp, torch.ones_like(ramp), 20 + ramp, torch.full_like(ramp, torch.nan)], -1)
    signature = Signature(("q", "w", "T", "h"), ("m", "m/s", "degC", "m"), ("u", "v"), (1.0,) * 4)
    return Source.of(Recording(Transitions.from_trajectory(x, torch.zeros(1000, 2), 0.1), signature), 0)


def test_as_many_states_as_inputs_are_held_where_eight_tenths_of_the_log_are(source):
    assert targets_like(source, ["w"], NONE) == {
        "outputs": ["q", "T"],
        "low": ["100", "20.10"],
        "high": ["900", "20.90"],
    }


def test_what_was_given_stays(source):
    given = {"outputs": ["T"], "low": [20.0], "high": None}
    assert targets_like(source, ["w"], given) == {"high": ["20.90"]}
    assert targets_like(source, [], {**given, "high": [21.0]}) == {}
    assert targets_like(source, [], {**NONE, "outputs": ["h"]}) == {}  # of what nobody measured nothing is known
