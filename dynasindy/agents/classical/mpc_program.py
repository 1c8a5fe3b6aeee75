"""The program that MPC solves every control period: the least cost over the horizon, with every input in [-1, 1].

Symbols are those of `dynasindy.agents.classical.mpc`. A plan is `(rows, n_blocks, n_u)`, a row per episode of a batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from dynasindy.agents.classical.mpc_prediction import Predictor
from dynasindy.agents.classical.symbolic import casadi
from dynasindy.systems import System

Array = np.ndarray

LENGTHS = (1.0, 0.5, 0.25, 0.1)
"""Shares of a Gauss-Newton step that are tried."""
SETTLED = 1e-3
"""Largest change of an input at which a plan is left as it is."""


@dataclass(frozen=True)
class Horizon:
    """How far and how finely MPC plans.

    Attributes:
        blocks: control periods in which each planned input is held; their sum is the horizon.
        iterations: Gauss-Newton steps per control period, at most.
        substeps: Runge-Kutta steps per control period.
    """

    blocks: Sequence[int] = (1, 1, 1, 1, 2, 2, 2, 2, 4, 4, 4, 4, 4, 4)
    iterations: int = 5
    substeps: int = 1


@dataclass(frozen=True)
class Weights:
    """Weights of the program as arrays.

    Attributes:
        error: Q, `(n_r,)`.
        input: R, `(n_u,)`.
        change: S, `(n_u,)`.
        end: P, cost to go of state and last input, `(n_x + n_u, n_x + n_u)`.
    """

    error: Array
    input: Array
    change: Array
    end: Array


@dataclass(frozen=True)
class Problem:
    """What a plan is made for, one row per episode of a batch.

    Attributes:
        x: states now, `(rows, n_x)`.
        last: input that holds now, `(rows, n_u)`.
        future: reference ahead, `(rows, n_periods, n_r)`.
        x_e: state to arrive at, `(rows, n_x)`.
        u_e: input that holds it there, `(rows, n_u)`.
        drift: d, `(rows, n_x)`.
    """

    x: Array
    last: Array
    future: Array
    x_e: Array
    u_e: Array
    drift: Array

    def of(self, rows: Array) -> Problem:
        """Return the problem of some rows."""
        return Problem(*(getattr(self, field.name)[rows] for field in fields(self)))


class Program:
    """Cost of a plan, and its descent by Gauss-Newton steps.

    Args:
        system: the model.
        dt: control period [s].
        outputs: places of the tracked states in the state.
        weights: weights of the cost.
        horizon: how far it plans.

    Raises:
        ModuleNotFoundError: CasADi is not installed.
        ValueError: there are no blocks, or blocks, iterations or substeps are less than 1.
    """

    def __init__(self, system: System, dt: float, outputs: Sequence[int], weights: Weights, horizon: Horizon) -> None:
        blocks = list(horizon.blocks)
        if not blocks or min(blocks) < 1 or min(horizon.iterations, horizon.substeps) < 1:
            raise ValueError(f"{horizon} must have blocks, iterations and substeps of 1 or more; mend it")
        self.outputs, self.weights, self.iterations = outputs, weights, horizon.iterations
        self.block_of = np.repeat(np.arange(len(blocks)), blocks)
        self.lengths = np.array(blocks, dtype=float)[:, None]
        self.starts = np.cumsum([0, *blocks[:-1]])
        self.predictor = Predictor(system, dt, len(self.block_of), horizon.substeps)
        self.inner = _Quadratic(len(blocks) * system.signature.n_u)

    def moved_on(self, plan: Array) -> Array:
        """Return a plan, one period later."""
        periods = plan[:, self.block_of]
        return periods[:, np.minimum(self.starts + 1, len(self.block_of) - 1)]

    def improved(self, plan: Array, problem: Problem) -> Array:
        """Return the plan after Gauss-Newton steps; a row that has settled is left alone."""
        plan, open_rows = plan.copy(), np.arange(len(plan))
        for _ in range(self.iterations):
            mine = problem.of(open_rows)
            plan[open_rows], change = self._stepped(plan[open_rows], mine)
            open_rows = open_rows[change > SETTLED]
            if not len(open_rows):
                break
        return plan

    def _stepped(self, plan: Array, problem: Problem) -> tuple[Array, Array]:
        """Return the plan after the longest share of a Gauss-Newton step that lowers the cost, and its change."""
        states, step = self._step(plan, problem)
        cost, start, taken = self._cost(states, plan, problem), plan, np.abs(step).max((1, 2)) < SETTLED
        plan = np.where(taken[:, None, None], plan + step, plan)
        for length in LENGTHS:
            if taken.all():
                break
            trial = np.clip(start + length * step, -1.0, 1.0)
            states = self.predictor.states(problem.x, trial[:, self.block_of], problem.drift)
            better = ~taken & (self._cost(states, trial, problem) < cost)
            plan, taken = np.where(better[:, None, None], trial, plan), taken | better
        return np.clip(plan, -1.0, 1.0), np.abs(plan - start).max((1, 2))

    def _cost(self, states: Array, plan: Array, problem: Problem) -> Array:
        """Return the cost of a plan and the states it leads to, `(rows,)`."""
        error = states[:, :-1, self.outputs] - problem.future[:, :-1]
        deviation, change = self._moves(plan, problem)
        end = np.concatenate((states[:, -1] - problem.x_e, plan[:, -1] - problem.u_e), 1)
        inputs: Array = (self.lengths * self.weights.input * deviation**2 + self.weights.change * change**2).sum((1, 2))
        return (
            inputs + (self.weights.error * error**2).sum((1, 2)) + np.einsum("bi,ij,bj->b", end, self.weights.end, end)
        )

    def _step(self, plan: Array, problem: Problem) -> tuple[Array, Array]:
        """Return the states of a plan, `(rows, n_periods, n_x)`, and the Gauss-Newton step, shaped as the plan."""
        n_rows, n_blocks, n_u = plan.shape
        n_periods, n_x = len(self.block_of), problem.x.shape[1]
        states, a, b = self.predictor.along(problem.x, plan[:, self.block_of], problem.drift)
        slope = np.zeros((n_rows, n_x, n_blocks * n_u))
        hessian, gradient = self._input_cost(plan, problem)
        for k in range(n_periods):
            slope = a[:, k] @ slope
            column = self.block_of[k] * n_u
            slope[:, :, column : column + n_u] += b[:, k]
            if k < n_periods - 1:
                outputs = slope[:, self.outputs]
                weighted = outputs.transpose(0, 2, 1) * self.weights.error
                hessian += weighted @ outputs
                error = states[:, k][:, self.outputs] - problem.future[:, k]
                gradient += (weighted @ error[..., None])[..., 0]
        chooses = np.zeros((n_rows, n_u, n_blocks * n_u))
        chooses[:, :, -n_u:] = np.eye(n_u)
        ends = np.concatenate((slope, chooses), 1)
        weighted = ends.transpose(0, 2, 1) @ self.weights.end
        deviation = np.concatenate((states[:, -1] - problem.x_e, plan[:, -1] - problem.u_e), 1)
        hessian += weighted @ ends
        gradient += (weighted @ deviation[..., None])[..., 0]
        return states, self.inner.solve(hessian, gradient, plan.reshape(n_rows, -1)).reshape(plan.shape)

    def _moves(self, plan: Array, problem: Problem) -> tuple[Array, Array]:
        """Return the inputs' deviations from their target and their changes, each shaped as the plan."""
        return plan - problem.u_e[:, None], np.diff(np.concatenate((problem.last[:, None], plan), 1), axis=1)

    def _input_cost(self, plan: Array, problem: Problem) -> tuple[Array, Array]:
        """Return Hessian and gradient of the cost of the inputs and their changes, halved."""
        n_rows, n_blocks, _ = plan.shape
        differences = np.eye(n_blocks) - np.eye(n_blocks, k=-1)
        deviation, change = self._moves(plan, problem)
        gradient = self.lengths * self.weights.input * deviation + np.einsum(
            "ji,bjm->bim", differences, self.weights.change * change
        )
        hessian = np.kron(np.diag(self.lengths[:, 0]), np.diag(self.weights.input))
        hessian = hessian + np.kron(differences.T @ differences, np.diag(self.weights.change))
        return np.repeat(hessian[None], n_rows, 0), gradient.reshape(n_rows, -1)


class _Quadratic:
    """The quadratic program in the inputs: least 1/2 v' H v + g' v with every input in [-1, 1].

    Args:
        n: number of inputs.
    """

    def __init__(self, n: int) -> None:
        ca = casadi()
        shape = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity(0, n)}
        self.solver = ca.conic("program", "daqp", shape)

    def solve(self, hessian: Array, gradient: Array, plan: Array) -> Array:
        """Return the change `(rows, n)` of a plan `(rows, n)`."""
        low, high = -1.0 - plan, 1.0 - plan
        free = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
        change = np.clip(free, low, high)
        for row in np.nonzero((free != change).any(-1))[0]:  # only where a limit binds
            found = self.solver(h=hessian[row], g=gradient[row], lbx=low[row], ubx=high[row])
            change[row] = found["x"].full()[:, 0]
        return change
