"""Inputs in units of their own, against the straight line through the ends of an actuator."""

import csv
import math

import numpy as np
import pytest
import torch

from dynasindy import envs
from dynasindy.data.recording import LogReader
from dynasindy.findings import LogError, note, weak, wrong
from dynasindy.identification.identify import LoggedData
from dynasindy.systems import BlackBox


class Task(envs.Task):
    """What every task takes of a signature."""

    def __init__(self, signature):
        super().__init__(signature, 1)

    def initial_state(self, batch, generator):
        raise NotImplementedError

    def observation(self, x, params, t):
        raise NotImplementedError

    def reward(self, x, x_next, params, t_next, at_stop):
        raise NotImplementedError


def written(path, values, heading="valve [%]"):
    """Write a log of a tank that a valve fills, and return its path."""
    rows = [(0.1 * k, math.sin(0.07 * k), float(value)) for k, value in enumerate(values)]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("time [s]", "level [m]", heading), *rows])
    return str(path)


def levels(low, high):
    return np.tile(np.repeat(np.linspace(low, high, 8), 5), 4)


@pytest.mark.parametrize(
    ("low", "high", "rest", "one", "limits"),
    [
        (0, 100, 0, 100, (0, 1)),
        (-100, 0, 0, 100, (-1, 0)),
        (-20, 100, 0, 100, (-0.2, 1)),
        (-100, 100, 0, 100, (-1, 1)),
        (4, 100, 4, 96, (0, 1)),
        (-100, -4, -4, 96, (-1, 0)),
    ],
)
def test_zero_stays_zero_and_what_an_actuator_does_not_reach_are_limits(tmp_path, low, high, rest, one, limits):
    """A heater of 0 to 100 % is off at 0, a valve of 4 to 20 mA is shut at 4 mA."""
    values = levels(low + 3.0, high - 5.0)
    given = {"valve": {"name": "valve", "low": low, "high": high}}
    found = LogReader(written(tmp_path / "log.csv", values), {"level": "level"}, given).recording()
    u, signature = found.transitions.u[:, 0].numpy(), found.signature
    assert u == pytest.approx((values[:-1] - rest) / one)
    assert signature.input_ends == ((rest - one, rest + one),)
    assert (signature.input_limits or ((-1, 1),))[0] == pytest.approx(limits)
    assert signature.in_own_units(found.transitions.u)[:, 0] == pytest.approx(values[:-1])
    assert signature.in_own_units([limits[0]]) == pytest.approx([low])
    ends = {"rest": rest, "one": rest + one, "low": low, "high": high}
    assert found.findings[1] == note("log.scaled", input="valve", unit="%", **ends)
    assert Task(signature).input_limits.flatten().tolist() == pytest.approx(limits)


@pytest.mark.parametrize(
    ("low", "high", "rest", "reach"),
    [
        (20, 60, 0, (20, 60)),
        (-12, 11, 0, (-12, 12)),
        (-30, 70, 0, (-30, 70)),
        (0, 255, 0, (0, 255)),
        (-9, -3, 0, (-9, -3)),
        (60, 80, 60, (60, 80)),  # so far from zero that zero says nothing
    ],
)
def test_a_log_alone_tells_the_range_that_an_input_used(tmp_path, low, high, rest, reach):
    """Zero stays zero, and inputs within what the log has tried."""
    values = levels(low, high)
    path = written(tmp_path / "log.csv", values)
    found = LoggedData(path, inputs=["valve"]).recording(None)
    one = max(abs(end - rest) for end in reach)
    assert found.signature.input_ends == ((rest - one, rest + one),)
    assert rest + one * found.transitions.u[:, 0].numpy() == pytest.approx(values[:-1])
    limits = (found.signature.input_limits or ((-1, 1),))[0]
    assert [rest + one * limit for limit in limits] == pytest.approx(reach)
    given = found.findings[2].values["inputs"]
    assert found.findings[2] == note("log.guessed_ends", inputs=given)
    # An actuator that rests at zero reaches zero, whether the log has tried it or not.
    assert (given["valve"]["low"], given["valve"]["high"]) == (min(*reach, rest), max(*reach, rest))
    again = LoggedData(path, inputs=given).recording(None)
    assert again.signature.input_ends == found.signature.input_ends
    assert torch.equal(again.transitions.u, found.transitions.u)


@pytest.mark.parametrize(("low", "high", "ends"), [(0.05, 0.6, (0, 1)), (-0.9, 0.0, (-1, 0))])
def test_an_input_within_one_that_never_leaves_one_side_is_asked_about(tmp_path, low, high, ends):
    path = written(tmp_path / "log.csv", levels(low, high), "valve")
    found = LoggedData(path, inputs=["valve"]).recording(None)
    assert found.signature.input_ends == () == found.signature.input_limits
    named = {"valve": {"name": "valve", "low": ends[0], "high": ends[1]}}
    assert found.findings[1:] == (note("log.one_sided", input="valve", least=low, most=high, inputs=named),)


@pytest.mark.parametrize(("most", "small"), [(0.04, True), (0.06, False)])
def test_an_input_that_hardly_moved_asks_for_its_ends(tmp_path, most, small):
    """A plan would use all of -1 to 1, of which 0.08 is less than a twentieth."""
    path = written(tmp_path / "log.csv", levels(-most, most))
    found = LoggedData(path, inputs=["valve"]).recording(None)
    assert [each.severity for each in found.findings if each.code == "log.hardly_moved"] == ["weak"] * small
    if small:
        again = LoggedData(path, inputs=found.findings[1].values["inputs"]).recording(None)
        assert np.abs(again.transitions.u.numpy()).max() == pytest.approx(1.0)
        assert "log.hardly_moved" not in [each.code for each in again.findings]


def test_ends_of_minus_one_and_one_keep_the_numbers(tmp_path):
    values = levels(-12.0, 12.0)
    kept = {"valve": {"name": "valve", "low": -1, "high": 1}}
    found = LoggedData(written(tmp_path / "log.csv", values), inputs=kept).recording(None)
    assert np.array_equal(found.transitions.u[:, 0].numpy(), values[:-1])
    assert found.findings[1:] == (weak("log.beyond_ends", input="valve", least=-12, most=12),)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (5, 100.5), (0, 99.9)])
def test_ends_that_the_column_goes_beyond_are_refused(tmp_path, low, high):
    path = written(tmp_path / "log.csv", levels(0.0, 100.0))
    log = LogReader(path, {"level": "level"}, {"valve": {"name": "valve", "low": low, "high": high}})
    with pytest.raises(LogError) as error:
        log.recording()
    ends = {"input": "valve", "low": low, "high": high, "least": 0, "most": 100}
    assert error.value.finding == wrong("log.input_ends", file=path, **ends)


PLANT = BlackBox({"level": "m"}, {"valve": {"low": 4, "high": 20, "unit": "mA"}}).signature


@pytest.mark.parametrize(("heading", "given"), [("valve [mA]", "valve"), ("valve", "valve"), ("i [A]", "scaled")])
def test_a_plant_that_is_known_by_names_says_the_ends_of_its_actuators(tmp_path, heading, given):
    """Of 4 to 20 mA a quarter is 8 mA, in whatever part of it the log lies."""
    values = levels(6.0, 12.0)
    inputs = None if given == "valve" else {"valve": {"name": "i", "unit": "mA", "scale": 1000.0}}
    path = written(tmp_path / "log.csv", values if inputs is None else values / 1000, heading)
    found = LoggedData(path, inputs=inputs).recording(PLANT)
    assert found.transitions.u[:, 0].numpy() == pytest.approx((values[:-1] - 4) / 16)
    assert found.signature.input_ends == ((-12.0, 20.0),) and found.signature.input_limits == ((0.0, 1.0),)
    assert found.signature.input_units == ("mA",)


def test_the_numbers_that_a_rig_has_logged_stay_what_they_are(tmp_path):
    values = levels(0.1, 0.5)
    found = LoggedData(written(tmp_path / "log.csv", values, "valve [-]")).recording(PLANT)
    assert np.array_equal(found.transitions.u[:, 0].numpy(), values[:-1])
    assert found.signature.in_own_units(found.transitions.u)[:, 0] == pytest.approx(4 + 16 * values[:-1])
    assert [each.code for each in found.findings] == ["log.time"]  # none on the input's ends


@pytest.mark.parametrize(
    ("heading", "given", "message"),
    [
        (
            "valve [mA]",
            {"low": 0, "high": 20},
            "from 0 to 20 and rests at 0 in data.inputs, and from 4 to 20 and at 4 in",
        ),
        ("valve [A]", {}, "is in A in the log, and in mA in system.inputs; give the factor from one to the other"),
        ("valve [mA]", {"scale": 2.0}, "was given low 4 and high 20, its column goes from 12 to 24"),
    ],
)
def test_a_log_that_contradicts_its_plant_is_refused(tmp_path, heading, given, message):
    path = written(tmp_path / "log.csv", levels(6.0, 12.0), heading)
    with pytest.raises(ValueError, match=message):
        LoggedData(path, inputs={"valve": {"name": "valve", **given}}).recording(PLANT)
