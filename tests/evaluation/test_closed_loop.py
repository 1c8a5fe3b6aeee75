"""The loop as one map does, step for step, what the controller does with a plant in a plain loop."""

import math

import numpy as np
import pytest
import torch

from dynasindy.control.controller import ControlSetup
from dynasindy.evaluation.closed_loop import FINE, _longest_step
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
def test_it_flies_as_the_controller_does(networks, disturbance, delay, late, integral):
    loop = networks(delay, disturbance, late, integral)
    x = torch.tensor([0.2, -0.5], dtype=torch.float64)
    expected, commands = flown(loop, x, [0.3], 60)
    found, u = stepped(loop, x, [0.3], 60)
    assert commands.std() > 1e-3 and expected.std(0).min() > 1e-2
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)  # the controller has float32 weights and values
    np.testing.assert_allclose(u, commands, rtol=0, atol=2e-5)


def test_a_loop_holds_what_its_controller_remembers_and_nothing_else(loops):
    def parts(**settings):
        return {name: part for name, part in loops(**settings).parts.items() if part.stop > part.start}

    assert parts() == {"x": slice(0, 2)}
    assert parts(integral={}) == {"x": slice(0, 2), "integral": slice(2, 3)}
    # A measurement under way, three commands that the observer remembers, and its estimate.
    late = {"x": slice(0, 2), "late": slice(2, 4), "inputs": slice(4, 7), "mean": slice(7, 9)}
    assert parts(observer={"delay": 1}) == late


def test_a_law_of_all_states_is_the_map_that_is_written_down(loops):
    # p + dt v + dt^2/2 u, v + dt u with u = 2 (r - p) - 2.5 v, and dt = 0.1.
    loop = loops()
    z = torch.tensor([[0.4, -0.2], [0.0, 1.0]], dtype=torch.float64)
    moved = loop.step(z, loop.steady_covariance(z), torch.tensor([[1.0], [0.5]]))
    u = 2 * (torch.tensor([1.0, 0.5]) - z[:, 0]) - 2.5 * z[:, 1]
    np.testing.assert_allclose(moved.u[:, 0], u, atol=1e-12)
    expected = torch.stack([z[:, 0] + 0.1 * z[:, 1] + 0.005 * u, z[:, 1] + 0.1 * u], -1)
    np.testing.assert_allclose(moved.z, expected, atol=1e-12)


def test_what_is_added_reaches_the_plant_and_noise_the_controller(loops):
    loop = loops()
    z, r = torch.zeros(1, 2, dtype=torch.float64), torch.zeros(1, 1)
    pushed = loop.step(z, loop.steady_covariance(z), r, extra=0.3)
    assert pushed.u.item() == 0 and pushed.z[0, 1].item() == pytest.approx(0.03)
    disturbed = loop.step(z, loop.steady_covariance(z), r, noise=torch.tensor([[0.1, 0.2]]))
    assert disturbed.u.item() == pytest.approx(-2 * 0.1 - 2.5 * 0.2)


def test_rows_may_have_coefficients_of_their_own(loops):
    loop = loops()
    xi = torch.stack([loop.model.coefficients, 3 * loop.model.coefficients])
    z = torch.tensor([[0.4, 0.1]] * 2, dtype=torch.float64)
    moved = loop.varied(xi).step(z, loop.steady_covariance(z), torch.zeros(2, 1))
    u = -2 * 0.4 - 2.5 * 0.1
    np.testing.assert_allclose(moved.z[:, 1], [0.1 + 0.1 * u, 0.1 + 0.3 * u], atol=1e-12)
    deep = loop.varied(xi).step(z.unsqueeze(1).expand(-1, 4, -1), loop.steady_covariance(z), torch.zeros(2, 4, 1))
    np.testing.assert_allclose(deep.z, moved.z.unsqueeze(1).expand(-1, 4, -1), atol=1e-12)


def test_a_loop_at_rest_knows_where_it_is(networks):
    loop = networks()
    x, u = torch.tensor([[0.25, 0.0]], dtype=torch.float64), torch.tensor([[0.2]], dtype=torch.float64)  # spring 0.8
    z = loop.at(x, u)
    assert z[0, loop.parts["mean"]].tolist() == [0.25, 0.0, 0.0]
    assert z[0, loop.parts["pending"]].tolist() == [0.2, 0.2]
    moved = loop.step(z, loop.steady_covariance(z), torch.tensor([[0.3]]))
    np.testing.assert_allclose(moved.z[0, loop.parts["x"]], x[0], atol=1e-9)
    np.testing.assert_allclose(moved.z[0, loop.parts["mean"]], [0.25, 0, 0], atol=1e-7)


@pytest.mark.parametrize("spring", [1e-4, 1.0, 100.0, 1e6])
def test_the_step_is_as_long_as_the_plant_allows(carts, loops, tasks, spring):
    """A slow spring is passed in the steps of the controller, and ends where its cosine does, as does a fast one."""
    model, dt, longest = carts(spring=spring), 2.0, 0.4
    step = _longest_step(model, ControlSetup(tasks(), dt, 5))
    assert (step == longest) == (spring == 1e-4) and step >= dt / 160 and (step == dt / 160) == (spring > 1.0)
    if spring < 1e6:
        start, loop = torch.tensor([[1.0, 0.0]], dtype=torch.float64), loops(model=model, dt=dt, step=step)
        x = loop._move(start, torch.zeros(1, 1, 1))
        omega = math.sqrt(spring)
        assert x[0, 0].item() == pytest.approx(math.cos(omega * dt), abs=FINE)


@pytest.mark.parametrize("function", ["v^3", "force v"])
def test_the_step_is_short_where_only_large_movements_or_inputs_make_the_plant_fast(carts, tasks, function):
    """v' = -3 v^3 has a rate of 9 v^2, up to 81 per second at 3 m/s; v' = -30 u v one of 30 per second."""
    model = SindyModel(carts().signature, ["v", function], known={"p": "v"})
    model.set_coefficients(torch.tensor([[1.0, 0.0], [0.0, -3.0 if function == "v^3" else -30.0]], dtype=torch.float64))
    assert _longest_step(model, ControlSetup(tasks(), 0.1)) < 0.1


@pytest.mark.parametrize(("delay", "pending"), [(0.0, 0), (0.1, 1), (0.3, 2)])
def test_a_difference_equation_moves_by_its_own_steps_however_long_those_of_the_plant_are(carts, loops, delay, pending):
    """p += 0.1 v, v += 0.1 (u - 0.5 v - 4 p), two of its steps in a period, inputs late by 0, 1 and 3 of them."""
    loop = loops(model=carts(delay, 0.5, 4.0, step=0.1), dt=0.2, step=0.03)
    assert loop.pending == pending
    inputs, x = np.array([1.0, 2.0, 3.0])[-1 - pending :], np.array([0.3, -0.2])
    found = loop._move(torch.from_numpy(x)[None], torch.from_numpy(inputs).reshape(1, -1, 1))
    late = round(delay / 0.1)
    for u in np.repeat(inputs, 2)[len(inputs) * 2 - 2 - late :][:2]:
        x = np.array([[1.0, 0.1], [-0.4, 0.95]]) @ x + np.array([0.0, 0.1]) * u
    assert found[0].tolist() == pytest.approx(x.tolist(), abs=1e-12)
