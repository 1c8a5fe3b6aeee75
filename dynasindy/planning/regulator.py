"""A linear-quadratic regulator of the model, as the policy to begin with on a plant that has to be held.

| name     | symbol   | equation                                                                        |
| -------- | -------- | ------------------------------------------------------------------------------- |
| rest     | x_e, u_e | f(x_e, u_e) = 0 with the tracked states at r; cubic polynomials of r fitted to rests |
| gain     | K        | least sum of (x - x_e)' Q (x - x_e) + (u - u_e)' (u - u_e), discrete Riccati equation |
| law      | u        | u_e(r) - K (x - x_e(r)), within the limits of inputs                                 |
"""

from __future__ import annotations

from itertools import chain, combinations_with_replacement
from typing import NamedTuple

import numpy as np
import torch
from scipy.linalg import expm, solve_discrete_are
from torch import Tensor
from torch.nn.functional import pad

from dynasindy.envs import ControlEnv, Tracking
from dynasindy.systems.equilibria import Equilibria
from dynasindy.systems.steps import steps_of

DEGREE = 3
"""Degree of the polynomials through the rests."""
DISCOUNT = 0.9995
"""Factor on the model where there is no law without: a state that no input moves and that stays, as cos^2 + sin^2."""
AROUND = 0.3
"""Distance from a rest at which every second imagined episode begins [ranges of the states]."""


class Regulator:
    """The law, read from observations.

    Attributes:
        gain: K, `(n_u, n_x)`.
        cost: P, the quadratic cost of a state's distance from its rest, `(n_x, n_x)`.
        squares: Q, `(n_x, n_x)`.
        slowest: Time constant of the slowest mode of the regulated linear model [control periods].

    Args:
        task: What the observations are of.
        rests: Equilibria of the model.
        squares: Weight of each squared state, `(n_x,)`.
        solved: Solution of the Riccati equation in those states.
    """

    def __init__(self, task: Tracking, rests: Equilibria, squares: Tensor, solved: _Solved) -> None:
        self.task, self.slowest, self.moved = task, solved.slowest, rests.moved
        n_x, moved = len(rests.moved), rests.moved
        self.squares = torch.diag(squares.where(moved, 0.0)).float()
        self.gain, self.cost = torch.zeros(solved.gain.shape[0], n_x), torch.zeros(n_x, n_x)
        self.gain[:, moved] = solved.gain.float()
        self.cost[moved.outer(moved)] = solved.cost.float().flatten()
        low, high = rests.targets.amin(0), rests.targets.amax(0)
        scale = torch.tensor(task.signature.x_scale, dtype=torch.float64)[task.outputs]
        half = 0.5 * (high - low)
        box = torch.stack([0.5 * (low + high), torch.where(half > 1e-9 * scale, half, 1.0)])
        terms = _terms((rests.targets - box[0]) / box[1])
        through = torch.linalg.lstsq(terms, torch.cat([rests.x, rests.u], -1), driver="gelsd").solution
        self.rests, self.box = through.float(), box.float()

    @classmethod
    def of(cls, env: ControlEnv, rests: Equilibria, outputs: float = 100.0, states: float = 0.1) -> Regulator | None:
        """Return the regulator of the model at the middle of its rests; None without one, or where none holds it.

        Args:
            env: Imagined environment.
            rests: Equilibria of its model.
            outputs: Weight of each squared tracking error, in target ranges; that of an input is one.
            states: Weight of each other squared state, in its range.
        """
        if not len(rests):
            return None
        task, k, moved = env.task, rests.middle(), rests.moved
        assert isinstance(task, Tracking)
        q = squares_of(task, outputs, states)
        a, b = rests.a[k][moved][:, moved], rests.b[k][moved]
        found = regulated(a, b, env.dt, q[moved], env.system.step)
        return None if found is None else cls(task, rests, q, found)

    def __call__(self, observation: Tensor) -> Tensor:
        """Return inputs `(*batch, n_u)` for observations `(*batch, n_o)`."""
        x, reference = self.task.seen(observation)
        x_e, u_e = self.rest(reference)
        return self.task.limit(u_e - (x - x_e) @ self.gain.mT)

    def rest(self, reference: Tensor) -> tuple[Tensor, Tensor]:
        """Return x_e, `(*batch, n_x)`, and u_e, `(*batch, n_u)`, of references `(*batch, n_r)`."""
        r = ((reference - self.box[0]) / self.box[1]).clamp(-1.2, 1.2)
        x_e, u_e = (_terms(r) @ self.rests).split([self.gain.shape[1], self.gain.shape[0]], -1)
        return x_e, u_e

    def value(self, x: Tensor, reference: Tensor) -> Tensor:
        """Return the quadratic cost (x - x_e)' P (x - x_e), `(*batch,)`."""
        away = x - self.rest(reference)[0]
        return ((away @ self.cost) * away).sum(-1)

    def home(self, x: Tensor, reference: Tensor, share: float) -> Tensor:
        """Return whether all states that matter lie within a share of their ranges of the rest, bool `(*batch,)`."""
        away = (x - self.rest(reference)[0]) / torch.tensor(self.task.signature.x_scale)
        return (away.abs() <= share)[..., self.moved].all(-1)

    def near(self, reference: Tensor, rng: torch.Generator) -> Tensor:
        """Return states around the rests of references `(n, n_r)`, `(n, n_x)`."""
        x_e = self.rest(reference)[0]
        return x_e + AROUND * torch.tensor(self.task.signature.x_scale) * torch.randn(x_e.shape, generator=rng)


class _Solved(NamedTuple):
    """A solution of the discrete Riccati equation."""

    gain: Tensor  # K, `(n_u, n_x)`
    cost: Tensor  # P, `(n_x, n_x)`
    slowest: float  # time constant of the slowest mode of the closed loop [periods]
    closed: Tensor  # a - b K of the closed loop x[k+1] = (a - b K) x[k], `(n_x, n_x)`


def squares_of(task: Tracking, outputs: float = 100.0, states: float = 0.1) -> Tensor:
    """Return the weight of each squared state of a task, `(n_x,)`."""
    q = states / torch.tensor(task.signature.x_scale, dtype=torch.float64).square()
    q[task.outputs] = outputs / task.boxes().double().square()
    return q


def regulated(a: Tensor, b: Tensor, dt: float, q: Tensor, step: float | None = None) -> _Solved | None:
    """Return the law of the least quadratic cost for inputs that are held for a control period, or None without one.

    Args:
        a: df/dx, `(n_x, n_x)` [1/s].
        b: df/du, `(n_x, n_u)` [1/s].
        dt: Control period [s].
        q: Weight of each squared state, `(n_x,)`.
        step: Of the difference equation that the model is [s]; None of a differential equation.
    """
    if step is None:  # the input is a state that does not change; scipy.signal has this for a second of imports
        held = pad(torch.cat((a, b), 1), (0, 0, 0, b.shape[1]))
        a, b = torch.as_tensor(expm((held * dt).numpy()))[: len(a)].split([len(a), b.shape[1]], 1)
    else:  # x + step (a x + b u), again and again
        h, count, _ = steps_of(step, dt, 1)
        once = torch.eye(len(a), dtype=a.dtype) + h * a
        powers = [torch.linalg.matrix_power(once, k) for k in range(count)]
        a, b = once @ powers[-1], h * torch.stack(powers).sum(0) @ b
    for discount in (1.0, DISCOUNT):
        f, g, cost = discount * a.numpy(), discount * b.numpy(), np.eye(b.shape[1])
        try:
            p = solve_discrete_are(f, g, np.diag(q.numpy()), cost)
        except (np.linalg.LinAlgError, ValueError):
            continue
        gain = np.linalg.solve(cost + g.T @ p @ g, g.T @ p @ f)
        closed = f - g @ gain
        radius = float(np.abs(np.linalg.eigvals(closed)).max())
        if radius < 1 - 1e-6:
            slowest = -1.0 / float(np.log(max(radius, 1e-3)))
            return _Solved(torch.as_tensor(gain), torch.as_tensor(p), slowest, torch.as_tensor(closed))
    return None


def _terms(r: Tensor) -> Tensor:
    """Return all monomials of targets `(*batch, n_r)` up to the degree, `(*batch, n_terms)`."""
    places = (combinations_with_replacement(range(r.shape[-1]), degree) for degree in range(DEGREE + 1))
    return torch.stack([r[..., list(each)].prod(-1) for each in chain.from_iterable(places)], -1)
