from dataclasses import replace

import numpy as np
import pytest
import torch
from carts import make_loop

from dynasindy.control import Controller
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Step, Tracking, TrackingReward
from dynasindy.evaluation.check import Check, Settings, Thresholds, check
from dynasindy.evaluation.closed_loop import ClosedLoop
from dynasindy.evaluation.linear_loop import frequencies, open_loop_response
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.viz.check import draw_check


def held_cart(draws: int) -> Check:
    """Return the check of p' = v, v' = force under force = 2 (r - p) - 2.5 v, at -0.4, 0 and 0.4 m."""
    return check(make_loop(), Settings((-0.4,), (0.4,), points=3, seconds=5.0, grid=3, draws=draws))


def held_pair() -> Check:
    """Return the check of a' = u, b' = v, held by u = 2 (r - a) and v = 3 (r - b); u is up to 8 N, v up to 4 V."""
    ends = {"input_ends": ((-8.0, 8.0), (-4.0, 4.0)), "input_units": ("N", "V")}
    pair = Signature(("a", "b"), ("m", "m"), ("u", "v"), (1.0, 1.0), **ends)

    def law(tensordict):
        gains = torch.tensor([2.0, 3.0])
        return tensordict.set("action", gains * tensordict["observation"][..., -2:])

    model = SindyModel(pair, ["u", "v"])
    model.set_coefficients(torch.eye(2, dtype=torch.float64))
    task = Tracking(pair, Step([[0.0, 0.0]]), ["a", "b"], [], TrackingReward((1.0, 1.0)))
    loop = ClosedLoop(Controller(law, ControlSetup(task, 0.1, 2, None)), model, 0.05)
    return check(loop, Settings((-0.4, -0.2), (0.4, 0.2), points=3, seconds=5.0, grid=3, draws=0))


def test_each_input_has_its_loop_and_its_own_unit():
    found = held_pair()
    figures, row = draw_check(found), found.rest.linear.row(0)
    loops = np.asarray(open_loop_response(row, frequencies(row)))
    assert len(figures["nyquist"].axes) == 2 and not np.allclose(loops[:, 0], loops[:, 1])
    for axis, loop in zip(figures["nyquist"].axes, loops.T, strict=True):
        curve = np.stack([loop.real, loop.imag], -1)
        assert any(c.shape == curve.shape and np.allclose(c, curve) for c in (line.get_xydata() for line in axis.lines))
    force, voltage = figures["steps"].axes[-2:]
    assert "[N]" in force.get_ylabel() and "[V]" in voltage.get_ylabel()
    np.testing.assert_allclose(force.lines[0].get_ydata()[:-1], 8 * found.steps.u[0, :, 0], atol=1e-6)
    np.testing.assert_allclose(voltage.lines[0].get_ydata()[:-1], 4 * found.steps.u[0, :, 1], atol=1e-6)


def test_a_loop_is_drawn_beside_the_point_that_it_must_not_go_around():
    found = held_cart(draws=0)
    (axis,) = draw_check(found)["nyquist"].axes
    row = found.rest.linear.row(0)
    loop = np.asarray(open_loop_response(row, frequencies(row)))[:, 0]
    curves = [line.get_xydata() for line in axis.lines]
    assert any(one.shape == (len(loop), 2) and np.allclose(one, np.stack([loop.real, loop.imag], -1)) for one in curves)
    assert [-1.0, 0.0] in axis.lines[-1].get_xydata().tolist()
    # Factors between (2 - d)/(2 + d) and its inverse: the disk meets the real axis there.
    (disk,), margin = axis.patches, Thresholds.disk
    ends = [disk.center[0] + disk.radius, disk.center[0] - disk.radius]
    assert ends == pytest.approx([-(2 - margin) / (2 + margin), -(2 + margin) / (2 - margin)])


def test_a_plane_is_drawn_with_the_first_state_to_the_right():
    found = held_cart(draws=0)
    back = torch.tensor([[1, 1, 0], [0, 0, 0]])
    plane = found.planes[0]._replace(first=torch.tensor([-1.0, 1.0]), second=torch.tensor([-2.0, 0.0, 2.0]), back=back)
    figure = draw_check(replace(found, planes=[plane]))["recovery"]
    (axis,) = figure.axes
    np.testing.assert_array_equal(axis.collections[0].get_array().reshape(3, 2), back.T)
    patches = [patch.get_facecolor()[:3] for patch in figure.legends[0].get_patches()]
    # What is 0 in `back` has the first colour of the map, what is 1 the last; what comes back is named first.
    assert patches[::-1] == [tuple(color) for color in axis.collections[0].cmap([0.0, 1.0])[:, :3]]
    assert axis.get_title().startswith("33 %") and "[m/s]" in axis.get_ylabel()


def test_steps_of_the_model_and_of_other_plants_are_drawn_with_the_target_and_what_passes():
    found = held_cart(draws=3)
    upper, lower = draw_check(found)["steps"].axes
    np.testing.assert_allclose(upper.lines[3].get_ydata(), found.drawn.x[1, :, 0])
    assert upper.lines[0].get_ydata()[0] == -0.4 and upper.lines[1].get_xdata()[-1] == pytest.approx(5.0)
    assert upper.lines[1].get_color() == lower.lines[0].get_color() != upper.lines[2].get_color()
    (band,) = upper.patches
    error = Thresholds.error * float(found.loop.task.boxes()[0])
    assert (band.get_y(), band.get_height()) == pytest.approx((-0.4 - error, 2 * error))
    # The last input is held to the end of its period.
    assert len(lower.lines) == 4 and lower.lines[0].get_xdata()[-1] == pytest.approx(5.0)


def test_plants_that_run_away_leave_the_axes_to_those_that_stay():
    found = held_cart(draws=5)
    y = found.drawn.x[:, :, 0]  # 5 s of 0.1 s; the last half is the end
    y[0, 20] = 0.5
    y[1, 15] = 40.0  # comes back
    y[2, 20:] = 40.0 * 10.0 ** torch.arange(31)
    y[3, 35:] = torch.nan
    upper, _ = draw_check(found)["steps"].axes
    low, high = upper.get_ylim()
    assert -0.7 < low < -0.4 and 0.5 < high < 0.7
    colors = [line.get_color() for line in upper.lines]
    assert colors[4] == colors[5] != colors[2] == colors[3] == colors[6]
