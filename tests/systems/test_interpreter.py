"""Formulas run by instructions, beside NumPy and the closed solutions of textbooks."""

import numpy as np
import pytest
import torch

from dynasindy.systems.interpreter import MeasurementUpdate, simulate_program, simulate_sensitivities
from dynasindy.systems.machine import Program

ROWS = 70  # more than are handled at once, and no multiple of that


def numbers(*shape, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).uniform(-2, 2, shape))


@pytest.mark.parametrize(
    ("formula", "known"),
    [
        ("x[0] + 2 * x[1] - u[0] / x[1]", lambda a, b, u: a + 2 * b - u / b),
        ("-sin(x[0]) * cos(x[1])", lambda a, b, u: -np.sin(a) * np.cos(b)),
        ("exp(x[0]) + tanh(k[0] * u[0])", lambda a, b, u: np.exp(a) + np.tanh(1.5 * u)),
        ("sqrt(square(x[0])) - fabs(x[1])", lambda a, b, u: np.abs(a) - np.abs(b)),
        ("sign(x[0]) * larger(x[1], k[1])", lambda a, b, u: np.sign(a) * np.maximum(b, -0.25)),
        ("0.0", lambda a, b, u: 0 * a),
    ],
)
def test_a_formula_says_what_numpy_says(formula, known):
    x, u = numbers(ROWS, 2), numbers(ROWS, 1, 1, seed=1)
    program = Program(2, 1, (("v0", formula),), ("v0", "x[0]"), (1.5, -0.25), step=1.0)
    change = (simulate_program(program, x, u, 1.0, 1)[:, 0] - x).numpy()
    a, b = x.T.numpy()
    np.testing.assert_allclose(change[:, 0], known(a, b, u[:, 0, 0].numpy()), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(change[:, 1], a, rtol=1e-12)


def test_an_oscillator_swings_as_its_solution_and_rows_do_not_mix():
    x, u = numbers(ROWS, 2), torch.zeros(ROWS, 50, 0, dtype=torch.float64)
    ends = simulate_program(Program(2, 0, (), ("x[1]", "-x[0]")), x, u, 0.02, 4).numpy()
    a, b = x.T.numpy()[..., None]
    t = 0.02 * np.arange(1, 51)
    np.testing.assert_allclose(ends[..., 0], a * np.cos(t) + b * np.sin(t), atol=1e-9)
    np.testing.assert_allclose(ends[..., 1], b * np.cos(t) - a * np.sin(t), atol=1e-9)


def test_inputs_are_held_over_their_period():
    u = numbers(3, 20, 1)
    ends = simulate_program(Program(1, 1, (), ("u[0]",)), torch.zeros(3, 1, dtype=torch.float64), u, 0.1, 2)
    np.testing.assert_allclose(ends, 0.1 * u.cumsum(1), atol=1e-12)


def test_rates_of_a_sparse_model_have_the_slopes_on_paper():
    """a' = 2 sin(a) + u b^2 / 2 and b' = -3 b sin(a), where sin(a) is computed once; a step of 1 s adds the states."""
    functions = Program(2, 1, (("v0", "sin(x[0])"),), ("v0", "v0 * x[1]", "u[0] * square(x[1])"), step=1.0)
    xi = torch.tensor([[2.0, 0.0], [0.0, -3.0], [0.5, 0.0]], dtype=torch.float64)
    x, u = numbers(ROWS, 2), numbers(ROWS, 1, seed=1)
    (a, b), v = x.T.numpy(), u[:, 0].numpy()
    wanted = [[1 + 2 * np.cos(a), v * b], [-3 * b * np.cos(a), 1 - 3 * np.sin(a)]]
    none = torch.zeros(0, dtype=torch.int64)
    found = simulate_sensitivities(functions, (), xi, (none, none), x, u.unsqueeze(1), 1.0, 1)[1][:, 0]
    np.testing.assert_allclose(found.permute(1, 2, 0), wanted, rtol=1e-11, atol=1e-12)


def theta(x, u, k):
    """Three functions of three states and two inputs, in NumPy: two numbers lie inside of them."""
    return np.stack([np.tanh(k[0] * x[:, 0]) * x[:, 2], np.sin(x[:, 1] - k[1] * u[:, 1]), x[:, 0] * u[:, 0]], -1)


def plain(x, u, u_end, k, xi, gain, measured, substeps, dt=0.1):
    """Runge-Kutta steps of x' = theta xi under inputs that move in a line, corrected by what was measured."""
    ends = []
    for t in range(u.shape[1]):
        h, slope = dt / substeps, (u_end[:, t] - u[:, t]) / substeps
        for s in range(substeps):
            held = u[:, t] + s * slope
            k1 = theta(x, held, k) @ xi
            k2 = theta(x + 0.5 * h * k1, held + 0.5 * slope, k) @ xi
            k3 = theta(x + 0.5 * h * k2, held + 0.5 * slope, k) @ xi
            k4 = theta(x + h * k3, held + slope, k) @ xi
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        ends.append(x)
        x = x + np.nan_to_num(measured[:, t] - x) @ gain.T
    return np.stack(ends, 1)


@pytest.mark.parametrize("rows", [1, ROWS])
@pytest.mark.parametrize("substeps", [1, 3])
def test_slopes_by_all_there_is_are_differences_of_a_plain_loop(rows, substeps):
    """By states, free elements of the gain, numbers inside functions and coefficients, in this order."""
    functions = Program(3, 2, (), ("tanh(k[0]*x[0])*x[2]", "sin(x[1] - k[1]*u[1])", "x[0]*u[0]"), (0.8, 1.7))
    rng = np.random.default_rng(3)
    x, u, u_end, measured = (rng.normal(size=shape) for shape in ((rows, 3), *[(rows, 4, 2)] * 2, (rows, 4, 3)))
    measured[:, 1:3, 1] = np.nan
    xi = np.array([[0.7, 0.0, -1.1], [0.0, 1.3, 0.4], [-0.6, 0.9, 0.0]])
    gain, k = 0.2 * rng.normal(size=(3, 3)), np.array([0.8, 1.7])
    free, fitted = ([0, 2, 1], [1, 2, 0]), ([0, 2, 1, 2], [2, 1, 1, 0])
    update = MeasurementUpdate(torch.from_numpy(measured), torch.from_numpy(gain), torch.tensor(free))
    given = [torch.from_numpy(part) for part in (xi, x, u, u_end)]
    found, slopes = simulate_sensitivities(
        functions, (0, 1), given[0], tuple(map(torch.tensor, fitted)), *given[1:3], 0.1, substeps, given[3], update
    )
    numbers = {"x": x, "gain": gain, "k": k, "xi": xi}
    rest = {"u": u, "u_end": u_end, "measured": measured, "substeps": substeps}
    np.testing.assert_allclose(found, plain(**numbers, **rest), rtol=1e-11, atol=1e-12)
    places = [("x", (slice(None), i)) for i in range(3)] + [("gain", place) for place in zip(*free)]
    places += [("k", (0,)), ("k", (1,))] + [("xi", place) for place in zip(*fitted)]
    assert slopes.shape == (rows, 4, 3, len(places))
    for column, (name, place) in enumerate(places):
        ends = []
        for step in (1e-5, -1e-5):
            moved = numbers[name].copy()
            moved[place] += step
            ends.append(plain(**{**numbers, name: moved}, **rest))
        np.testing.assert_allclose(slopes[..., column], (ends[0] - ends[1]) / 2e-5, rtol=1e-6, atol=1e-8)
