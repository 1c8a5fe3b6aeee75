"""Animations: real time, one picture per shown sample, and one line for what cannot be written."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from dynasindy.envs import ControlEnv
from dynasindy.envs.drawing import draw
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.systems import Tras
from dynasindy.tasks import Step, Tracking
from dynasindy.viz.animation import animate, frames


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    system = Tras()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.4, 0.25]])), substeps=1)
    half = Scenario("half", Step([[0.4, 0.25], [0.1, 0.1]]), episodes=2, seconds=0.5)
    return evaluate(env, lambda td: td.set("action", torch.full((*td.batch_size, 2), 0.5)), half)


def test_pictures_are_of_the_shown_row_and_sample(evaluation: Evaluation) -> None:
    pictures = list(frames(evaluation, row=1, every=2))
    assert len(pictures) == 5
    state = evaluation.trajectory["state"][1, 4]
    expected = draw(evaluation.signature, state.tolist(), [0.1, 0.1], [0, 1], 0.2)
    np.testing.assert_array_equal(pictures[2], expected)


def test_a_gif_runs_in_real_time(evaluation: Evaluation, tmp_path: Path) -> None:
    path = animate(evaluation, tmp_path / "new" / "half.gif", every=2)
    with Image.open(path) as gif:
        assert gif.n_frames == 5
        assert gif.size == (540, 360)
        assert gif.info["duration"] == 100


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_an_mp4_is_written_where_ffmpeg_is(evaluation: Evaluation, tmp_path: Path) -> None:
    assert animate(evaluation, tmp_path / "half.mp4").stat().st_size > 1000


def test_mistakes_get_one_line(evaluation: Evaluation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"'a\.avi'; use a name in \.gif or \.mp4"):
        animate(evaluation, tmp_path / "a.avi")
    with pytest.raises(ValueError, match="every must be at least 1"):
        animate(evaluation, tmp_path / "a.gif", every=0)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(ValueError, match=r"needs ffmpeg, which is not installed"):
        animate(evaluation, tmp_path / "a.mp4")
