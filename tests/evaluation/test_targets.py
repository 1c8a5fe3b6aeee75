"""Targets that are proposed lie where the log was, and nothing that was given is proposed again."""

import pytest
import torch

from dynasindy.data.csv import Recording
from dynasindy.evaluation.source import Source
from dynasindy.evaluation.targets import in_words, require_radians, targets_like
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


def swung(reach, unit="rad"):
    """A log of an angle that went so far to both sides."""
    x = reach * torch.sin(0.1 * torch.arange(101.0)).unsqueeze(-1)
    data = Transitions.from_trajectory(x, torch.zeros(100, 1), 0.1)
    return Source.of(Recording(data, Signature(("angle",), (unit,), ("u",), (1.0,))))


def test_targets_are_told_in_their_units_and_angles_in_degrees_too():
    """Half a radian is 28.65 degrees."""
    signature = Signature(("angle", "h", "n"), ("rad", "cm", "-"), ("u",), (1.0, 1.0, 1.0))
    told = in_words(signature, {"angle": (-0.5, 0.5), "h": (8, 14), "n": (0, 1)})
    assert told == "targets: angle from -0.5 to 0.5 rad (-28.65 to 28.65 deg); h from 8 to 14 cm; n from 0 to 1"


def test_targets_in_degrees_of_an_angle_in_radians_are_refused_with_those_in_radians():
    with pytest.raises(ValueError, match=r"look like degrees: give -1\.047 and 1\.047 in plant\.low"):
        require_radians(swung(0.9), {"angle": (-60, 60)})


@pytest.mark.parametrize(
    ("reach", "unit", "ends"),
    [(0.9, "rad", (-1.2, 1.2)), (60.0, "deg", (-60, 60)), (0.9, "rad", (0, 3.14)), (0.0, "rad", (-60, 60))],
)
def test_targets_that_may_be_meant_as_they_are_stay(reach, unit, ends):
    require_radians(swung(reach, unit), {"angle": ends, "other": (-60, 60)})
