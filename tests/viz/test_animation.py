"""Animations: real time, one picture per shown sample, and one line for what cannot be written."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from PIL import Image, ImageDraw
from tensordict import TensorDict

from dynasindy.envs import ControlEnv, drawing
from dynasindy.envs.drawing import draw_beam
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.systems import Pendulum, Signature, Tras
from dynasindy.tasks import Step, Tracking, TrackingReward
from dynasindy.text import format_duration
from dynasindy.viz.animation import FULL, Chart, animate, bar_ends, frames


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
    turned = (evaluation.trajectory["state"][1, :5:2, 4:] / torch.tensor(FULL)).sum(0)
    scene = draw_beam(state.tolist(), [0.1, 0.1], turned.tolist(), "t = 0.2 s")
    np.testing.assert_array_equal(pictures[2][:, :360], scene)


def test_the_chart_grows_and_its_last_point_is_where_the_output_stands(evaluation: Evaluation) -> None:
    chart = Chart(evaluation, row=0)
    blue = np.array([0, 114, 178])
    early, late = ((np.abs(chart.until(k).astype(int) - blue).max(-1) < 20) for k in (2, 9))
    assert early.sum() < late.sum()
    u, v = chart.lines[1][9]
    assert late[round(v / 2), round(u / 2)] and not early[round(v / 2), round(u / 2)]


def test_the_reference_is_black_and_dashed_and_the_plant_is_blue_with_an_entry_in_the_legend(
    evaluation: Evaluation,
) -> None:
    picture = np.hstack(list(frames(evaluation, row=0, every=9))[-1:]).astype(int)
    scene, chart = picture[:, :360], picture[:, 360:]
    black, blue = (np.abs(chart - colour).max(-1) < 60 for colour in ((0, 0, 0), (0, 114, 178)))
    # 0.4 rad is far above what the azimuth reaches in half a second: between the frame's left side and the right end
    # the reference is alone in its rows, and a dashed line of it has gaps.
    rows = [row[90:340] for row in black[:160] if 80 < row[90:340].sum() < 220]
    assert rows and all(np.diff(row.astype(int)).astype(bool).sum() > 20 for row in rows)
    assert blue[335:].any() and black[335:].any(), "below the axes stands the legend, with a line of each"
    # Nothing of the orange-red of a controller is in the scene, whose rotors are neither blue nor black.
    assert (np.abs(scene - (213, 94, 0)).max(-1) < 30).sum() == 0
    assert not {(0, 114, 178), (0, 0, 0)} & {drawing._MAIN, drawing._TAIL}


def test_other_plants_are_drawn_with_their_dial() -> None:
    system = Pendulum()
    task = Tracking(system.signature, Step([[0.3]]), outputs=["theta"], rates=["Omega"], reward=TrackingReward((4.0,)))
    env = ControlEnv(system, task, substeps=1)
    swing = Scenario("swing", Step([[0.3]]), seconds=0.2)
    shown = evaluate(env, lambda td: td.set("action", torch.zeros(*td.batch_size, 1)), swing)
    (first, _) = frames(shown)
    assert first.shape == (360, 180 + 360, 3)


def tank(levels: list[float], bounds: tuple[tuple[float, float], ...] = (), length: int = 5) -> Evaluation:
    """Levels [m] of a tank that is wanted at 1 m, a value every second; `length` seconds in all."""
    time = torch.arange(length, dtype=torch.float64)
    y = torch.tensor(levels + levels[-1:] * (length - len(levels))).reshape(1, -1, 1)
    trajectory = TensorDict({"state": y, "reference": torch.ones_like(y)}, y.shape[:2])
    signature = Signature(("h",), ("m",), ("q",), (0.5,))
    return Evaluation("tank", signature, (0,), time, trajectory, {}, bounds=bounds)


@pytest.mark.parametrize(
    ("levels", "bounds", "ends"),
    [
        ([1.0, 1.4], ((0.0, 2.0),), (0.0, 2.0)),
        ([1.0, 1.4], ((-math.inf, 2.0),), (0.0, 2.0)),
        ([1.0, 1.5], (), (0.0, 1.5)),
        ([0.25, 0.75], (), (0.0, 1.0)),  # the target is 1 m
        ([-0.25, 0.75], ((-math.inf, math.inf),), (-0.25, 1.0)),
    ],
)
def test_a_bar_begins_at_zero_or_where_the_plant_ends(levels, bounds, ends) -> None:
    assert bar_ends(tank(levels, bounds), 0, 0) == ends


def test_a_full_tank_is_drawn_half_full_at_half_of_its_height() -> None:
    (first, *_) = frames(tank([1.0, 1.4], ((0.0, 2.0),)), every=1)
    # The bar of 112 pixels begins 30 below the corner of the plant's picture, at a quarter of its height.
    column = np.abs(first[:, 80].astype(int) - np.array([0, 114, 178])).max(-1) < 20
    rows = np.nonzero(column[100:240])[0]
    assert len(rows) == pytest.approx(56, abs=4)


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """All words that pictures get from here on."""
    words: list[str] = []
    write, name = ImageDraw.ImageDraw.text, Axes.set_xlabel

    def text(pen, at, what, *args, **kwargs):
        words.append(what)
        return write(pen, at, what, *args, **kwargs)

    def xlabel(axis, what, *args, **kwargs):
        words.append(what)
        return name(axis, what, *args, **kwargs)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", text)
    monkeypatch.setattr(Axes, "set_xlabel", xlabel)
    return words


def test_no_error_is_minus_zero(written: list[str]) -> None:
    list(frames(tank([1.0002, 1.25], ((-1.0, 2.0),)), every=1))
    assert "h error +0.000 m" in written and "h error -0.250 m" in written
    assert not any("-0.000" in words for words in written)


@pytest.mark.parametrize(("length", "unit"), [(600, "min"), (800, "s")])
def test_clock_and_axis_have_the_unit_of_the_run(length: int, unit: str, written: list[str]) -> None:
    """Ten minutes are told in minutes from the first picture on, though the last sample is at 599 s."""
    list(frames(tank([1.0, 1.25], length=length), every=length // 4))
    clocks = [words for words in written if words.startswith("t = ")]
    assert len(clocks) == 4 and all(words.endswith(f" {unit}") for words in clocks)
    assert f"time [{unit}]" in written and format_duration(length).endswith(f" {unit}")


def test_a_gif_runs_in_real_time(evaluation: Evaluation, tmp_path: Path) -> None:
    path = animate(evaluation, tmp_path / "new" / "half.gif")
    with Image.open(path) as gif:
        assert gif.n_frames == 5
        assert gif.size == (720, 360)
        assert gif.info["duration"] == 100


def test_a_run_that_takes_too_long_is_shown_faster(evaluation: Evaluation, tmp_path: Path) -> None:
    with Image.open(animate(evaluation, tmp_path / "half.gif", seconds=0.25)) as gif:
        assert gif.n_frames * gif.info["duration"] == pytest.approx(250, abs=50)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_an_mp4_is_written_where_ffmpeg_is(evaluation: Evaluation, tmp_path: Path) -> None:
    assert animate(evaluation, tmp_path / "half.mp4").stat().st_size > 1000


def test_mistakes_get_one_line(evaluation: Evaluation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"'a\.avi'; use a name in \.gif or \.mp4"):
        animate(evaluation, tmp_path / "a.avi")
    with pytest.raises(ValueError, match="seconds of an animation must be positive"):
        animate(evaluation, tmp_path / "a.gif", seconds=0)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(ValueError, match=r"needs ffmpeg, which is not installed"):
        animate(evaluation, tmp_path / "a.mp4")
