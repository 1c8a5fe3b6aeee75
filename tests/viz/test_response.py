"""Responses draw the data they are given, with the bands the metrics use; evaluations and flights what happened."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from controllers import angle_task
from matplotlib.colors import to_rgb

from dynasindy.envs import ControlEnv, Reference, Step, Tracking, Wave
from dynasindy.evaluation.disturbances import PerturbedPlant
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.rig import Wiring
from dynasindy.rig.log import FlightRecord
from dynasindy.systems import Pendulum, Signature, Tras
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz import response
from dynasindy.viz.response import (
    _draw_flight,
    draw_evaluation,
    tracking,
)
from dynasindy.viz.style import ORANGE

TIME = torch.arange(400) * 0.05
REFERENCE = torch.tensor([0.4, 0.25]).expand(400, 2)
OUTPUT = REFERENCE * (1 - torch.exp(-TIME)).unsqueeze(-1)


def test_tracking_draws_reference_and_every_controller() -> None:
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT, "b": 0.5 * OUTPUT}, {"a": OUTPUT, "b": -OUTPUT})
    assert [a.get_ylabel().split(" [")[1] for a in figure.axes] == ["rad]", "rad]", "-]", "-]"]
    lines = figure.axes[1].lines
    np.testing.assert_allclose(lines[0].get_ydata(), 0.25)
    np.testing.assert_allclose(lines[2].get_ydata(), 0.5 * OUTPUT[:, 1], rtol=1e-6)
    (legend,) = figure.legends
    assert [t.get_text() for t in legend.get_texts()][:3] == ["reference", "a", "b"]


def test_inputs_are_drawn_as_held() -> None:
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT}, {"a": OUTPUT})
    (line,) = figure.axes[2].lines
    assert line.get_drawstyle() == "steps-post"
    np.testing.assert_allclose(line.get_xydata()[-2:, 0], [19.95, 20.0], rtol=1e-6)
    assert line.get_ydata()[-1] == line.get_ydata()[-2]


def test_step_response_shows_the_five_percent_band_and_the_last_five_seconds() -> None:
    figure = tracking(TIME, REFERENCE, {"a": REFERENCE * (1 - torch.exp(-0.2 * TIME)).unsqueeze(-1)})
    assert figure.axes[-1].get_xlim() == (0.0, 20.0)
    band, steady = figure.axes[0].patches
    assert (band.get_y(), band.get_height()) == pytest.approx((0.38, 0.04))
    assert (steady.get_x(), steady.get_width()) == pytest.approx((15.0, 5.0))


def test_the_time_of_a_step_ends_with_twice_what_passes_until_it_rests() -> None:
    """An exponential comes within a fiftieth after ln 50 time constants."""
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT})
    assert figure.axes[0].get_xlim() == pytest.approx((0.0, 2 * np.log(50)), abs=0.1)
    waves = REFERENCE * (1 + 0.1 * torch.sin(TIME)).unsqueeze(-1)
    assert tracking(TIME, waves, {"a": OUTPUT}).axes[0].get_xlim() == (0.0, 20.0)


def test_states_that_are_not_tracked_are_drawn_below_without_a_reference() -> None:
    states = torch.cat([OUTPUT, torch.cos(TIME).unsqueeze(-1).expand(-1, 4)], -1)
    figure = tracking(TIME, REFERENCE, {"a": states}, {"a": OUTPUT}, SIGNATURE.state_names)
    assert [len(axis.lines) for axis in figure.axes] == [2, 2, 1, 1, 1, 1, 1, 1]
    named = [axis.get_xlabel() != "" for axis in figure.axes]
    assert named == [False] * 6 + [True] * 2  # two columns, each with its time below


def test_inputs_are_drawn_in_the_units_of_their_actuators() -> None:
    """A motor of 0 to 12 V at the quarter of its power has 3 V."""
    volts = replace(SIGNATURE, input_ends=((-12, 12), (-1, 1)), input_limits=((0, 1), (-1, 1)), input_units=("V", "-"))
    figure = tracking(TIME, REFERENCE, {"a": OUTPUT}, {"a": 0.25 * np.ones_like(OUTPUT)}, signature=volts)
    assert [float(axis.lines[0].get_ydata()[0]) for axis in figure.axes[2:]] == [3.0, 0.25]
    assert ["[V]" in axis.get_ylabel() for axis in figure.axes] == [False, False, True, False]


@pytest.fixture
def figures(monkeypatch):
    """Draw an evaluation and return its figures by file."""

    def _draw(evaluation: Evaluation) -> dict:
        drawn: dict = {}
        monkeypatch.setattr(response.style, "save_figures", lambda figures, *_: drawn.update(figures))
        draw_evaluation(evaluation, Path("nowhere"))
        return drawn

    return _draw


def run(reference: Reference, episodes: int) -> Evaluation:
    system = Tras()
    env = ControlEnv(system, Tracking(system.signature, reference), substeps=1)
    return evaluate(env, rest(), Scenario("short", reference, episodes, seconds=1.0))


def rest(n_u: int = 2):
    return lambda td: td.set("action", torch.zeros(*td.batch_size, n_u))


def test_the_spread_of_the_error_has_its_median(figures) -> None:
    evaluation = run(Step([[0.1, 0.1], [0.3, 0.2], [0.2, 0.4]]), 3)
    (axis, _) = figures(evaluation)["short_errors"].axes
    error = (evaluation.outputs - evaluation.references).abs()[..., 0]
    np.testing.assert_allclose(axis.lines[0].get_ydata(), error.median(0).values, rtol=1e-5)
    assert axis.get_yscale() == "log"


def test_steps_show_their_settling_band_and_waves_do_not(figures) -> None:
    assert figures(run(Step([[0.1, 0.1]]), 1))["short"].axes[0].patches
    assert not figures(run(Wave([0.3, 0.2], [0.5, 0.5]), 1))["short"].axes[0].patches


def test_the_gust_is_shaded_in_every_panel(figures) -> None:
    system = Tras()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.1, 0.1]])), substeps=1)
    gust = Scenario("wind", None, 2, 3.0, partial(PerturbedPlant, push={"Omega_p": 0.5}), [(1.0, 2.0)])
    for figure in figures(evaluate(env, rest(), gust)).values():
        for axis in figure.axes:
            shades = [patch for patch in axis.patches if patch.get_facecolor()[:3] == to_rgb(ORANGE)]
            assert [(shade.get_x(), shade.get_width()) for shade in shades] == [(1, 1)]


def test_the_episode_that_begins_farthest_is_drawn_with_the_labels_of_its_plant(figures) -> None:
    task = angle_task(Step([[0.0]]), start={"theta": [-3.0, 3.0]})
    result = evaluate(ControlEnv(Pendulum(), task, substeps=1), rest(1), Scenario("swing", None, 9, 0.5))
    figure = figures(result)["swing"]
    assert abs(figure.axes[0].lines[1].get_ydata()[0]) == result.outputs[:, 0, 0].abs().max()
    assert [axis.get_ylabel() for axis in figure.axes] == [r"$\theta$ [rad]", r"$\Omega$ [rad/s]", "$u$ [-]"]


RIG = Signature(("theta", "level"), ("rad", "m"), ("u",), (1.0, 1.0))
WIRING = Wiring(RIG, (True, False), 0.1)
AT = 0.1 * np.arange(5)
MEASURED = np.stack([np.linspace(0.0, 0.4, 5), np.full(5, np.nan)], -1)
ENDED = FlightRecord(
    RIG, ("theta", "level"), AT, np.tile([0.3, 0.5], (5, 1)), MEASURED, np.full((5, 1), 0.2), 20,
    "range: theta is 0.5, outside of -0.45 to 0.45",
)  # fmt: skip


def test_a_flight_that_ended_early_says_when_and_why_on_the_time_that_was_planned() -> None:
    figure = _draw_flight(ENDED, WIRING, "flight_1")
    title = figure.get_suptitle()
    assert ENDED.fault in " ".join(title.split())
    for axis in figure.axes:
        assert axis.lines[-1].get_xdata() == pytest.approx([0.5, 0.5])
    low, high = figure.axes[-1].get_xlim()
    assert low == 0.0 and 2.0 <= high < 2.1


def test_samples_between_lost_ones_are_drawn_as_points() -> None:
    """The second and the fourth of five samples were lost, so that no two of them make a line."""
    outputs = MEASURED.copy()
    outputs[[1, 3]] = np.nan
    axis = _draw_flight(replace(ENDED, outputs=outputs), WIRING, "flight_1").axes[0]
    (drawn,) = [line for line in axis.lines if line.get_marker() == "."]
    assert np.isfinite(drawn.get_ydata()).tolist() == [True, False, True, False, True]
