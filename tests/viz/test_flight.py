"""The figure of a rig's flight: as long as planned, with what ended it and where."""

from dataclasses import replace

import numpy as np
import pytest

from dynasindy.rig import Guard, Wiring
from dynasindy.rig.log import FlightRecord
from dynasindy.systems import Signature
from dynasindy.viz.flight import draw_flight, draw_rig_excitation

SIGNATURE = Signature(("theta", "level"), ("rad", "m"), ("u",), (1.0, 1.0))
WIRING = Wiring(SIGNATURE, (True, False), 0.1)
TIME = 0.1 * np.arange(5)
OUTPUTS = np.stack([np.linspace(0.0, 0.4, 5), np.full(5, np.nan)], -1)
ENDED = FlightRecord(
    ("theta", "level"), ("rad", "m"), TIME, np.tile([0.3, 0.5], (5, 1)), OUTPUTS, np.full((5, 1), 0.2),
    np.ones(5, dtype=bool), 20, "range: theta is 0.5, outside of -0.45 to 0.45",
)  # fmt: skip


def test_a_flight_that_ended_early_says_when_and_why_on_the_time_that_was_planned() -> None:
    figure = draw_flight(ENDED, WIRING, Guard(), "flight_1")
    assert ENDED.fault in " ".join(figure.get_suptitle().split())
    for axis in figure.axes:
        assert axis.lines[-1].get_xdata() == pytest.approx([0.5, 0.5])
    low, high = figure.axes[-1].get_xlim()
    assert low == 0.0 and 2.0 <= high < 2.1


def test_a_flight_that_did_not_end_early_has_no_line_for_it() -> None:
    figure = draw_flight(replace(ENDED, fault="", planned=5), WIRING, Guard(), "flight_1")
    assert len(figure.axes[0].lines) == 2
    assert figure.axes[-1].get_xlim() == (0.0, 0.5)


def test_the_range_of_the_guard_is_drawn_where_it_is_near() -> None:
    figure = draw_flight(ENDED, WIRING, Guard(low={"theta": -5.0}, high={"theta": 0.45}), "flight_1")
    lines = [line for line in figure.axes[0].lines if line.get_linestyle() == "-." and len(line.get_xdata())]
    levels = [line.get_ydata()[0] for line in lines]
    assert levels == [0.45]


def test_an_excitation_shows_what_was_measured_and_the_range_that_ended_it() -> None:
    guard = Guard(low={"theta": -5.0, "level": 0.1}, high={"theta": 0.45})
    figure = draw_rig_excitation(
        (TIME, OUTPUTS, np.full((5, 1), 0.2)), WIRING, guard, "Excitation of the rig, ended by range"
    )
    theta, u = figure.axes
    np.testing.assert_allclose(theta.lines[0].get_ydata(), OUTPUTS[:, 0])
    lines = [
        [line for line in axis.lines if line.get_linestyle() == "-." and len(line.get_xdata())] for axis in (theta, u)
    ]
    assert [[line.get_ydata()[0] for line in found] for found in lines] == [[0.45], []]
    assert (
        draw_rig_excitation((TIME, OUTPUTS, np.full((5, 1), 0.2)), WIRING, Guard(), "Excitation").axes[0].get_legend()
        is None
    )


def test_targets_are_drawn_as_they_are_held() -> None:
    targets = np.tile([[0.3, 0.5]], (5, 1))
    targets[3:] = -0.3
    axis = draw_flight(replace(ENDED, references=targets), WIRING, Guard(), "flight_1").axes[0]
    (line,) = [line for line in axis.lines if line.get_label() == "reference"]
    assert line.get_drawstyle() == "steps-post"


def test_samples_between_lost_ones_are_drawn_as_points() -> None:
    """The second and the fourth of five samples were lost, so that no two of them make a line."""
    outputs = OUTPUTS.copy()
    outputs[[1, 3]] = np.nan
    axis = draw_flight(replace(ENDED, outputs=outputs), WIRING, Guard(), "flight_1").axes[0]
    drawn = [line for line in axis.lines if line.get_marker() == "."]
    assert drawn[0].get_xdata() == pytest.approx([0.0, 0.2, 0.4])
    assert drawn[0].get_color() == axis.lines[1].get_color()
    whole = draw_flight(ENDED, WIRING, Guard(), "flight_1").axes[0]
    assert not [line for line in whole.lines if line.get_marker() == "."]
