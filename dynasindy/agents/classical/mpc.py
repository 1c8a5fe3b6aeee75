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
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor

from dynasindy.agents.classical.base import Controller
from dynasindy.agents.classical.linearise import Equilibria, jacobians, zero_order_hold
from dynasindy.agents.classical.mpc_program import Horizon, Problem, Program, Weights
from dynasindy.systems import System

Array = np.ndarray


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
        if not 0 <= correction <= 1:
            raise ValueError(f"correction={correction}; give a share between 0 (trust the model) and 1")
        self.correction = correction
        self.equilibria = Equilibria(system, outputs)
        weights = self._weights(system, cost or Cost())
        self.program = Program(system, dt, self.outputs, weights, horizon or Horizon())
        self.plan = self.last_x = self.drift = np.zeros((0, 0))
        self.unknowns = self.equilibria.home

    def act(self, x: Tensor, reference: Tensor, rate: Tensor, first: Tensor) -> Tensor:
        """Return the first input of the plan, `(*batch, n_u)`."""
        rows = tuple(a.reshape(-1, a.shape[-1]).numpy() for a in (x, reference, rate, first))
        states, wanted, rates, begins = rows
        self._observe(states, begins)
        ahead = self.dt * np.arange(1, len(self.program.block_of) + 1).reshape(-1, 1)
        future = wanted[:, None] + rates[:, None] * ahead
        x_e, u_e = self._target(future[:, -1], rates, begins)
        last = np.where(begins, 0.0, self.plan[:, 0])  # the input that holds now; at the start none
        plan = np.where(begins[..., None], u_e[:, None], self.program.moved_on(self.plan))
        problem = Problem(states, last, future, x_e, u_e, self.drift)
        self.plan, self.last_x = self.program.improved(plan, problem), states
        return torch.as_tensor(self.plan[:, 0].copy()).reshape(*x.shape[:-1], -1)

    def _observe(self, x: Array, first: Array) -> None:
        """Carry the estimate of the model error on, `(rows, n_x)`."""
        if self.last_x.shape != x.shape:
            self.plan = np.zeros((len(x), len(self.program.starts), len(self.program.weights.input)))
            self.last_x, self.drift = x, np.zeros_like(x)
            self.unknowns = self.equilibria.home.expand(len(x), -1)
        error = x - self.program.predictor.one(self.last_x, self.plan[:, 0])
        self.drift = np.where(first, 0.0, self.drift + self.correction * (error - self.drift))

    def _target(self, reference: Array, rate: Array, first: Array) -> tuple[Array, Array]:
        """Return the equilibrium at the end of the horizon, moving with the reference, `(rows, n_x)`, `(rows, n_u)`."""
        wanted = torch.as_tensor(reference)
        drift = self.equilibria.moving(torch.as_tensor(rate)) - torch.as_tensor(self.drift) / self.dt
        guess = torch.where(torch.as_tensor(first), self.equilibria.home, self.unknowns)
        self.unknowns = self.equilibria(wanted, guess, drift)
        x_e, u_e = self.equilibria.state_and_input(wanted, self.unknowns)
        return x_e.numpy(), u_e.numpy()

    def _weights(self, system: System, cost: Cost) -> Weights:
        """Return the weights, with the cost to go of the linearisation at the origin."""
        n_r, n_u = len(self.outputs), system.signature.n_u
        q, r = _array("error", cost.error, n_r), _array("input", cost.input, n_u)
        s = _array("change", cost.change, n_u)
        home = torch.zeros(n_r, dtype=torch.float64)
        place = self.equilibria.state_and_input(home, self.equilibria.home)
        a, b = (m.numpy() for m in zero_order_hold(*jacobians(system, *place), self.dt, system.step))
        weight = np.zeros(len(a))
        weight[self.outputs] = q
        # In ranges of the states: rotor speeds in rpm would spoil the solution.
        scale = np.array([*system.signature.x_scale, *[1.0] * n_u])
        return Weights(q, r, s, _cost_to_go(a, b, (weight, r, s), scale))


def _cost_to_go(a: Array, b: Array, weights: tuple[Array, Array, Array], scale: Array) -> Array:
    """Return P of the state and the last input, `(n_x + n_u, n_x + n_u)`, of x[k+1] = A x[k] + B u[k]."""
    n_x, n_u = b.shape
    state, r, s = weights
    f = np.block([[a, np.zeros((n_x, n_u))], [np.zeros((n_u, n_x + n_u))]])
    g = np.vstack((b, np.eye(n_u)))
    change = np.diag(s)
    q = np.block([[np.diag(state), np.zeros((n_x, n_u))], [np.zeros((n_u, n_x)), change]])
    cross = np.vstack((np.zeros((n_x, n_u)), -change))
    scaled = scale[:, None] * q * scale
    p = solve_discrete_are(
        f * scale / scale[:, None], g / scale[:, None], scaled, np.diag(r) + change, s=scale[:, None] * cross
    )
    return p / scale[:, None] / scale


def _array(name: str, given: float | Sequence[float], number: int) -> Array:
    weights = np.broadcast_to(np.asarray(given, dtype=float), (number,)) if np.ndim(given) == 0 else np.asarray(given)
    if weights.shape != (number,) or not (weights >= 0).all() or (name != "change" and not (weights > 0).all()):
        allowed = ">= 0" if name == "change" else "> 0"
        raise ValueError(f"weights of {name} are {given}; give one number, or {number} numbers, {allowed}")
    return weights.astype(float)
