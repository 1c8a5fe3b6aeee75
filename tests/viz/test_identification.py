"""Identification figures: what they write into panels and tables."""

from dataclasses import replace

import numpy as np
import pytest

from dynasindy.systems import Pendulum, Tras
from dynasindy.viz import coefficient_table, excitation, model_error, prediction, training_data
from dynasindy.viz.identification import growing_error

TIME = np.arange(100) * 0.01
STATES = np.linspace(0, 1, 100)[:, None] * np.array([1.0, 2.0, 3.0, 4.0, 1000.0, 2000.0])


def test_prediction_titles_say_the_error_in_percent_of_the_range() -> None:
    figure = prediction(TIME, STATES, STATES + np.array([0.1, 0, 0, 0, 0, 0]))
    titles = [axis.get_title(loc="right") for axis in figure.axes]
    assert titles[0].startswith("RMSE 10 %") and " 0.001 %" in titles[5]
    assert figure.axes[4].get_ylabel().endswith("[rpm]")


def test_a_model_that_runs_away_is_said_and_does_not_flatten_the_plant() -> None:
    wild = STATES.copy()
    wild[50:, 0] = 1e30
    wild[50:, 1] = np.nan
    figure = prediction(TIME, STATES, wild)
    assert figure.axes[0].get_ylim()[1] < 2


def test_a_state_that_nobody_measured_is_drawn_as_far_as_its_range() -> None:
    unseen, wild = STATES.copy(), STATES.copy()
    unseen[:, 2] = np.nan
    scale = Tras().signature.x_scale[2]
    wild[:, 2] = 0.1 * scale * np.sin(6 * TIME)
    quiet = prediction(TIME, unseen, wild).axes[2]
    assert quiet.get_ylim()[1] < 0.2 * scale  # what stays within its range fills the panel
    wild[50:, 2] = 1e283
    axis = prediction(TIME, unseen, wild).axes[2]
    assert axis.get_ylim()[1] < 10 * scale and np.isnan(axis.lines[1].get_ydata()[50:]).all()
    wild[50:, 2] = 15 * scale
    assert prediction(TIME, unseen, wild).axes[2].get_ylim()[1] == pytest.approx(2.2 * scale)


def test_training_data_and_excitation_draw_their_columns() -> None:
    figure = training_data(TIME, STATES)
    for k, axis in enumerate(figure.axes):
        np.testing.assert_array_equal(axis.lines[0].get_ydata(), STATES[:, k])
    u = np.stack([np.sin(TIME), np.cos(TIME)], -1)
    figure = excitation(TIME, u)
    np.testing.assert_array_equal(figure.axes[1].lines[0].get_ydata(), [*u[:, 1], u[-1, 1]])
    # The last input is held for its period, to the end of the second.
    assert figure.axes[1].lines[0].get_xdata()[-1] == figure.axes[1].get_xlim()[1] == 1.0


def test_one_state_gets_one_panel() -> None:
    figure = training_data(TIME, STATES[:, :2], signature=Pendulum().signature)
    assert len(figure.axes) == 2
    assert figure.axes[0].get_ylabel() == r"$\theta$ [rad]"


def test_a_rate_that_nobody_measured_has_no_empty_panel_and_is_named() -> None:
    x = np.stack([STATES[:, 0], np.full(100, np.nan)], -1)
    figure = training_data(TIME, x, STATES[:, 2:3], Pendulum().signature)
    assert [axis.get_ylabel() for axis in figure.axes] == [r"$\theta$ [rad]", "$u$ [-]"]
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), STATES[:, 0])


def test_model_error_is_the_median_on_a_log_axis_with_refits() -> None:
    errors = np.array([[1.0, 3.0, 100.0], [0.1, 0.2, 0.3]])
    figure = model_error([1, 2], errors, refits=[1.5])
    axis = figure.axes[0]
    np.testing.assert_allclose(axis.lines[0].get_ydata(), [3.0, 0.2])
    assert axis.get_yscale() == "log"
    assert axis.lines[1].get_xdata()[0] == 1.5


def test_the_thresholds_of_the_models_error_are_drawn_and_named() -> None:
    (axis,) = model_error([1, 2], [0.3, 0.1], thresholds={"opens below": 0.05, "closes above": 0.2}).axes
    levels = {line.get_label(): line.get_ydata()[0] for line in axis.lines[1:]}
    assert levels == {"opens below 0.05": 0.05, "closes above 0.2": 0.2}
    assert [text.get_text() for text in axis.get_legend().get_texts()] == list(levels)


def test_the_table_holds_the_used_features_only() -> None:
    coefficients = np.zeros((3, 2))
    coefficients[0, 1], coefficients[2, 0] = -9.81, 1.0
    figure = coefficient_table(coefficients, ["1", "theta", "Omega"], ["theta", "Omega"])
    cells = {place: cell.get_text().get_text() for place, cell in figure.axes[0].tables[0].get_celld().items()}
    assert [cells[k, -1] for k in (1, 2)] == ["1", "Omega"]
    assert [cells[1, 0], cells[1, 1], cells[2, 0], cells[2, 1]] == ["", "-9.81", "1", ""]


def test_lines_break_between_stretches_of_a_log() -> None:
    segment = np.repeat([0, 1, 4], [30, 50, 20])
    drawn = training_data(TIME, STATES, segment=segment).axes[0].lines[0].get_ydata()
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(drawn)), [30, 81])
    np.testing.assert_array_equal(drawn[~np.isnan(drawn)], STATES[:, 0])
    figure = prediction(TIME, STATES, STATES, segment=segment)
    assert [int(np.isnan(line.get_ydata()).sum()) for line in figure.axes[3].lines[:2]] == [2, 2]
    assert figure.axes[0].get_title(loc="right").startswith("RMSE below 0.001 %")
    assert figure.axes[-1].get_xlabel() == "time without the gaps [s]"


def test_the_error_of_a_prediction_is_drawn_over_time_and_never_at_zero() -> None:
    (axis,) = growing_error([0.0, 0.5, 1.0], [0.0, 0.1, 0.4]).axes
    line, mark = axis.lines
    np.testing.assert_array_equal(line.get_ydata(), [np.nan, 0.1, 0.4])
    assert mark.get_xydata().tolist() == [[0.0, 0.05]] and mark.get_marker() == "v"
    assert axis.get_yscale() == "log" and axis.get_xlim() == (0.0, 1.0)
    assert axis.get_ylim()[0] > 1e-3  # and not twelve decades below the errors


def test_an_error_that_is_tiny_is_drawn_as_it_is_and_one_that_is_zero_is_said_to_be() -> None:
    (axis,) = model_error([1, 2, 3], [1e-14, 0.0, 3e-13]).axes
    np.testing.assert_array_equal(axis.lines[0].get_ydata(), [1e-14, np.nan, 3e-13])
    assert axis.lines[1].get_xydata().tolist() == [[2.0, 5e-15]]


def test_training_data_show_the_inputs_as_they_are_held_and_what_the_fit_leaves_out() -> None:
    u = np.where(TIME < 0.5, -0.5, 0.5)[:, None]
    figure = training_data(TIME, STATES[:, :2], u, Pendulum().signature, left_out=[[0.2, 0.3]])
    (line,) = figure.axes[2].lines
    assert line.get_drawstyle() == "steps-post" and figure.axes[2].get_ylim() == (-1.08, 1.08)
    np.testing.assert_array_equal(line.get_ydata(), [*u[:, 0], 0.5])
    for axis in figure.axes:
        (shade,) = axis.patches
        assert (shade.get_x(), round(shade.get_width(), 9)) == (0.2, 0.1)


def test_where_an_excitation_began_anew_is_marked_in_every_panel() -> None:
    x, u = STATES[:, :2].copy(), np.zeros((100, 1))
    x[40] = u[40] = np.nan
    figure = training_data(TIME, x, u, Pendulum().signature)
    for axis in (*figure.axes, *excitation(TIME, u, Pendulum().signature).axes):
        assert [line.get_xdata()[0] for line in axis.lines if line.get_linestyle() == "--"] == [TIME[40]]


def test_lost_samples_of_a_log_are_no_restarts() -> None:
    """Of two states one has no sensor and the other loses every third sample: 34 rows hold no number."""
    x = np.full((100, 2), np.nan)
    x[:, 0] = np.where(np.arange(100) % 3, STATES[:, 0], np.nan)
    for u in (np.zeros((100, 1)), None):
        for segment in (None, np.zeros(100)):
            figure = training_data(TIME, x, u, Pendulum().signature, segment=segment)
            assert not [line for axis in figure.axes for line in axis.lines if line.get_linestyle() == "--"]


def test_gaps_of_a_log_are_marked_unless_they_are_everywhere() -> None:
    figure = training_data(TIME, STATES, segment=np.repeat([0, 1, 4], [30, 50, 20]))
    assert [line.get_xdata()[0] for line in figure.axes[5].lines[1:]] == [TIME[30], TIME[80]]
    assert len(training_data(TIME, STATES, segment=np.arange(100)).axes[5].lines) == 1


def test_a_prediction_ends_where_it_is_lost() -> None:
    wild = STATES.copy()
    wild[60, 0], wild[60, 1] = 20.0, 9.0  # ranges 1 and 2: ten ranges off are lost, four come back
    drawn = [axis.lines[1].get_ydata() for axis in prediction(TIME, STATES, wild).axes]
    assert np.isnan(drawn[0]).tolist() == [False] * 60 + [True] * 40
    assert not np.isnan(drawn[1]).any()


def test_lost_samples_of_a_log_end_no_prediction() -> None:
    lost = STATES.copy()
    lost[40:43, 0] = np.nan
    axis = prediction(TIME, lost, STATES).axes[0]
    assert np.isfinite(axis.lines[1].get_ydata()).all() and axis.get_title(loc="right").startswith("RMSE below 0.001 %")
    assert axis.get_ylim() == prediction(TIME, STATES, STATES).axes[0].get_ylim()


def test_a_log_in_volts_is_drawn_in_volts() -> None:
    volts = replace(Pendulum().signature, input_ends=((-12, 12),), input_limits=((0, 1),), input_units=("V",))
    u = np.linspace(0, 1, 100)[:, None]
    for figure in (training_data(TIME, STATES[:, :2], u, volts), excitation(TIME, u, volts)):
        axis = figure.axes[-1]
        assert axis.lines[0].get_ydata()[:100] == pytest.approx(12 * u[:, 0])
        assert axis.get_ylabel() == "$u$ [V]" and axis.get_ylim() == pytest.approx((-0.48, 12.48))
