"""Inputs that move in straight lines from sample to sample, beside SciPy's first-order hold and its integrators."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.signal import cont2discrete, lsim

from dynasindy.identification.forecast_errors import forecast_errors, with_start_states
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.sindy.shooting import Descent, Windows
from dynasindy.sindy.world_model import one_step_error, open_loop
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

DT = 0.1
SIGNATURE = Signature(("p", "v"), ("m", "m/s"), ("f", "g"), (1.0, 1.0))
A, B = np.array([[0.0, 1.0], [-4.0, -0.5]]), np.array([[0.0, 0.0], [3.0, -2.0]])


def noise(n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 2))


def linear_plant(machine_code):
    model = SindyModel(SIGNATURE, ["p", "v", "f", "g"], machine_code=machine_code)
    model.set_coefficients(torch.from_numpy(np.vstack([A.T, B.T])))
    return model


def swung(n, seed=0):
    """A trajectory of the linear plant by SciPy, under inputs linear between samples."""
    u = noise(n + 1, seed)
    _, _, x = lsim((A, B, np.eye(2), np.zeros((2, 2))), u, DT * np.arange(n + 1), interp=True)
    data = Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u), DT)
    return Transitions(data.x, data.u, data.x_next, DT, data.segment, u_end=torch.from_numpy(u[1:]))


@pytest.mark.parametrize("machine_code", [True, False])
def test_a_model_moves_as_scipy_says(machine_code):
    data, model = swung(60), linear_plant(machine_code)
    torch.testing.assert_close(open_loop(model, data, 10), data.x_next, rtol=0, atol=1e-7)
    assert float(one_step_error(model, data, 10).max()) < 1e-7
    held = Transitions(data.x, data.u, data.x_next, DT, data.segment)
    assert float(one_step_error(model, held, 10).max()) > 0.05
    # A single held input beside one that moves: by the discrete matrices of both holds.
    foh, zoh = (cont2discrete((A, B, np.eye(2), np.zeros((2, 2))), DT, method) for method in ("foh", "zoh"))
    u, after, x = torch.tensor([[0.7, -0.3]]), torch.tensor([[-0.2, -0.3]]), torch.tensor([[0.5, 0.1]])
    end = model.simulate(x.double(), u.double().unsqueeze(1), DT, 10, after.double().unsqueeze(1))[0, 1].numpy()
    # SciPy's state of a first-order hold is x less the last of three matrices, of u at the same time.
    shift = foh[3]
    begin = x.numpy()[0] - shift @ u.numpy()[0]
    wanted = foh[0] @ begin + foh[1] @ u.numpy()[0] + shift @ after.numpy()[0]
    np.testing.assert_allclose(end, wanted, atol=1e-7)
    assert np.abs(end - (zoh[0] @ x.numpy()[0] + zoh[1] @ u.numpy()[0])).max() > 0.01


@pytest.mark.parametrize(("method", "close"), [("integral", 2e-3), ("one_step", 1e-5), ("trajectory", 1e-5)])
def test_a_fit_reads_both_ends(method, close):
    data, errors = swung(300), []
    for inputs in (data.u_end, None):
        words = ["p", "v", "f", "g", "p^2"]
        model = SindyModel(SIGNATURE, words, Regression("bic"), Refinement(method), known={"p": "v"})
        model.fit(replace(data, u_end=inputs))
        errors.append(np.abs(model.coefficients[:, 1].numpy() - [*A[1], *B[1], 0.0]).max())
    assert errors[0] < close < 0.03 < errors[1]


def test_inputs_at_ends_go_with_their_rows():
    x, u = torch.arange(14.0).reshape(7, 2), torch.arange(12.0).reshape(6, 2).square()
    data = Transitions(x[:-1], u, x[1:], DT, torch.tensor([0, 0, 0, 0, 1, 1]))
    moved = data.with_linear_inputs([True, False])
    assert moved.u_end[:, 0].tolist() == [4, 16, 36, 36, 100, 100] and torch.equal(moved.u_end[:, 1], u[:, 1])
    assert moved.linear_inputs.tolist() == [True, False] and data.linear_inputs.tolist() == [False, False]
    assert data.with_linear_inputs().u_end[:, 1].tolist() == [9, 25, 49, 49, 121, 121]
    assert data.with_linear_inputs([False, False]).u_end is None
    assert moved.mean_inputs[:3, 0].tolist() == [2, 10, 26] and torch.equal(data.mean_inputs, u)
    rows = torch.tensor([True, False, True, True, False, True])
    assert moved.select(rows).u_end[:, 0].tolist() == [4, 36, 36, 100]
    assert moved.select(torch.arange(6) >= 4).to(torch.float64).u_end.tolist() == [[100, 81], [100, 121]]
    both = Transitions.cat([data, moved])
    assert torch.equal(both.u_end, torch.cat([u, moved.u_end])) and Transitions.cat([data, data]).u_end is None
    with pytest.raises(ValueError, match="shapes"):
        Transitions(x[:-1], u, x[1:], DT, data.segment, u_end=u[1:])
    windows = Windows.of(moved, Descent(3))
    assert windows.last_inputs[0, :, 0].tolist() == [4, 16, 36] and Windows.of(data, Descent(3)).last_inputs is None


@pytest.mark.parametrize("delay", [0.05, 0.1, 0.13, 0.2])
def test_a_delayed_line_is_that_line_at_both_ends(delay):
    data = swung(30)
    late, t = delay_inputs(data, delay), DT * np.arange(31)
    lines = np.vstack([data.u.numpy(), data.u_end[-1:].numpy()])
    for ours, times in ((late.u, t[:-1]), (late.u_end, t[1:])):
        wanted = [np.interp(times - delay, t, column) for column in lines.T]
        np.testing.assert_allclose(ours.numpy().T, wanted, atol=1e-12)


def test_forecasts_and_start_states_read_both_ends():
    model, data = linear_plant(True), swung(400, seed=2)
    training, validation = data.select(torch.arange(400) < 200), data.select(torch.arange(400) >= 200)
    assert float(forecast_errors(model, training, validation, [0.5, 2.0]).model.max()) < 1e-6
    held = [Transitions(part.x, part.u, part.x_next, DT, part.segment) for part in (training, validation)]
    assert float(forecast_errors(model, *held, [0.5, 2.0]).model.max()) > 0.01
    begun = with_start_states(model, validation)
    torch.testing.assert_close(begun.x[0], validation.x[0], rtol=0, atol=1e-6)
