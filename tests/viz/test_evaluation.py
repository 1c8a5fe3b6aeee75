"""Figures of an evaluation: which kind is drawn for which scenario."""

from functools import partial
from pathlib import Path

import pytest
import torch
from matplotlib.colors import to_rgb

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.disturbances import Pushed
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.systems import Pendulum, Tras
from dynasindy.tasks import Reference, Step, Tracking, TrackingReward, Wave
from dynasindy.viz.evaluation import draw_evaluation, evaluation_figures
from dynasindy.viz.style import ORANGE


def run(reference: Reference, episodes: int) -> Evaluation:
    system = Tras()
    env = ControlEnv(system, Tracking(system.signature, reference), substeps=1)
    scenario = Scenario("short", reference, episodes, seconds=1.0)
    return evaluate(env, lambda td: td.set("action", torch.zeros(*td.batch_size, 2)), scenario)


@pytest.mark.parametrize("episodes", [1, 3])
def test_many_references_add_the_spread_of_the_error(episodes: int, tmp_path: Path) -> None:
    files = draw_evaluation(run(Step([[0.1, 0.1]]), episodes), tmp_path, formats=("png", "svg"))
    names = {file.name for file in files}
    assert names == {"short.png", "short.svg"} | ({"short_errors.png", "short_errors.svg"} if episodes > 1 else set())
    assert all(file.stat().st_size > 1000 for file in files)


def test_steps_show_their_settling_band_and_waves_do_not() -> None:
    assert evaluation_figures(run(Step([[0.1, 0.1]]), 1))["short"].axes[0].patches
    assert not evaluation_figures(run(Wave([0.3, 0.2], [0.5, 0.5]), 1))["short"].axes[0].patches


def test_the_gust_is_shaded_in_every_panel() -> None:
    system = Tras()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.1, 0.1]])), substeps=1)
    gust = Scenario("wind", None, 2, 3.0, partial(Pushed, push={"Omega_p": 0.5}), [(1.0, 2.0)])
    drawn = evaluation_figures(evaluate(env, lambda td: td.set("action", torch.zeros(*td.batch_size, 2)), gust))
    for figure in drawn.values():
        for axis in figure.axes:
            shades = [patch for patch in axis.patches if patch.get_facecolor()[:3] == to_rgb(ORANGE)]
            assert [(shade.get_x(), shade.get_width()) for shade in shades] == [(1, 1)]
        assert figure.axes[0].get_legend().get_texts()[-1].get_text() == "disturbed"


def test_other_plants_get_their_own_labels() -> None:
    system = Pendulum()
    task = Tracking(system.signature, Step([[0.5]]), ["theta"], ["Omega"], TrackingReward(error_weights=(4.0,)))
    result = evaluate(
        ControlEnv(system, task),
        lambda td: td.set("action", torch.zeros(*td.batch_size, 1)),
        Scenario("hang", seconds=1.0),
    )
    labels = [axis.get_ylabel() for axis in evaluation_figures(result)["hang"].axes]
    assert labels == [r"$\theta$ [rad]", "$u$ [-]"]


def test_without_references_all_states_are_drawn_and_no_errors(settle) -> None:
    env = ControlEnv(Pendulum(), settle(Pendulum().signature), substeps=1)
    zero = Scenario("task", None, 3, 1.0)
    drawn = evaluation_figures(evaluate(env, lambda td: td.set("action", torch.zeros(*td.batch_size, 1)), zero))
    assert list(drawn) == ["task"]
    assert [len(axis.lines) for axis in drawn["task"].axes] == [1, 1, 1]


def test_the_episode_that_begins_farthest_is_drawn() -> None:
    system = Pendulum()
    task = Tracking(
        system.signature, Step([[0.0]]), outputs=["theta"], rates=["Omega"], reward=TrackingReward((4.0,)),
        start={"theta": [-3.0, 3.0]},
    )  # fmt: skip
    env = ControlEnv(system, task, substeps=1)
    result = evaluate(env, lambda td: td.set("action", torch.zeros(*td.batch_size, 1)), Scenario("swing", None, 9, 0.5))
    starts = result.outputs[:, 0, 0].abs()
    figure = evaluation_figures(result)["swing"]
    assert abs(figure.axes[0].lines[1].get_ydata()[0]) == starts.max()
    assert f"episode {int(starts.argmax()) + 1} of 9" in figure.get_suptitle()
