"""The program against a general solver, and how plans are moved on."""

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from scipy.signal import cont2discrete

from dynasindy.agents.classical.mpc_program import Horizon, Problem, Program, Weights
from dynasindy.systems import Signature, System

pytest.importorskip("casadi")

A = np.array([[0.0, 1.0], [-2.0, -0.3]])
B = np.array([[0.0], [4.0]])
END = np.array([[9.0, 1.0, 0.1], [1.0, 3.0, 0.2], [0.1, 0.2, 0.5]])
BLOCKS = (1, 2, 3)
X, LAST, TARGET, X_E, U_E, DRIFT = (
    np.array(values) for values in ([-0.8, -1.0], [0.1], [0.3], [0.3, 0.0], [0.15], [0.01, -0.02])
)


class Linear(System):
    """A mass on a spring; x'' = 4 u - 2 x - 0.3 x'."""

    def __init__(self):
        super().__init__(Signature(("y", "v"), ("m", "m/s"), ("u",), (1.0, 2.0)))

    def forward(self, x, u):
        y, v = x.unbind(-1)
        return torch.stack((v, 4 * u[..., 0] - 2 * y - 0.3 * v), -1)


def program(**horizon):
    weights = Weights(np.array([1.0]), np.array([0.01]), np.array([0.02]), END)
    return Program(Linear(), 0.05, [0], weights, Horizon(BLOCKS, **horizon))


def problem(*states):
    rows = len(states)
    others = (np.tile(value, (rows, 1)) for value in (LAST, X_E, U_E, DRIFT))
    last, x_e, u_e, drift = others
    return Problem(np.array(states), last, np.tile(TARGET, (rows, sum(BLOCKS), 1)), x_e, u_e, drift)


def cost(plan, x):
    """Return the cost of one input per block, by the discrete equations of the spring."""
    a, b = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), 0.05)[:2]
    total, last = 0.0, LAST[0]
    for k, u in enumerate(np.repeat(plan, BLOCKS)):
        total += (x[0] - TARGET[0]) ** 2 * (k > 0) + 0.01 * (u - U_E[0]) ** 2 + 0.02 * (u - last) ** 2
        x, last = a @ x + b[:, 0] * u + DRIFT, u
    end = np.append(x - X_E, last - U_E[0])
    return total + end @ END @ end


def test_within_limits_the_plan_is_that_of_a_general_solver():
    starts = [X, np.array([0.25, 0.1])]
    plans = program(iterations=3).improved(np.zeros((2, 3, 1)), problem(*starts))
    found = [minimize(cost, np.zeros(3), (x,), bounds=[(-1, 1)] * 3, tol=1e-12).x for x in starts]
    assert found[0][0] == pytest.approx(1.0)  # the limit binds
    assert np.abs(found[1]).max() < 1.0  # no limit binds
    np.testing.assert_allclose(plans[..., 0], found, atol=2e-3)


def test_a_plan_that_is_the_best_is_left_alone():
    settled = program(iterations=5).improved(np.zeros((1, 3, 1)), problem(X))
    np.testing.assert_allclose(program(iterations=1).improved(settled, problem(X)), settled, atol=1e-6)


def test_a_plan_is_moved_on_by_a_period():
    plan = np.array([[[0.1], [0.2], [0.3]]])  # held for 1, 2 and 3 periods
    np.testing.assert_array_equal(program().moved_on(plan)[0, :, 0], [0.2, 0.2, 0.3])


@pytest.mark.parametrize("wrong", [{"blocks": ()}, {"blocks": (1, 0)}, {"iterations": 0}, {"substeps": 0}])
def test_impossible_horizons_are_refused(wrong):
    weights = Weights(*(np.ones(1),) * 3, END)
    with pytest.raises(ValueError, match="must have blocks, iterations and substeps of 1 or more"):
        Program(Linear(), 0.05, [0], weights, Horizon(**wrong))


@pytest.mark.parametrize(("overshoot", "share"), [(1.5, 1.0), (3, 0.5), (6, 0.25), (15, 0.1), (30, 0.0)])
def test_the_longest_share_of_a_step_that_lowers_the_cost_is_taken(overshoot, share):
    # Within the limits the cost is a parabola: it is lower up to twice the way to its least point.
    made, start = program(), problem(np.array([0.25, 0.1]))
    best = program(iterations=9).improved(np.zeros((1, 3, 1)), start)
    plan = best + np.array([0.01, -0.01, 0.005])[None, :, None]
    step, full = overshoot * (best - plan), made._step
    made._step = lambda *of: (full(*of)[0], step)
    found, change = made._stepped(plan, start)
    np.testing.assert_allclose(found, plan + share * step, atol=1e-12)
    assert change[0] == pytest.approx(share * overshoot * 0.01, abs=1e-9)
