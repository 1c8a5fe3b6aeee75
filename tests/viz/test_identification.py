"""Identification figures: what they draw into panels."""

import numpy as np

from dynasindy.systems import Pendulum
from dynasindy.viz.identification import prediction, training_data

TIME = np.arange(100) * 0.01
STATES = np.linspace(0, 1, 100)[:, None] * np.array([1.0, 2.0, 3.0, 4.0, 1000.0, 2000.0])
STILL = np.zeros((100, 2))
PENDULUM = Pendulum().signature


def rmse(axis) -> float:
    """Return the error that stands above a panel [%]."""
    return float(axis.get_title(loc="right").removeprefix("RMSE ").split()[0])


def at(axis, style: str) -> list[float]:
    """Return where lines of a style are drawn across a panel."""
    return [line.get_xdata()[0] for line in axis.lines if line.get_linestyle() == style]


def test_predictions_have_the_error_in_percent_of_the_range() -> None:
    axes = prediction(TIME, STATES, STATES + np.array([0.1, 0, 0, 0, 0, 0])).axes
    assert [rmse(axis) for axis in axes] == [10.0] + [0.0] * 5
    assert axes[4].get_ylabel().endswith("[rpm]")


def test_a_prediction_ends_where_it_is_lost_and_does_not_flatten_the_plant() -> None:
    wild = STATES.copy()
    wild[60, 0], wild[60, 1] = 20.0, 9.0  # ranges 1 and 2: ten ranges off are lost, four come back
    wild[50:, 2], wild[50:, 3] = 1e30, np.nan
    axes = prediction(TIME, STATES, wild).axes
    drawn = [axis.lines[1].get_ydata() for axis in axes]
    assert np.isnan(drawn[0]).tolist() == [False] * 60 + [True] * 40
    assert not np.isnan(drawn[1]).any()
    assert [np.isnan(one).tolist() for one in drawn[2:4]] == [[False] * 50 + [True] * 50] * 2
    assert axes[2].get_ylim()[1] < 6 and "runs away" in axes[3].get_title(loc="right")


def test_lost_samples_of_a_log_end_no_prediction() -> None:
    lost = STATES.copy()
    lost[40:43, 0] = np.nan
    axis = prediction(TIME, lost, STATES).axes[0]
    assert np.isfinite(axis.lines[1].get_ydata()).all() and rmse(axis) == 0.0
    assert axis.get_ylim() == prediction(TIME, STATES, STATES).axes[0].get_ylim()


def test_a_state_that_nobody_measured_has_no_panel_of_its_prediction() -> None:
    unseen = STATES.copy()
    unseen[:, 2] = np.nan
    axes = prediction(TIME, unseen, STATES + np.array([0.1, 0, 0, 0, 0, 0])).axes
    assert [rmse(axis) for axis in axes] == [10.0] + [0.0] * 4
    assert [axis.get_ylabel() for axis in axes[2:]] == [
        axis.get_ylabel() for axis in prediction(TIME, STATES, STATES).axes[3:]
    ]


def test_training_data_draw_their_columns_and_inputs_to_the_end_of_the_last_period() -> None:
    u = np.stack([np.sin(TIME), np.cos(TIME)], -1)
    *states, _, axis = training_data(TIME, STATES, u).axes
    for k, each in enumerate(states):
        np.testing.assert_array_equal(each.lines[0].get_ydata(), STATES[:, k])
    np.testing.assert_array_equal(axis.lines[0].get_ydata(), [*u[:, 1], u[-1, 1]])
    assert axis.lines[0].get_xdata()[-1] == axis.get_xlim()[1] == 1.0
    assert axis.lines[0].get_drawstyle() == "steps-post" and axis.get_ylim() == (-1.08, 1.08)


def test_lines_break_between_stretches_of_a_log_and_gaps_are_marked_unless_they_are_everywhere() -> None:
    segment = np.repeat([0, 1, 4], [30, 50, 20])
    axis = training_data(TIME, STATES, STILL, segment=segment).axes[0]
    drawn = axis.lines[0].get_ydata()
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(drawn)), [30, 81])
    np.testing.assert_array_equal(drawn[~np.isnan(drawn)], STATES[:, 0])
    assert at(axis, ":") == [TIME[30], TIME[80]]
    assert not at(training_data(TIME, STATES, STILL, segment=np.arange(100)).axes[0], ":")
    axes = prediction(TIME, STATES, STATES, segment=segment).axes
    assert [int(np.isnan(line.get_ydata()).sum()) for line in axes[3].lines[:2]] == [2, 2] and rmse(axes[0]) == 0.0
    assert "gaps" in axes[-1].get_xlabel()


def test_where_an_excitation_began_anew_is_marked_and_lost_samples_of_a_log_are_not() -> None:
    x, u = STATES[:, :2].copy(), np.zeros((100, 1))
    x[40] = u[40] = np.nan
    for axis in training_data(TIME, x, u, PENDULUM).axes:
        assert at(axis, "--") == [TIME[40]]
    # Of two states one has no sensor and the other loses every third sample: 34 rows hold no number.
    lost = np.full((100, 2), np.nan)
    lost[:, 0] = np.where(np.arange(100) % 3, STATES[:, 0], np.nan)
    for segment in (None, np.zeros(100)):
        figure = training_data(TIME, lost, np.zeros((100, 1)), PENDULUM, segment=segment)
        assert not [place for axis in figure.axes for place in at(axis, "--")]
