"""What MPC expects of its model: states ahead and their slopes, as CasADi functions for many rows side by side."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynasindy.agents.classical.symbolic import casadi, vector_field
from dynasindy.systems import System
from dynasindy.systems.steps import steps_of

Array = np.ndarray


class Predictor:
    """CasADi functions of the prediction, for any number of rows side by side.

    Args:
        system: the model.
        dt: control period [s].
        n_periods: control periods of the horizon.
        substeps: Runge-Kutta steps per control period; a difference equation has its own.

    Raises:
        ValueError: the period is not made of whole steps of a difference equation.
    """

    def __init__(self, system: System, dt: float, n_periods: int, substeps: int) -> None:
        ca = casadi()
        n_x, n_u = system.signature.n_x, system.signature.n_u
        field = vector_field(system)
        x, u, d = (ca.SX.sym(name, n) for name, n in (("x", n_x), ("u", n_u), ("d", n_x)))
        after: Any = x
        h, count, difference = steps_of(system.step, dt, substeps)
        for _ in range(count):
            after = after + h * field(after, u) if difference else _rk4(field, after, u, h)
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


def _rk4(field: Any, x: Any, u: Any, dt: float) -> Any:
    """Advance by one classical Runge-Kutta step, as `dynasindy.systems.integrators.rk4` does."""
    k1 = field(x, u)
    k2 = field(x + 0.5 * dt * k1, u)
    k3 = field(x + 0.5 * dt * k2, u)
    k4 = field(x + dt * k3, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
