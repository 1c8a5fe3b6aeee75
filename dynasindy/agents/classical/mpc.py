"""Nonlinear model predictive control on any system: a plant, or a model that was identified from its data.

| Name                | Symbol   | Unit             | Equation                                                    |
| ------------------- | -------- | ---------------- | ----------------------------------------------------------- |
| prediction          | F        | the state's      | x[k+1] = F(x[k], u[k]) + d, one Runge-Kutta step            |
| model error         | d        | the state's      | d <- d + L (x[k] - F(x[k-1], u[k-1]) - d)                   |
| inputs              | u        | 1                | one per block of periods, in [-1, 1]                        |
| target              | x_e, u_e | the system's     | f(x_e, u_e) = dr/dt at the outputs, less d / dt             |
| weights             | Q, R, S  | per square       | sum of Q (r - y)^2 + R (u - u_e)^2 + S (change of u)^2      |
| cost to go          | P        | -                | discrete Riccati equation of the linearisation at the origin |

Every control period begins with the last plan, moved on by a period (Diehl, Bock, Schloeder 2005), and makes
Gauss-Newton steps until the plan changes no more: simulate, linearise along the simulation, eliminate the states,
solve the quadratic program in the inputs, go as far as the simulated cost falls most. Where nothing new happens one
step will do; where the reference jumps, inputs hit their limits one after the other and one step would go astray. The
reference is not known in advance: it is expected to go on at its present rate. The estimated model error makes the
loop free of offset (Pannocchia, Rawlings 2003), as the whole state is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor

from dynasindy.agents.classical.base import Controller
from dynasindy.agents.classical.linearise import Equilibria, jacobians, zero_order_hold
from dynasindy.agents.classical.symbolic import casadi, vector_field
from dynasindy.systems import System

Array = np.ndarray

LENGTHS = (1.0, 0.5, 0.25, 0.1)
"""Shares of a Gauss-Newton step that are tried."""
SETTLED = 1e-3
"""Largest change of an input at which a plan is left as it is."""


@dataclass(frozen=True)
class Cost:
    """Weights of the squares, one number per output or input; a single number holds for all.

    Attributes:
        error: Q, weight of the tracking error [1/unit of the output^2].
        input: R, weight of the input's deviation from that of the equilibrium.
        change: S, weight of the input's change from period to period.
    """

    error: float | Sequence[float] = 1.0
    input: float | Sequence[float] = 1e-4
    change: float | Sequence[float] = 1e-3


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
class _Problem:
    """What a plan is made for: states, the input that holds, the reference ahead, the target, the model error."""

    x: Array
    last: Array
    future: Array
    x_e: Array
    u_e: Array
    drift: Array

    def of(self, rows: Array) -> _Problem:
        """Return the problem of some rows."""
        return _Problem(*(getattr(self, field.name)[rows] for field in fields(self)))


class MPC(Controller):
    """Model predictive control with limited inputs and without offset.

    Args:
        system: the plant, or a model of it, in elementwise torch operations.
        outputs: names of the tracked states, one per input.
        dt: control period [s].
        cost: weights.
        horizon: how far it plans.
        correction: L, share of a newly seen model error that enters the estimate, in [0, 1]; 0 trusts the model.

    Raises:
        ModuleNotFoundError: CasADi is not installed.
        ValueError: a number of weights does not fit, a weight is negative, or zero but for that of the change, a
            block is shorter than a period, `correction` is not in [0, 1], or there is no equilibrium at the origin.
    """

    def __init__(
        self,
        system: System,
        outputs: Sequence[str] = ("alpha_a", "alpha_p"),
        dt: float = 0.05,
        cost: Cost | None = None,
        horizon: Horizon | None = None,
        correction: float = 0.1,
    ) -> None:
        super().__init__(system.signature, outputs, dt)
        cost, self.horizon = cost or Cost(), horizon or Horizon()
        blocks = list(self.horizon.blocks)
        if not blocks or min(blocks) < 1 or min(self.horizon.iterations, self.horizon.substeps) < 1:
            raise ValueError(f"{self.horizon} must have blocks, iterations and substeps of 1 or more; mend it")
        if not 0 <= correction <= 1:
            raise ValueError(f"correction={correction}; give a share between 0 (trust the model) and 1")
        n_r, n_u = len(outputs), system.signature.n_u
        self.q, self.r = _weights("error", cost.error, n_r), _weights("input", cost.input, n_u)
        self.s, self.correction = _weights("change", cost.change, n_u), correction
        self.equilibria = Equilibria(system, outputs)
        self.cost_to_go = self._cost_to_go(system)
        self.block_of = np.repeat(np.arange(len(blocks)), blocks)
        self.lengths = np.array(blocks, dtype=float)[:, None]
        self.starts = np.cumsum([0, *blocks[:-1]])
        self.predictor = _Predictor(system, dt, len(self.block_of), self.horizon.substeps)
        self.program = _Program(len(blocks) * n_u)
        self.plan = self.last_x = self.drift = np.zeros((0, 0))
        self.unknowns = self.equilibria.home

    def act(self, x: Tensor, reference: Tensor, rate: Tensor, first: Tensor) -> Tensor:
        """Return the first input of the plan, `(*batch, n_u)`."""
        rows = tuple(a.reshape(-1, a.shape[-1]).numpy() for a in (x, reference, rate, first))
        states, wanted, rates, begins = rows
        self._observe(states, begins)
        ahead = self.dt * np.arange(1, len(self.block_of) + 1).reshape(-1, 1)
        future = wanted[:, None] + rates[:, None] * ahead
        x_e, u_e = self._target(future[:, -1], rates, begins)
        last = np.where(begins, 0.0, self.plan[:, 0])  # the input that holds now; at the start none
        plan = np.where(begins[..., None], u_e[:, None], self._moved_on())
        self.plan, self.last_x = self._improved(plan, _Problem(states, last, future, x_e, u_e, self.drift)), states
        return torch.as_tensor(self.plan[:, 0].copy()).reshape(*x.shape[:-1], -1)

    def _improved(self, plan: Array, problem: _Problem) -> Array:
        """Return the plan, `(rows, n_blocks, n_u)`, after Gauss-Newton steps; a row that has settled is left alone."""
        plan, open_rows = plan.copy(), np.arange(len(plan))
        for _ in range(self.horizon.iterations):
            mine = problem.of(open_rows)
            plan[open_rows], change = self._stepped(plan[open_rows], mine)
            open_rows = open_rows[change > SETTLED]
            if not len(open_rows):
                break
        return plan

    def _stepped(self, plan: Array, problem: _Problem) -> tuple[Array, Array]:
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

    def _observe(self, x: Array, first: Array) -> None:
        """Carry the estimate of the model error on, `(rows, n_x)`."""
        if self.last_x.shape != x.shape:
            self.plan = np.zeros((len(x), len(self.starts), len(self.r)))
            self.last_x, self.drift = x, np.zeros_like(x)
            self.unknowns = self.equilibria.home.expand(len(x), -1)
        error = x - self.predictor.one(self.last_x, self.plan[:, 0])
        self.drift = np.where(first, 0.0, self.drift + self.correction * (error - self.drift))

    def _target(self, reference: Array, rate: Array, first: Array) -> tuple[Array, Array]:
        """Return the equilibrium at the end of the horizon, moving with the reference, `(rows, n_x)`, `(rows, n_u)`."""
        wanted = torch.as_tensor(reference)
        drift = self.equilibria.moving(torch.as_tensor(rate)) - torch.as_tensor(self.drift) / self.dt
        guess = torch.where(torch.as_tensor(first), self.equilibria.home, self.unknowns)
        self.unknowns = self.equilibria(wanted, guess, drift)
        x_e, u_e = self.equilibria.state_and_input(wanted, self.unknowns)
        return x_e.numpy(), u_e.numpy()

    def _moved_on(self) -> Array:
        """Return the last plan, one period later, `(rows, n_blocks, n_u)`."""
        periods = self.plan[:, self.block_of]
        return periods[:, np.minimum(self.starts + 1, len(self.block_of) - 1)]

    def _cost(self, states: Array, plan: Array, problem: _Problem) -> Array:
        """Return the cost of a plan and the states it leads to, `(rows,)`."""
        error = states[:, :-1, self.outputs] - problem.future[:, :-1]
        deviation, change = self._moves(plan, problem)
        end = np.concatenate((states[:, -1] - problem.x_e, plan[:, -1] - problem.u_e), 1)
        inputs: Array = (self.lengths * self.r * deviation**2 + self.s * change**2).sum((1, 2))
        return inputs + (self.q * error**2).sum((1, 2)) + np.einsum("bi,ij,bj->b", end, self.cost_to_go, end)

    def _step(self, plan: Array, problem: _Problem) -> tuple[Array, Array]:
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
                weighted = outputs.transpose(0, 2, 1) * self.q
                hessian += weighted @ outputs
                error = states[:, k][:, self.outputs] - problem.future[:, k]
                gradient += (weighted @ error[..., None])[..., 0]
        chooses = np.zeros((n_rows, n_u, n_blocks * n_u))
        chooses[:, :, -n_u:] = np.eye(n_u)
        ends = np.concatenate((slope, chooses), 1)
        weighted = ends.transpose(0, 2, 1) @ self.cost_to_go
        deviation = np.concatenate((states[:, -1] - problem.x_e, plan[:, -1] - problem.u_e), 1)
        hessian += weighted @ ends
        gradient += (weighted @ deviation[..., None])[..., 0]
        return states, self.program.solve(hessian, gradient, plan.reshape(n_rows, -1)).reshape(plan.shape)

    def _moves(self, plan: Array, problem: _Problem) -> tuple[Array, Array]:
        """Return the inputs' deviations from their target and their changes, each shaped as the plan."""
        return plan - problem.u_e[:, None], np.diff(np.concatenate((problem.last[:, None], plan), 1), axis=1)

    def _input_cost(self, plan: Array, problem: _Problem) -> tuple[Array, Array]:
        """Return Hessian and gradient of the cost of the inputs and their changes, halved."""
        n_rows, n_blocks, _ = plan.shape
        differences = np.eye(n_blocks) - np.eye(n_blocks, k=-1)
        deviation, change = self._moves(plan, problem)
        gradient = self.lengths * self.r * deviation + np.einsum("ji,bjm->bim", differences, self.s * change)
        hessian = np.kron(np.diag(self.lengths[:, 0]), np.diag(self.r))
        hessian = hessian + np.kron(differences.T @ differences, np.diag(self.s))
        return np.repeat(hessian[None], n_rows, 0), gradient.reshape(n_rows, -1)

    def _cost_to_go(self, system: System) -> Array:
        """Return P of the state and the last input, `(n_x + n_u, n_x + n_u)`, from the linearisation at the origin."""
        home = torch.zeros(len(self.outputs), dtype=torch.float64)
        place = self.equilibria.state_and_input(home, self.equilibria.home)
        a, b = (m.numpy() for m in zero_order_hold(*jacobians(system, *place), self.dt))
        n_x, n_u = b.shape
        f = np.block([[a, np.zeros((n_x, n_u))], [np.zeros((n_u, n_x + n_u))]])
        g = np.vstack((b, np.eye(n_u)))
        weight = np.zeros(n_x)
        weight[self.outputs] = self.q
        change = np.diag(self.s)
        q = np.block([[np.diag(weight), np.zeros((n_x, n_u))], [np.zeros((n_u, n_x)), change]])
        cross = np.vstack((np.zeros((n_x, n_u)), -change))
        # In ranges of the states: rotor speeds in rpm would spoil the solution.
        scale = np.array([*system.signature.x_scale, *[1.0] * n_u])
        scaled = scale[:, None] * q * scale
        p = solve_discrete_are(
            f * scale / scale[:, None], g / scale[:, None], scaled, np.diag(self.r) + change, s=scale[:, None] * cross
        )
        return p / scale[:, None] / scale


class _Predictor:
    """CasADi functions of the prediction, for any number of rows side by side.

    Args:
        system: the model.
        dt: control period [s].
        n_periods: control periods of the horizon.
        substeps: Runge-Kutta steps per control period.
    """

    def __init__(self, system: System, dt: float, n_periods: int, substeps: int) -> None:
        ca = casadi()
        n_x, n_u = system.signature.n_x, system.signature.n_u
        field = vector_field(system)
        x, u, d = (ca.SX.sym(name, n) for name, n in (("x", n_x), ("u", n_u), ("d", n_x)))
        after: Any = x
        for _ in range(substeps):
            after = _rk4(field, after, u, dt / substeps)
        slopes = ca.densify(ca.jacobian(after, ca.vertcat(x, u)))
        self.step = ca.Function("step", [x, u], [ca.densify(after)])
        self.slope = ca.Function("slope", [x, u], [slopes])
        self.simulate = ca.Function("drifting", [x, u, d], [ca.densify(after + d)]).mapaccum(n_periods)
        self.n_x, self.n_u, self.n_periods = n_x, n_u, n_periods
        self.mapped: dict[int, tuple[Any, Any, Any]] = {}

    def one(self, x: Array, u: Array) -> Array:
        """Return F(x, u), `(rows, n_x)`."""
        one, _, _ = self._side_by_side(len(x))
        return one(x.T, u.T).full().T

    def states(self, x: Array, u: Array, d: Array) -> Array:
        """Return the states from the next one on, `(rows, n_periods, n_x)`; arguments as for `along`."""
        _, simulate, _ = self._side_by_side(len(x))
        after = simulate(x.T, u.reshape(-1, self.n_u).T, np.repeat(d, self.n_periods, 0).T).full()
        return after.T.reshape(len(x), self.n_periods, self.n_x)

    def along(self, x: Array, u: Array, d: Array) -> tuple[Array, Array, Array]:
        """Simulate and linearise.

        Args:
            x: states now `(rows, n_x)`.
            u: inputs `(rows, n_periods, n_u)`.
            d: model error `(rows, n_x)`.

        Returns:
            States from the next one on, `(rows, n_periods, n_x)`, and the slopes A, B on the way,
            `(rows, n_periods, n_x, n_x or n_u)`.
        """
        rows = len(x)
        _, _, slope = self._side_by_side(rows)
        after, inputs = self.states(x, u, d), u.reshape(-1, self.n_u).T
        before = np.concatenate((x[:, None], after[:, :-1]), 1).reshape(-1, self.n_x)
        slopes = slope(before.T, inputs).full().reshape(self.n_x, -1, self.n_x + self.n_u).transpose(1, 0, 2)
        slopes = slopes.reshape(rows, self.n_periods, self.n_x, -1)
        return after, slopes[..., : self.n_x], slopes[..., self.n_x :]

    def _side_by_side(self, rows: int) -> tuple[Any, Any, Any]:
        if rows not in self.mapped:
            self.mapped[rows] = self.step.map(rows), self.simulate.map(rows), self.slope.map(rows * self.n_periods)
        return self.mapped[rows]


class _Program:
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


def _rk4(field: Any, x: Any, u: Any, dt: float) -> Any:
    """Advance by one classical Runge-Kutta step, as `dynasindy.systems.integrators.rk4` does."""
    k1 = field(x, u)
    k2 = field(x + 0.5 * dt * k1, u)
    k3 = field(x + 0.5 * dt * k2, u)
    k4 = field(x + dt * k3, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _weights(name: str, given: float | Sequence[float], number: int) -> Array:
    weights = np.broadcast_to(np.asarray(given, dtype=float), (number,)) if np.ndim(given) == 0 else np.asarray(given)
    if weights.shape != (number,) or not (weights >= 0).all() or (name != "change" and not (weights > 0).all()):
        allowed = ">= 0" if name == "change" else "> 0"
        raise ValueError(f"weights of {name} are {given}; give one number, or {number} numbers, {allowed}")
    return weights.astype(float)
