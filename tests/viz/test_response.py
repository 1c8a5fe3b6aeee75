"""Response figures draw the data they are given, with the bands the metrics use."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz import error_fan, step_response, tracking

TIME = torch.arange(400) * 0.05
REFERENCE = torch.tensor([0.4, 0.25]).expand(400, 2)
OUTPUT = REFERENCE * (1 - torch.exp(-TIME)).unsqueeze(-1)


def test_tracking_draws_reference_and_every_controller() -> None:
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT, "b": 0.5 * OUTPUT}, {"a": OUTPUT, "b": -OUTPUT})
    assert [a.get_ylabel().split(" [")[1] for a in figure.axes] == ["rad]", "rad]", "-]", "-]"]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    lines = figure.axes[1].lines
    np.testing.assert_allclose(lines[0].get_ydata(), 0.25)
    np.testing.assert_allclose(lines[2].get_ydata(), 0.5 * OUTPUT[:, 1], rtol=1e-6)
    assert [t.get_text() for t in figure.axes[0].get_legend().get_texts()] == ["reference", "a", "b"]


def test_the_state_after_the_last_period_is_drawn_at_its_end() -> None:
    longer = [torch.cat([rows, rows[-1:] + 0.01]) for rows in (REFERENCE, OUTPUT)]
    (reference, output) = tracking(TIME, longer[0], {"a": longer[1]}, {"a": OUTPUT}).axes[0].lines
    for line, rows in ((reference, longer[0]), (output, longer[1])):
        assert len(line.get_xdata()) == 401 and line.get_xdata()[-1] == 20.0
        assert line.get_ydata()[-1] == pytest.approx(float(rows[-1, 0]))


def test_inputs_are_drawn_as_held() -> None:
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT}, {"a": OUTPUT})
    (line,) = figure.axes[2].lines
    assert line.get_drawstyle() == "steps-post"
    np.testing.assert_allclose(line.get_xydata()[-2:, 0], [19.95, 20.0], rtol=1e-6)
    assert line.get_ydata()[-1] == line.get_ydata()[-2]


def test_step_response_shows_the_five_percent_band_and_the_last_five_seconds() -> None:
    figure = step_response(TIME, REFERENCE, {"a": OUTPUT})
    band, steady = figure.axes[0].patches
    assert (band.get_y(), band.get_height()) == pytest.approx((0.38, 0.04))
    assert (steady.get_x(), steady.get_width()) == pytest.approx((15.0, 5.0))


def test_error_fan_draws_the_median_of_the_absolute_error() -> None:
    outputs = REFERENCE + torch.tensor([-0.3, 0.1, 0.2]).reshape(3, 1, 1)
    figure = error_fan(TIME, outputs, REFERENCE.expand(3, 400, 2))
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 0.2, rtol=1e-5)
    assert figure.axes[0].get_yscale() == "log"


def test_small_errors_are_drawn_as_they_are_and_no_curve_lies_on_the_frame() -> None:
    """Four rows whose errors are 1e-6 to 4e-6 rad, of which the first one is exact from the middle on."""
    errors = 1e-6 * torch.arange(1.0, 5.0).reshape(4, 1, 1).repeat(1, 400, 2).double()
    errors[0, 200:] = 0.0
    figure = error_fan(TIME, REFERENCE.double() + errors, REFERENCE.double().expand(4, 400, 2))
    axis = figure.axes[0]
    median = np.asarray(axis.lines[0].get_ydata())
    np.testing.assert_allclose(median, 2.5e-6, rtol=1e-3)
    outer, inner = (fill.get_paths()[0].vertices[:, 1] for fill in axis.collections)
    assert inner.min() > 1.05 * axis.get_ylim()[0], "the middle half is inside"
    assert np.ptp(outer[outer < 1.5e-6]) > 0  # not on one floor


def test_the_time_axis_ends_with_the_last_period_of_the_run():
    time, zeros = np.arange(0.0, 20.0, 0.05), np.zeros((400, 2))
    assert tracking(time, zeros, {"policy": zeros}).axes[-1].get_xlim() == (0.0, 20.0)


def test_inputs_are_drawn_in_the_units_of_their_actuators() -> None:
    """A motor of 0 to 12 V at the quarter of its power has 3 V."""
    volts = replace(SIGNATURE, input_ends=((-12, 12), (-1, 1)), input_limits=((0, 1), (-1, 1)), input_units=("V", "-"))
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT}, {"a": 0.25 * np.ones_like(OUTPUT)}, signature=volts)
    assert [float(axis.lines[0].get_ydata()[0]) for axis in figure.axes[2:]] == [3.0, 0.25]
    assert ["[V]" in axis.get_ylabel() for axis in figure.axes] == [False, False, True, False]
