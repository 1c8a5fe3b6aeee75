"""The prediction against the plant's own integrator and its finite differences."""

import numpy as np
import pytest
import torch

from dynasindy.agents.classical.mpc_prediction import Predictor
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, Tras
from dynasindy.systems.integrators import rk4

pytest.importorskip("casadi")

PERIODS, SUBSTEPS, DT = 3, 2, 0.05
RANGES = np.array(Tras().signature.x_scale)


@pytest.fixture(scope="module")
def predictor():
    return Predictor(Tras(), DT, PERIODS, SUBSTEPS)


def drawn(rows):
    rng = np.random.default_rng(0)
    x = 0.3 * RANGES * rng.standard_normal((rows, 6))
    return x, rng.uniform(-1, 1, (rows, PERIODS, 2)), 0.01 * RANGES * rng.standard_normal((rows, 6))


def stepped(x, u):
    state, held = torch.as_tensor(x), torch.as_tensor(u)
    for _ in range(SUBSTEPS):
        state = rk4(Tras(), state, held, DT / SUBSTEPS)
    return state.numpy()


@pytest.mark.parametrize("rows", [1, 4])
def test_states_are_those_of_the_integrator_and_the_model_error(predictor, rows):
    x, u, d = drawn(rows)
    np.testing.assert_allclose(predictor.one(x, u[:, 0]), stepped(x, u[:, 0]), rtol=1e-10, atol=1e-12)
    states = predictor.states(x, u, d)
    for k in range(PERIODS):
        x = stepped(x, u[:, k]) + d
        np.testing.assert_allclose(states[:, k], x, rtol=1e-9, atol=1e-11)


def test_slopes_are_finite_differences_on_the_way(predictor):
    x, u, d = drawn(2)
    states, a, b = predictor.along(x, u, d)
    np.testing.assert_array_equal(states, predictor.states(x, u, d))
    before = states[:, -2]
    for place, by in enumerate(1e-5 * RANGES * np.eye(6)):
        slope = (stepped(before + by, u[:, -1]) - stepped(before - by, u[:, -1])) / (2 * by[place])
        np.testing.assert_allclose(a[:, -1, :, place] / RANGES, slope / RANGES, rtol=1e-5, atol=1e-7)
    for place, by in enumerate(1e-5 * np.eye(2)):
        slope = (stepped(before, u[:, -1] + by) - stepped(before, u[:, -1] - by)) / 2e-5
        np.testing.assert_allclose(b[:, -1, :, place] / RANGES, slope / RANGES, rtol=1e-5, atol=1e-7)


def test_a_difference_equation_is_predicted_by_its_own_steps():
    """x[k+1] = -0.6 x[k] + 0.3 u[k], two steps to a period: 0.36 x + 0.12 u."""
    model = SindyModel(Signature(("x",), ("-",), ("u",), (1.0,)), ["x", "u"], time="discrete")
    model.library = model.library.with_step(0.1)
    model.set_coefficients(torch.tensor([[-16.0], [3.0]], dtype=torch.float64))
    found = Predictor(model, 0.2, 3, 5).one(np.array([[2.0], [-1.0]]), np.array([[5.0], [0.5]]))
    np.testing.assert_allclose(found, [[1.32], [-0.3]], rtol=1e-12)
