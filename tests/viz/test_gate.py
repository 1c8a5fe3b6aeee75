"""The error of the model over episodes, and what the gate decides by it."""

import numpy as np
import pandas as pd

from dynasindy.viz.run import gate

DECISIONS = {
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


def test_closed_episodes_are_shaded_and_rolled_back_refits_are_marked():
    upper, lower = gate(pd.DataFrame(DECISIONS)).axes
    (shade,) = upper.patches
    assert shade.get_x() == 1.5 and shade.get_width() == 1.0
    rings = next(line for line in lower.lines if line.get_label() == "rolled back")
    assert rings.get_xydata().tolist() == [[3.0, 0.4]]
    (low, high), (least, most) = lower.get_ylim(), upper.get_ylim()
    assert low < 0.1 and high > 0.4 and least < 0.01 and most > 0.9


def test_where_the_model_ran_away_there_is_a_mark_at_the_upper_edge():
    errors = {"reward_error": [np.inf, np.nan, 0.4], "judged_reward_error": [np.nan, 0.1, np.inf]}
    upper, lower = gate(pd.DataFrame(DECISIONS | errors)).axes
    marks = [line for line in upper.lines if line.get_marker() == "^"]
    # Where no planning was due nothing was judged: that is no flight.
    assert [line.get_xdata().tolist() for line in marks] == [[1.0, 2.0], [3.0]]
    assert {height for line in marks for height in line.get_ydata()} == {upper.get_ylim()[1]}
    assert not [line for line in lower.lines if line.get_marker() == "^"]
