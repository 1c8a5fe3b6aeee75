"""Nonlinear model predictive control by do-mpc, on any vector field in CasADi; imports neither torch nor dynasindy.

| name     | symbol   | equation                                                                                    |
| -------- | -------- | ------------------------------------------------------------------------------------------- |
| model    | f        | dx/dt = f(x, u), collocated by do-mpc                                                        |
| target   | r, v     | dr/dt = v, dv/dt = 0: nothing of its future is known                                         |
| stage    | l        | 4 (y - r)^2 + .02 (dy/dt - v)^2 + .002 ((x - h(r)) / range)^2, .001 of squared changes of u  |
| terminal | m        | 10 times the squared errors, and .1 of the squared rates                                     |

The hint h(r) is where the states that have no target rest while the outputs are at r. Without it, and with magnitudes
that have a corner, IPOPT can call plans solved that leave a rotor standing, where its thrust w |w| has no slope.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi
import do_mpc
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Field = Callable[[Any, Any], Sequence[Any]]
DEGREE = 5
"""Degree of the polynomials of the hint."""


@dataclass(frozen=True)
class Plan:
    """What a controller is made for.

    Attributes:
        states: Names of the states.
        inputs: Names of the inputs, within -1 and 1.
        ranges: Range of each state.
        outputs: Tracked states.
        rates: The rate of each output.
        dt: Control period [s].
        horizon: Periods that are planned.
        hint: Coefficients of `monomials` of the targets, by state, whose sum is h |h|, as thrust goes with the square
            of a speed; empty for none.
        moving: Whether targets move.
        guess: Where the first plan of a flight begins, by state, besides the outputs at their targets.
    """

    states: Sequence[str]
    inputs: Sequence[str]
    ranges: Sequence[float]
    outputs: Sequence[str]
    rates: Sequence[str]
    dt: float = 0.05
    horizon: int = 40
    hint: Mapping[str, Sequence[float]] = field(default_factory=dict)
    moving: bool = False
    guess: Mapping[str, float] = field(default_factory=dict)


def monomials(targets: Sequence[Any]) -> list[Any]:
    """Return 1, r_1, r_2, r_1^2, ... of up to two targets, up to `DEGREE`."""
    first, second = (*targets, 0.0)[:2]
    powers = [(a, n - a) for n in range(DEGREE + 1) for a in range(n, -1, -1) if len(targets) > 1 or n == a]
    return [first**a * second**b for a, b in powers]


def functions(sizes: Mapping[str, float]) -> dict[str, Any]:
    """Return what formulas call, by name.

    Args:
        sizes: Ranges of the states whose magnitudes are to be smooth: rounded within a 2500th of the range.
    """
    calls = {name: getattr(casadi, name) for name in ("sin", "cos", "exp", "tanh", "sqrt", "sign", "fabs")}

    def _magnitude(a: Any) -> Any:
        if not a.is_symbolic() or a.name() not in sizes:
            return casadi.fabs(a)
        corner = sizes[a.name()] / 2500
        return casadi.sqrt(a * a + corner**2) - corner

    if sizes:
        calls["fabs"] = _magnitude
    exceeds = {"exceeds": lambda a, b: casadi.if_else(a > b, 1.0, 0.0)}
    return {**calls, **exceeds, "square": lambda a: a * a, "larger": casadi.fmax}


def build(rates_of: Field, plan: Plan) -> Any:
    """Return a controller of do-mpc, before its setup; its states are those of the plan and `r_0`, ..., `v_0`, ..."""
    model = do_mpc.model.Model("continuous")
    x = [model.set_variable("_x", name) for name in plan.states]
    u = [model.set_variable("_u", name) for name in plan.inputs]
    r = [model.set_variable("_x", f"r_{k}") for k in range(len(plan.outputs))]
    v = [model.set_variable("_x", f"v_{k}") for k in range(len(r))] if plan.moving else [casadi.DM(0)] * len(r)
    for name, rate in zip(plan.states, rates_of(x, u), strict=True):
        model.set_rhs(name, rate)
    for k in range(len(r)):
        model.set_rhs(f"r_{k}", v[k])
        if plan.moving:
            model.set_rhs(f"v_{k}", casadi.DM(0))
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    settings = mpc.settings
    settings.n_horizon, settings.t_step, settings.n_robust, settings.store_full_solution = (
        plan.horizon,
        plan.dt,
        0,
        False,
    )
    settings.supress_ipopt_output()
    at = dict(zip(plan.states, x, strict=True))
    errors = sum((at[name] - to) ** 2 for name, to in zip(plan.outputs, r, strict=True))
    speeds = sum((at[name] - to) ** 2 for name, to in zip(plan.rates, v, strict=True))
    size = dict(zip(plan.states, plan.ranges, strict=True))
    squares = {name: sum(c * m for c, m in zip(of, monomials(r), strict=True)) for name, of in plan.hint.items()}
    rest = {name: of / (of * of + 1.0) ** 0.25 for name, of in squares.items()}
    away = sum(((at[name] - to) / size[name]) ** 2 for name, to in rest.items())
    track = 4 * errors + 0.002 * away
    mpc.set_objective(mterm=10 * track + 0.1 * speeds, lterm=track + 0.02 * speeds)
    mpc.set_rterm(**dict.fromkeys(plan.inputs, 1e-3))
    for name in plan.inputs:
        mpc.bounds["lower", "_u", name], mpc.bounds["upper", "_u", name] = -1, 1
    for name, of in size.items():
        mpc.scaling["_x", name] = of
    return mpc


class Pilot:
    """Flies one plant, or several in turn: what do-mpc keeps from period to period is kept for each.

    Args:
        rates_of: The vector field.
        plan: What it is made for.
    """

    def __init__(self, rates_of: Field, plan: Plan) -> None:
        self.plan, self.mpc = plan, build(rates_of, plan)
        self.mpc.setup()
        self.unsolved = 0
        self._flights: dict[int, tuple[Any, Any]] = {}

    def act(self, x: Array, target: Array, first: bool, flight: int = 0) -> Array:
        """Return the inputs.

        Args:
            x: States, `(n_x,)`.
            target: Targets, and their rates if they move.
            first: Whether a flight begins.
            flight: Its number.
        """
        state = np.concatenate([x, target])
        if first:
            start = state.copy()
            for name, of in (*zip(self.plan.outputs, target, strict=False), *self.plan.guess.items()):
                start[self.plan.states.index(name)] = of
            self.mpc.reset_history()
            self.mpc.x0, self.mpc.u0 = start, np.zeros((len(self.plan.inputs), 1))
            self.mpc.set_initial_guess()
        else:
            self.mpc.opt_x_num.master, self.mpc._u0.master = self._flights[flight]
        u = self.mpc.make_step(state.reshape(-1, 1))
        if not self.mpc.solver_stats["success"]:
            self.unsolved += 1
            self.mpc.x0 = state
            self.mpc.set_initial_guess()
        self._flights[flight] = (self.mpc.opt_x_num.master, self.mpc._u0.master)
        return np.asarray(u, dtype=float).ravel()
