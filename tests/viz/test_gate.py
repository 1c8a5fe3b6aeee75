import numpy as np

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
