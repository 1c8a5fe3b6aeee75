"""The loop as one map is the controller with a plant, and its flights are those of the linear map."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from carts import Law, make_cart, make_loop, make_network_loop, make_task

from dynasindy.control.controller import ControlSetup
from dynasindy.evaluation.check import LONGER, Settings, check
from dynasindy.evaluation.closed_loop import FINE, LoopSimulation, _longest_step
from dynasindy.sindy import SindyModel
from dynasindy.systems import integrate


def flown(loop, x, r, periods):
    """Fly the model with the controller itself; inputs and measurements wait in lists."""
    controller, model, dt = loop.controller, loop.model, loop.dt
    controller.reset()
    late = 0 if loop.observer is None else loop.observer.sensors.delay
    states, inputs = [x], []
    whole = int(model.delay / dt)
    rest = model.delay - whole * dt

    def acted(k):
        return torch.zeros(1, dtype=torch.float64) if k < 0 else inputs[k]

    for k in range(periods):
        y = states[max(0, k - late)]
        inputs.append(torch.from_numpy(controller.act(y.numpy(), r)))
        x = states[-1]
        for u, seconds in ((acted(k - whole - 1), rest), (acted(k - whole), dt - rest)):
            if seconds:
                x = integrate(model, x, u, seconds, 20, loop.stops)[0][-1]
        states.append(x)
    return torch.stack(states), torch.stack(inputs)


def stepped(loop, x, r, periods):
    z = loop.at(x.unsqueeze(0), torch.zeros(1, loop.signature.n_u, dtype=torch.float64))
    covariance = torch.zeros(1, *loop.law.shapes[2], dtype=torch.float64)
    states, inputs = [x], []
    for _ in range(periods):
        z, covariance, u = loop.step(z, covariance, torch.tensor([r], dtype=torch.float64))
        states.append(z[0, loop.parts["x"]])
        inputs.append(u[0])
    return torch.stack(states), torch.stack(inputs)


INTEGRAL = {"gain": 1.5, "band": 0.9}


@pytest.mark.parametrize(
    ("disturbance", "delay", "late", "integral"),
    [
        (False, 0.0, 0, None),
        (True, 0.07, 1, None),
        (False, 0.08, 2, INTEGRAL),
        (True, 0.0, 0, INTEGRAL),
        (True, 0.08, 2, None),
    ],
)
def test_it_flies_as_the_controller_does(disturbance, delay, late, integral):
    loop = make_network_loop(delay, disturbance, late, integral)
    x = torch.tensor([0.2, -0.5], dtype=torch.float64)
    expected, commands = flown(loop, x, [0.3], 60)
    found, u = stepped(loop, x, [0.3], 60)
    assert commands.std() > 1e-3 and expected.std(0).min() > 1e-2
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)  # the controller has float32 weights and values
    np.testing.assert_allclose(u, commands, rtol=0, atol=2e-5)


def test_a_loop_holds_what_its_controller_remembers_and_nothing_else():
    def parts(**settings):
        return {name: part for name, part in make_loop(**settings).parts.items() if part.stop > part.start}

    assert parts() == {"x": slice(0, 2)}
    assert parts(integral={}) == {"x": slice(0, 2), "integral": slice(2, 3)}
    # A measurement under way, three commands that the observer remembers, and its estimate.
    late = {"x": slice(0, 2), "late": slice(2, 4), "inputs": slice(4, 7), "mean": slice(7, 9)}
    assert parts(observer={"delay": 1}) == late


def test_rows_may_have_coefficients_of_their_own():
    loop = make_loop()
    xi = torch.stack([loop.model.coefficients, 3 * loop.model.coefficients])
    z = torch.tensor([[0.4, 0.1]] * 2, dtype=torch.float64)
    moved = loop.varied(xi).step(z, loop.steady_covariance(z), torch.zeros(2, 1))
    u = -2 * 0.4 - 2.5 * 0.1
    np.testing.assert_allclose(moved.z[:, 1], [0.1 + 0.1 * u, 0.1 + 0.3 * u], atol=1e-12)
    deep = loop.varied(xi).step(z.unsqueeze(1).expand(-1, 4, -1), loop.steady_covariance(z), torch.zeros(2, 4, 1))
    np.testing.assert_allclose(deep.z, moved.z.unsqueeze(1).expand(-1, 4, -1), atol=1e-12)


def test_a_loop_at_rest_knows_where_it_is():
    loop = make_network_loop()
    x, u = torch.tensor([[0.25, 0.0]], dtype=torch.float64), torch.tensor([[0.2]], dtype=torch.float64)  # spring 0.8
    z = loop.at(x, u)
    assert z[0, loop.parts["mean"]].tolist() == [0.25, 0.0, 0.0]
    assert z[0, loop.parts["pending"]].tolist() == [0.2, 0.2]
    moved = loop.step(z, loop.steady_covariance(z), torch.tensor([[0.3]]))
    np.testing.assert_allclose(moved.z[0, loop.parts["x"]], x[0], atol=1e-9)
    np.testing.assert_allclose(moved.z[0, loop.parts["mean"]], [0.25, 0, 0], atol=1e-7)


@pytest.mark.parametrize("spring", [1e-4, 1.0, 100.0, 1e6])
def test_the_step_is_as_long_as_the_plant_allows(spring):
    """A slow spring is passed in the steps of the controller, and ends where its cosine does, as does a fast one."""
    model, dt, longest = make_cart(spring=spring), 2.0, 0.4
    step = _longest_step(model, ControlSetup(make_task(), dt, 5))
    assert (step == longest) == (spring == 1e-4) and step >= dt / 160 and (step == dt / 160) == (spring > 1.0)
    if spring < 1e6:
        start, loop = torch.tensor([[1.0, 0.0]], dtype=torch.float64), make_loop(model=model, dt=dt, step=step)
        x = loop._move(start, torch.zeros(1, 1, 1))
        omega = math.sqrt(spring)
        assert x[0, 0].item() == pytest.approx(math.cos(omega * dt), abs=FINE)


@pytest.mark.parametrize("function", ["v^3", "force v"])
def test_the_step_is_short_where_only_large_movements_or_inputs_make_the_plant_fast(function):
    """v' = -3 v^3 has a rate of 9 v^2, up to 81 per second at 3 m/s; v' = -30 u v one of 30 per second."""
    model = SindyModel(make_cart().signature, ["v", function], known={"p": "v"})
    model.set_coefficients(torch.tensor([[1.0, 0.0], [0.0, -3.0 if function == "v^3" else -30.0]], dtype=torch.float64))
    assert _longest_step(model, ControlSetup(make_task(), 0.1)) < 0.1


@pytest.mark.parametrize(("delay", "pending"), [(0.0, 0), (0.1, 1), (0.3, 2)])
def test_a_difference_equation_moves_by_its_own_steps_however_long_those_of_the_plant_are(delay, pending):
    """p += 0.1 v, v += 0.1 (u - 0.5 v - 4 p), two of its steps in a period, inputs late by 0, 1 and 3 of them."""
    loop = make_loop(model=make_cart(delay, 0.5, 4.0, step=0.1), dt=0.2, step=0.03)
    assert loop.pending == pending
    inputs, x = np.array([1.0, 2.0, 3.0])[-1 - pending :], np.array([0.3, -0.2])
    found = loop._move(torch.from_numpy(x)[None], torch.from_numpy(inputs).reshape(1, -1, 1))
    late = round(delay / 0.1)
    for u in np.repeat(inputs, 2)[len(inputs) * 2 - 2 - late :][:2]:
        x = np.array([[1.0, 0.1], [-0.4, 0.95]]) @ x + np.array([0.0, 0.1]) * u
    assert found[0].tolist() == pytest.approx(x.tolist(), abs=1e-12)


HERE = Settings((0.0,), (0.0,), points=1, reach=0.5, draws=0)
ENDS = Settings((-0.4,), (0.4,), points=2, grid=2, draws=0)


def test_error_slew_and_saturation_are_counted():
    x = torch.zeros(2, 41, 2, dtype=torch.float64)
    x[0, :, 0], x[1, -1, 0] = 0.7, torch.nan
    u = torch.zeros(2, 40, 1, dtype=torch.float64)
    u[0, :10, 0], u[1, 0, 0], u[1, 1, 0] = 1.0, -0.6, 0.9
    full = torch.tensor([[-1.0], [1.0]])
    flights = LoopSimulation(x, u, torch.tensor([[1.0], [0.0]]), [0], 0.1, full)
    assert flights.steady_error.flatten().tolist() == pytest.approx([0.3, np.inf])
    assert flights.slew.flatten().tolist() == pytest.approx([1.0, 1.5])
    assert flights.saturated.flatten().tolist() == [0.25, 0.0]
    narrow = replace(flights, limits=torch.tensor([[-0.6], [0.9]]))  # u is beyond, within, or at both ends
    assert narrow.saturated.flatten().tolist() == [0.25, 0.05]
    falling = replace(flights, u=torch.linspace(0.9, 0.8, 40, dtype=torch.float64).reshape(1, 40, 1))
    assert falling.slew.item() == pytest.approx(0.9)  # the first command comes from zero, and the last goes nowhere


def test_the_way_of_a_fast_plant_is_no_steady_error():
    # 0.8 s of a plant that is 1 away for 0.1 s, and then rests 0.01 beside its target.
    x = torch.full((1, 401, 1), 0.01, dtype=torch.float64)
    x[:, :50] = 1.0
    full = torch.tensor([[-1.0], [1.0]])
    flights = LoopSimulation(x, torch.zeros(1, 400, 1, dtype=torch.float64), torch.zeros(1, 1), [0], 0.002, full)
    assert flights.steady_error.item() == pytest.approx(0.01)
    assert flights.end.item() == pytest.approx(0.01)
    assert not flights.away(torch.tensor([0.5])).any()
    slow = replace(flights, dt=0.05)  # 20 s: the last 5 s count
    assert slow.last == 100


def test_a_law_that_is_too_weak_for_a_hill_loses_the_plant_beyond_a_line():
    # v' = p + u with u = clamp(-3 p - 3 v) to 0.5: with p + v at most 0.5 it comes back, beyond it runs away.
    loop = make_loop(Law(3.0, 3.0, limit=0.5), make_cart(spring=-1.0))
    (plane,) = check(loop, replace(HERE, grid=9, seconds=12.0)).planes
    assert plane.names == ("p", "v")
    np.testing.assert_allclose(plane.first, np.linspace(-1, 1, 9), atol=1e-12)  # half of the ranges of 2 m and 3 m/s
    np.testing.assert_allclose(plane.second, np.linspace(-1.5, 1.5, 9), atol=1e-12)
    total = (plane.first.unsqueeze(1) + plane.second).abs()
    clear = (total - 0.5).abs() > 0.05
    assert bool((plane.back == (total < 0.5))[clear].all())
    assert plane.share == pytest.approx(float((total < 0.5).double().mean()), abs=0.1)


def test_a_loop_that_rests_beside_its_target_comes_back_to_there_and_its_error_is_told_apart():
    # v' = 2 (0 - p) - 2.5 v + 1 rests at p = 0.5, a quarter of the range of 2 m from the target.
    (plane,) = check(make_loop(Law(2.0, 2.5, bias=1.0)), replace(HERE, grid=5, seconds=20.0)).planes
    assert plane.share == 1.0
    assert plane.steady_error.tolist() == pytest.approx([0.5], abs=1e-6)


def test_an_angle_that_went_round_in_the_log_need_not_come_back_from_farther_than_a_turn():
    loop = make_loop(Law(2.0, 2.5))
    loop.signature = replace(loop.signature, state_units=("rad", "rad/s"), x_scale=(30.0, 3.0))
    (plane,) = check(loop, replace(HERE, grid=5)).planes
    assert (plane.first.max(), plane.second.max()) == (pytest.approx(math.pi), pytest.approx(1.5))


def moved(k_p, k_v, friction, target, periods, dt=0.1):
    """Positions and inputs of v' = u - friction v under a held u = clip(k_p (r - p) - k_v v), exactly."""
    left = math.exp(-friction * dt)
    p, v, places, inputs = 0.0, 0.0, [], []
    for _ in range(periods):
        u = float(np.clip(k_p * (target - p) - k_v * v, -1, 1))
        end = u / friction
        p, v = p + end * dt + (v - end) * (1 - left) / friction, end + (v - end) * left
        places.append(p)
        inputs.append(u)
    return np.array(places), np.array(inputs)


@pytest.mark.parametrize("seconds", [20.0, 3.0])
def test_swings_are_those_of_a_motion_that_is_computed_exactly(seconds):
    found = check(make_loop(Law(40.0, 1.0, limit=1.0), make_cart(friction=0.8)), replace(ENDS, seconds=seconds)).swings
    last = round(10 * seconds)
    places, inputs = moved(40.0, 1.0, 0.8, -0.4, last * LONGER)
    assert found.seconds == seconds * LONGER
    assert float(found.outputs[0]) == pytest.approx(np.ptp(places[-last:]) / 2, rel=0.02)
    assert float(found.inputs[0]) == pytest.approx(np.ptp(inputs[-last:]) / 2, rel=0.02)
    assert float(found.error[0]) == pytest.approx(np.abs(places[-last:] + 0.4).mean(), rel=0.02)


def test_swings_that_grow_have_no_size():
    found = check(make_loop(Law(-1.0, 0.0)), replace(ENDS, seconds=4.0)).swings
    assert found.outputs.isinf().all() and (found.error > 1).all()
