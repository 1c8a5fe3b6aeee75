"""Animations: real time, one picture per shown sample, and one line for what cannot be written."""

from pathlib import Path

import numpy as np
import pytest
import torch
from controllers import angle_task
from PIL import Image

from dynasindy.envs import ControlEnv, Step, Tracking
from dynasindy.envs.drawing import draw
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.systems import Pendulum, Tras
from dynasindy.viz.animation import _frames, animate


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    system = Tras()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.4, 0.25]])), substeps=1)
    half = Scenario("half", Step([[0.4, 0.25], [0.1, 0.1]]), episodes=2, seconds=0.5)
    return evaluate(env, lambda td: td.set("action", torch.full((*td.batch_size, 2), 0.5)), half)


def test_pictures_are_of_the_shown_row_and_sample(evaluation: Evaluation) -> None:
    pictures = list(_frames(evaluation, row=1, every=2))
    assert len(pictures) == 5
    state = evaluation.trajectory["state"][1, 4]
    scene = draw(evaluation.signature, state.tolist(), [0.1, 0.1], (0, 1), "t = 0.2 s")
    np.testing.assert_array_equal(pictures[2][:, :360], scene)


def test_other_plants_are_drawn_with_their_dial() -> None:
    env = ControlEnv(Pendulum(), angle_task(Step([[0.3]])), substeps=1)
    swing = Scenario("swing", Step([[0.3]]), seconds=0.2)
    shown = evaluate(env, lambda td: td.set("action", torch.zeros(*td.batch_size, 1)), swing)
    (first, _) = _frames(shown)
    assert first.shape == (360, 180 + 360, 3)


def test_a_gif_runs_in_real_time(evaluation: Evaluation, tmp_path: Path) -> None:
    path = animate(evaluation, tmp_path / "new" / "half.gif")
    with Image.open(path) as gif:
        assert gif.n_frames == 5
        assert gif.size == (720, 360)
        assert gif.info["duration"] == 100


def test_a_run_that_takes_too_long_is_shown_faster(evaluation: Evaluation, tmp_path: Path) -> None:
    with Image.open(animate(evaluation, tmp_path / "half.gif", seconds=0.25)) as gif:
        assert gif.n_frames * gif.info["duration"] == pytest.approx(250, abs=50)
