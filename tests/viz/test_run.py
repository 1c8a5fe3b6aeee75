"""Figures of a run, and of what the gate decided in it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dynasindy.systems import Pendulum
from dynasindy.viz import run
from dynasindy.viz.run import draw_run, gate, read_table

TIME = [f"{0.05 * k:.2f}" for k in range(200)]
HEADING = "time [s],theta [rad],Omega [rad/s],u [-],reference_theta [rad]"
PREDICTION = "time,theta,Omega,predicted_theta,predicted_Omega"
PROGRESS = "episode,return,one_step_reward_error,evaluated_return\n"


def write(path: Path, header: str, *columns: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *(",".join([t, *columns]) for t in TIME)]) + "\n")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path / "data" / "excitation.csv", HEADING, "0.1", "0.2", "0.3", "0.0")
    write(tmp_path / "data" / "step_response.csv", HEADING, "0.1", "0.7", "0.3", "0.5")
    return tmp_path


@pytest.fixture
def figures(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Draw the folder and return its figures by name."""

    def _draw() -> dict:
        drawn: dict = {}
        monkeypatch.setattr(run.style, "save_figures", lambda figures, *_: drawn.update(figures))
        draw_run(folder, Pendulum().signature)
        return drawn

    return _draw


def test_every_figure_whose_data_are_there_is_drawn(folder: Path) -> None:
    drawn = {file.name for file in draw_run(folder, Pendulum().signature)}
    assert drawn == {"training_data.png", "step_response.png"}
    write(folder / "data" / "prediction_first_episode.csv", PREDICTION, "0.1", "0.2", "0.1", "0.2")
    (folder / "progress.csv").write_text(f"{PROGRESS}1,-5,0.1,\n2,-3,0.01,-2\n")
    files = draw_run(folder, Pendulum().signature, formats=("svg",))
    assert {"prediction_first_episode.svg", "learning_curve.svg"} <= {f.name for f in files}
    assert all(file.parent == folder / "figures" for file in files)


def test_the_return_of_a_single_episode_is_no_curve(folder: Path, figures) -> None:
    (folder / "progress.csv").write_text(f"{PROGRESS}1,-5,0.1,-2\n")
    assert "learning_curve" not in figures()


def test_the_last_row_of_a_response_is_the_state_at_its_end(folder: Path, figures) -> None:
    response = folder / "data" / "step_response.csv"
    before = figures()["step_response"]
    start, end = before.axes[0].get_xlim()
    response.write_text(f"{response.read_text()}{end},0.8,0,,0.5\n")
    after = figures()["step_response"]
    assert after.axes[0].get_xlim() == (start, end)  # no period more
    reference, output = after.axes[0].lines[:2]
    assert (output.get_xdata()[-1], output.get_ydata()[-1]) == (end, 0.8) and reference.get_xdata()[-1] == end
    (held,) = after.axes[1].lines
    assert not np.isnan(held.get_ydata()).any() and held.get_xdata()[-1] == end
    assert before.axes[0].lines[1].get_xdata()[-1] < end  # a table of an earlier run


def test_empty_cells_are_nan_and_a_missing_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("a,b\n1,\n2,3.5\n")
    table = read_table(tmp_path / "t.csv")
    np.testing.assert_array_equal(table["a"], [1.0, 2.0])
    np.testing.assert_array_equal(table["b"], [np.nan, 3.5])
    with pytest.raises(FileNotFoundError, match="progress"):
        read_table(tmp_path / "progress.csv")


def test_without_references_the_response_shows_all_states(folder: Path, figures) -> None:
    write(folder / "data" / "step_response.csv", HEADING.rpartition(",")[0], "0.1", "0.7", "0.3")
    (folder / "metrics.json").write_text('{"drawn": {"words": "episode 3 of 9"}, "untrained": {"return": 0}}')
    figure = figures()["step_response"]
    assert "episode 3 of 9" in figure.get_suptitle()
    drawn = [[line.get_ydata()[0] for line in axis.lines] for axis in figure.axes]
    assert drawn == [[0.1], [0.7], [0.3]]


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
