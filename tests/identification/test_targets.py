"""Targets that are proposed lie where the log was, and nothing that was given is proposed again."""

import math

import pytest
import torch

from dynasindy.data.recording import Recording
from dynasindy.identification.source import Source
from dynasindy.identification.targets import targets_like
from dynasindy.sindy import SindyModel
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
    ends = {"low": ["100", "20.10"], "high": ["900", "20.90"]}
    assert targets_like(source, ["w"], NONE) == {"outputs": ["q", "T"], **ends}


def test_the_corners_of_a_range_are_held_too(source):
    """At rest q is 895 u + 105 v, and T - 20 is .105 u + .895 v: q = 900 beside T = 20.1 would take u = 1.006."""
    equations = {"q": {"q": -1, "u": 895, "v": 105}, "T": {"1": 20, "T": -1, "u": 0.105, "v": 0.895}}
    equations |= {"w": {"w": -1}, "h": {"h": -1}}
    model = SindyModel(source.signature, ["1", *"qwThuv"], fixed=equations)
    found = targets_like(source, ["w"], NONE, model)
    ends = torch.tensor([[float(end) for end in found[key]] for key in ("low", "high")])
    corners = torch.cartesian_prod(*(ends - torch.tensor([0.0, 20.0])).mT)
    assert torch.linalg.solve(torch.tensor([[895, 105], [0.105, 0.895]]), corners.mT).abs().max() <= 1


def test_what_was_given_stays(source):
    given = {"outputs": ["T"], "low": [20.0], "high": None}
    assert targets_like(source, ["w"], given) == {"high": ["20.90"]}
    assert targets_like(source, [], {**given, "high": [21.0]}) == {}
    assert targets_like(source, [], {**NONE, "outputs": ["h"]}) == {}  # of what nobody measured nothing is known


def logged(columns, units):
    """A log of states that move between minus and plus their factors, under an input of all its range."""
    ramp = torch.linspace(-1, 1, 1001, dtype=torch.float64)
    x = torch.stack([factor * ramp for factor in columns.values()], -1)
    signature = Signature(tuple(columns), units, ("u",), tuple(map(float, columns.values())))
    return Source.of(Recording(Transitions.from_trajectory(x, ramp[:-1, None], 0.01), signature), 0)


def test_only_targets_that_an_input_holds_are_proposed():
    """Half of the weight is lifted, as far as an angle whose sine is a half: 30 degrees; the log went to 1.2 rad."""
    source = logged({"angle": 1.5, "rate": 3.0}, ("rad", "rad/s"))
    equations = {"angle": {"rate": 1.0}, "rate": {"sin(angle)": -10.0, "rate": -0.5, "u": 5.0}}
    model = SindyModel(source.signature, ["rate", "sin(angle)", "u"], fixed=equations)
    found = targets_like(source, ["rate"], NONE, model)
    low, high = float(found["low"][0]), float(found["high"][0])
    assert found["outputs"] == ["angle"]
    assert 0.8 * math.pi / 6 < high <= math.pi / 6 and -math.pi / 6 <= low < -0.8 * math.pi / 6
    strong = {**equations, "rate": {"sin(angle)": -10.0, "rate": -0.5, "u": 12.0}}
    whole = SindyModel(source.signature, ["rate", "sin(angle)", "u"], fixed=strong)
    assert targets_like(source, ["rate"], NONE, whole) == {"outputs": ["angle"], "low": ["-1.2"], "high": ["1.2"]}


def test_an_output_that_no_input_moves_is_not_proposed_where_another_one_is_held():
    source = logged({"outside": 1.0, "inside": 1.0}, ("degC", "degC"))
    equations = {"outside": {"outside": -1.0}, "inside": {"inside": -1.0, "u": 2.0}}
    model = SindyModel(source.signature, ["outside", "inside", "u"], fixed=equations)
    assert targets_like(source, [], NONE, model)["outputs"] == ["inside"]
    # Whoever names it gets where the log was.
    assert targets_like(source, [], {**NONE, "outputs": ["outside"]}, model)["low"] == ["-0.8"]


def test_an_acceleration_is_proposed_only_where_there_is_nothing_else():
    units = ("m/s^2", "-", "m/s")
    assert targets_like(logged({"a": 1, "body_accel": 1, "speed": 1}, units), [], NONE)["outputs"] == ["speed"]
    assert targets_like(logged({"a": 1}, units[:1]), [], NONE)["outputs"] == ["a"]


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2 * math.pi), ("deg", 360.0)])
def test_of_an_angle_that_was_spun_a_turn_around_zero_is_proposed(unit, turn):
    source = logged({"angle": 20 * turn}, (unit,))
    found = targets_like(source, [], NONE)
    low, high = float(found["low"][0]), float(found["high"][0])
    assert 0.9 * turn < high - low <= turn and high == -low
    way = logged({"way": 20 * turn}, ("m",))
    assert float(targets_like(way, [], NONE)["high"][0]) == pytest.approx(16 * turn, rel=0.05)


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2 * math.pi), ("deg", 360.0)])
@pytest.mark.parametrize(("begin", "middle"), [(0.0, 0.5), (0.1, 0.6), (4.0, 4.5), (4.6, 5.1)])
def test_of_an_angle_that_was_wound_up_the_turn_where_it_began_is_proposed(unit, turn, begin, middle):
    x = torch.linspace(begin, 20.0, 1001, dtype=torch.float64).unsqueeze(-1) * turn
    data = Transitions.from_trajectory(x, torch.zeros(1000, 1), 0.1)
    found = targets_like(Source.of(Recording(data, Signature(("a",), (unit,), ("u",), (1.0,))), 0), [], NONE)
    low, high = float(found["low"][0]), float(found["high"][0])
    assert (low + high) / 2 == pytest.approx(middle * turn, abs=0.02 * turn) and high - low == pytest.approx(
        turn, rel=0.02
    )
