import numpy as np
import pytest

from dynasindy.viz.gate import gate


def test_closed_episodes_are_shaded_and_rolled_back_refits_are_marked():
    figure = gate(
        {
            "episode": [1, 2, 3],
            "reward_error": [0.1, 0.9, 0.2],
            "judged_reward_error": [0.01, 0.6, 0.02],
            "open_below": [0.3] * 3,
            "close_above": [0.5] * 3,
            "open": [1, 0, 1],
            "held_out_error_before": [np.nan, 0.2, 0.1],
            "held_out_error_after": [np.nan, 0.1, 0.4],
            "refit_kept": [np.nan, 1, 0],
        }
    )
    upper, lower = figure.axes
    (shade,) = upper.patches
    assert shade.get_x() == 1.5 and shade.get_width() == 1.0
    crosses = next(line for line in lower.lines if line.get_label() == "rolled back")
    assert crosses.get_xydata().tolist() == [[3.0, 0.4]]
    assert lower.get_ylim() == pytest.approx((0.05, 0.5))
    assert upper.get_ylim() == pytest.approx((0.005, 1.0))


def test_where_the_model_ran_away_there_is_a_mark_at_the_upper_edge():
    decisions = {"episode": [1, 2, 3, 4], "reward_error": [0.4, np.inf, np.nan, 0.4], "open": [1] * 4}
    decisions |= {"judged_reward_error": [0.1, np.nan, 0.1, np.inf], "open_below": [0.3] * 4, "close_above": [0.5] * 4}
    tests = {"held_out_error_before": [1.0] * 4, "held_out_error_after": [1.0] * 4, "refit_kept": [1] * 4}
    upper, lower = gate(decisions | tests).axes
    marks = [line for line in upper.lines if line.get_marker() == "^"]
    # Where no planning was due nothing was judged: that is no flight.
    assert [line.get_xdata().tolist() for line in marks] == [[2.0, 3.0], [4.0]]
    assert {height for line in marks for height in line.get_ydata()} == {upper.get_ylim()[1]}
    assert not [line for line in lower.lines if line.get_marker() == "^"]


def single(**changed):
    names = ("reward_error", "judged_reward_error", "open_below", "close_above", "open")
    values = {name: [0.03] for name in names} | {"open_below": [0.05], "close_above": [0.1], "episode": [1]}
    refit = {"held_out_error_before": [np.nan], "held_out_error_after": [0.0123], "refit_kept": [1]}
    return gate(values | refit | {name: [value] for name, value in changed.items()}).axes


def test_a_single_episode_has_a_line_for_each_figure():
    upper, lower = single(judged_reward_error=0.02)
    dots = [line.get_xydata().tolist()[0] for line in upper.lines if line.get_marker() == "o"]
    assert dots == [[0.03, 0.0], [0.02, 1.0]]
    bounds = {line.get_label(): line.get_xdata()[0] for line in upper.lines if line.get_linestyle() != "-"}
    assert {name: bounds[name] for name in ("trusted below 0.05", "no longer trusted above 0.1")} == {
        "trusted below 0.05": 0.05,
        "no longer trusted above 0.1": 0.1,
    }
    assert [text.get_text() for axis in (upper, lower) for text in axis.texts] == ["0.03", "0.02", "0.0123"]


def test_a_single_episode_shows_its_windows_beneath_what_sums_them_up():
    names = ("reward_error", "judged_reward_error", "open_below", "close_above", "open", "episode")
    columns = dict(zip(names, ([0.03], [0.02], [0.05], [0.1], [1], [1])))
    columns |= {"held_out_error_before": [0.01], "held_out_error_after": [0.02]}
    windows = {"time": [1.0, 2.0, 3.0], "reward_error": [0.003, 0.04, 0.5], "state_error": [0.001, 0.02, np.inf]}
    for kept, height in ((1, 1.3), (0, 0.3)):  # beneath the model that stays
        upper, lower = gate(columns | {"refit_kept": [kept]}, windows=windows).axes
        judged, states = (axis.lines[0].get_xydata() for axis in (upper, lower))
        assert judged.tolist() == [[0.003, 1.3], [0.04, 1.3], [0.5, 1.3]]
        assert states.tolist() == [[0.001, height], [0.02, height]]
        assert upper.get_xlim()[0] < 0.003 and upper.get_xlim()[1] > 0.5
