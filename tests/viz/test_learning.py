"""Learning figures: the statistics they draw against hand-computed ones."""

import numpy as np

from dynasindy.viz import average_rewards, learning_curve
from dynasindy.viz.learning import moving_mean


def test_moving_mean_by_hand() -> None:
    np.testing.assert_allclose(moving_mean(np.array([2.0, 4.0, 9.0, 2.0]), 2), [2.0, 3.0, 6.5, 5.5])


def test_learning_curve_draws_episodes_and_evaluations() -> None:
    returns = np.arange(30.0)
    figure = learning_curve(np.arange(1, 31), returns, [10, 20], [12.0, 22.0], window=5)
    raw, mean, evaluated = figure.axes[0].lines
    np.testing.assert_array_equal(raw.get_ydata(), returns)
    assert mean.get_ydata()[-1] == 27.0
    np.testing.assert_array_equal(evaluated.get_xydata(), [[10, 12.0], [20, 22.0]])


def test_average_rewards_draw_the_interquartile_mean_within_its_band() -> None:
    one = np.array([[0.0], [10.0], [20.0], [1000.0]]) + np.zeros((4, 6))
    figure = average_rewards({"wild": one, "calm": np.ones((3, 6))}, window=1)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 15.0)
    low, high = (f(figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]) for f in (np.min, np.max))
    assert 0 <= low <= 15 <= high <= 1000
    assert "(4 seeds)" in figure.axes[0].get_legend().get_texts()[0].get_text()
    axis = figure.axes[0]
    assert len(axis.collections) == 2  # three seeds have a band, too


def test_a_logarithmic_axis_is_for_returns_that_differ_much_and_says_so() -> None:
    def axis(low: float):
        return average_rewards({"a": [[low, -1000.0]]}, window=1, log=True).axes[0]

    assert axis(-100.0).get_yscale() == "linear"
    assert axis(-20.0).get_yscale() == axis(5.0).get_yscale() == "symlog"
    assert axis(-20.0).get_ylabel() == "return, logarithmic beyond 10 [-]"


def test_fewer_than_three_seeds_are_lines_without_a_band() -> None:
    two = np.array([np.arange(5.0), 2 * np.arange(5.0)])
    (axis,) = average_rewards({"one": two[0], "two": two}, episode=[10, 20, 30, 40, 50], window=1).axes
    np.testing.assert_array_equal(axis.lines[0].get_xydata()[:, 0], [10, 20, 30, 40, 50])
    np.testing.assert_array_equal([line.get_ydata() for line in axis.lines], [two[0], *two])
    assert not axis.collections
    assert axis.lines[1].get_color() == axis.lines[2].get_color() != axis.lines[0].get_color()
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["one (1 seed)", "two (2 seeds)"]


def test_of_a_single_episode_there_are_dots_and_intervals_to_be_seen() -> None:
    (axis,) = average_rewards({"few": [[1.0], [2.0]], "many": [[1.0], [2.0], [6.0]]}, window=1).axes
    shown = [line for line in axis.lines if line.get_visible() and len(line.get_xdata())]
    assert [line.get_ydata()[0] for line in shown] == [1.0, 2.0, 3.0]  # of three seeds the mean, as none is trimmed
    assert {line.get_marker() for line in shown} == {"o"}
    (interval,) = axis.collections[-1].get_segments()
    assert 1.0 <= interval[0][1] < interval[1][1] <= 6.0
