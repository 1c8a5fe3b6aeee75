from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.checking import Check, ClosedLoop, Plant, Settings, check
from dynasindy.control import Controller
from dynasindy.control.controller import ControlSetup
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.tasks import Step, Tracking, TrackingReward
from dynasindy.viz.check import TrackedOutput, draw_check, draw_nyquist, draw_recovery, draw_stability, draw_steps

CART = Signature(("p", "v"), ("m", "m/s"), ("force",), (2.0, 3.0))


def held_cart(draws: int) -> Check:
    """Return the check of p' = v, v' = force under force = 2 (r - p) - 2.5 v, at -0.4, 0 and 0.4 m."""

    def law(tensordict):
        seen = tensordict["observation"]  # p / 2, v / 3 and the error over 0.5
        return tensordict.set("action", 2.0 * 0.5 * seen[..., 2:] - 2.5 * 3.0 * seen[..., 1:2])

    model = SindyModel(CART, ["force", "v"], known={"p": "v"})
    model.set_coefficients(torch.tensor([[0.0, 1.0], [1.0, 0.0]], dtype=torch.float64))
    task = Tracking(CART, Step([[0.0]]), ["p"], ["v"], TrackingReward((1.0,)))
    loop = ClosedLoop(Controller(law, ControlSetup(task, 0.1, 2, None)), Plant(model, 0.1, 0.05, None))
    return check(loop, Settings((-0.4,), (0.4,), points=3, seconds=5.0, grid=3, draws=draws))


def test_the_figures_of_a_check_name_their_targets():
    figures = draw_check(held_cart(draws=2))
    loops = [line.get_label() for line in figures["nyquist"].axes[0].lines if " m" in line.get_label()]
    assert sorted(loops) == ["$p$ = -0.4 m", "$p$ = 0 m", "$p$ = 0.4 m"]
    assert {"recovery", "coefficients"} <= set(figures)


@pytest.mark.parametrize("draws", [0, 2])
def test_the_model_itself_steps_to_the_farthest_target_with_or_without_other_plants(draws):
    found = held_cart(draws)
    target, model, *others = draw_check(found)["steps"].axes[0].lines
    assert set(target.get_ydata()) == {-0.4} and len(others) == draws
    np.testing.assert_allclose(model.get_ydata(), found.steps.x[0, :, 0])
    assert model.get_ydata()[-1] == pytest.approx(-0.4, abs=0.02)


def test_a_loop_is_drawn_for_each_input_beside_the_point_that_it_must_not_go_around():
    curve = np.exp(1j * np.linspace(0, 3, 20))[:, None] * np.array([0.5, 2.0])
    figure = draw_nyquist({"a": curve, "b": curve}, ("u_a", "u_p"), 2 / 3)
    assert len(figure.axes) == 2
    drawn = figure.axes[1].lines[0].get_xydata()
    np.testing.assert_allclose(drawn, np.stack([curve[:, 1].real, curve[:, 1].imag], -1))
    assert [-1.0, 0.0] in figure.axes[0].lines[-1].get_xydata().tolist()
    # Factors between (2 - d)/(2 + d) and its inverse: for d = 2/3 the disk meets the real axis at -1/2 and -2.
    (disk,) = figure.axes[0].patches
    assert [disk.center[0] + disk.radius, disk.center[0] - disk.radius] == pytest.approx([-0.5, -2.0])


def test_the_worst_changes_stand_on_top_and_what_never_rests_at_the_edge():
    figure = draw_stability(["a", "b$", "c"], [0.9, np.inf, 1.1])
    (axis,) = figure.axes
    assert [text.get_text() for text in axis.get_yticklabels()] == [r"b\$", "c", "a"]
    found = {dots.get_label(): dots.get_offsets().tolist() for dots in axis.collections}
    assert found["stable"] == [[0.9, 0.0]] and found["not stable"] == [[1.1, 1.0]]
    (((at, height),),) = [found["never comes to rest, drawn at the edge"]]
    assert at > 1.1 and height == 2
    assert len(draw_stability([str(k) for k in range(20)], np.ones(20)).axes[0].get_yticks()) == 15


def test_a_plane_is_drawn_with_the_first_state_to_the_right():
    back = np.array([[1, 1, 0], [0, 0, 0]])
    figure = draw_recovery([(("p", "v"), ("m", "m/s"), [-1.0, 1.0], [-2.0, 0.0, 2.0], back)])
    (axis,) = figure.axes
    np.testing.assert_array_equal(axis.collections[0].get_array().reshape(3, 2), back.T)
    told = {
        t.get_text(): p.get_facecolor()[:3] for t, p in zip(figure.legends[0].texts, figure.legends[0].get_patches())
    }
    # What is 0 in `back` has the first colour of the map, what is 1 the last.
    colors = axis.collections[0].cmap([0.0, 1.0])[:, :3]
    assert told["does not"] == tuple(colors[0]) and told["comes back"] == tuple(colors[1])
    assert axis.get_title() == "33 % come back" and "[m/s]" in axis.get_ylabel()


def test_steps_of_the_model_and_of_other_plants_are_drawn_with_the_target_and_what_passes():
    y, u = np.random.default_rng(0).normal(size=(4, 6, 1)), np.zeros((4, 5, 1))
    figure = draw_steps(
        0.1, y, u, [TrackedOutput("p", "m", 0.3, 0.05)], CART, how="coefficients by their standard errors"
    )
    upper, lower = figure.axes
    np.testing.assert_allclose(upper.lines[3].get_ydata(), y[2, :, 0])
    assert upper.lines[0].get_ydata()[0] == 0.3 and upper.lines[1].get_xdata()[-1] == 0.5
    (band,) = upper.patches
    assert (band.get_y(), band.get_height()) == pytest.approx((0.25, 0.1))
    assert upper.lines[1].get_color() == lower.lines[0].get_color() != upper.lines[2].get_color()
    # The last of five inputs is held to the end of its period.
    assert len(lower.lines) == 4 and lower.lines[0].get_xdata()[-1] == 0.5


def test_plants_that_run_away_are_counted_and_leave_the_axes_to_those_that_stay():
    y = np.tile(np.linspace(0.0, 0.3, 41)[:, None], (6, 1, 1))  # 4 s of 0.1 s; the last 2 s are the end
    y[1, 20, 0] = 0.5
    y[2, 20, 0] = 40.0  # comes back
    y[3, 10:, 0] = 40.0 * 10.0 ** np.arange(31)
    y[4, 25:, 0] = np.nan
    upper, _ = draw_steps(
        0.1, y, np.zeros((6, 40, 1)), [TrackedOutput("p", "m", 0.3, 0.05, 1.0)], CART, how="others"
    ).axes
    low, high = upper.get_ylim()
    assert -0.1 < low < 0.0 and 0.5 < high < 0.6
    colors = [line.get_color() for line in upper.lines]
    assert colors[4] == colors[5] != colors[2] == colors[3] == colors[6]


def test_a_plant_has_run_away_beyond_three_ranges_of_the_targets_or_ways_to_them():
    found = held_cart(draws=2)
    assert found.reach.tolist() == pytest.approx([3 * 0.8])  # from -0.4 to 0.4 m
    far = replace(found, begin=torch.tensor([2.0, 0.0], dtype=torch.float64))
    assert far.reach.tolist() == pytest.approx([3 * 2.4])
    found.drawn.x[1, -1, 0] = -0.4 + 2.5
    _, _, *others = draw_check(found)["steps"].axes[0].lines
    assert others[0].get_color() != others[1].get_color()


def test_steps_have_inputs_in_the_unit_of_the_actuator():
    volts = Signature(("p",), ("m",), ("force",), (1.0,), [[-8, 8]], [[0, 1]], ["N"])
    y, u = np.zeros((2, 6, 1)), np.full((2, 5, 1), 0.5)
    lower = draw_steps(0.1, y, u, [TrackedOutput("p", "m", 0.3, 0.05)], volts).axes[1]
    assert lower.lines[1].get_ydata().tolist() == [4.0] * 6 and lower.get_ylabel() == "force [N]"
