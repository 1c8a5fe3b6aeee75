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
    assert lower.get_ylim() == (0.1, 1.0)


def test_a_single_episode_has_its_thresholds_and_its_figure_in_words():
    names = ("reward_error", "judged_reward_error", "open_below", "close_above", "open")
    values = {name: [0.03] for name in names} | {"open_below": [0.05], "close_above": [0.1], "episode": [1]}
    refit = {"held_out_error_before": [np.nan], "held_out_error_after": [0.0123], "refit_kept": [1]}
    upper, lower = gate(values | refit).axes
    opens = next(line for line in upper.lines if line.get_label() == "opens below")
    assert opens.get_xydata().tolist() == [[0.5, 0.05], [1, 0.05], [1.5, 0.05]]
    assert [text.get_text() for axis in (upper, lower) for text in axis.texts] == ["0.03", "0.0123"]
    assert "rolled back" not in [line.get_label() for line in lower.lines]
