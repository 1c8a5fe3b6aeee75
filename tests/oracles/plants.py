"""Plants whose motion is that of a matrix, one that falls from upright, and motions under held inputs by SciPy."""

import math

import numpy as np
import torch
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dynasindy.systems.base import Signature, System


class Linear(System):
    """dx/dt = A x + B u."""

    def __init__(self, a, b, scale=None, names="pvqwabcd"):
        a, b = (torch.as_tensor(given, dtype=torch.float64) for given in (a, b))
        n = len(a)
        super().__init__(Signature(tuple(names[:n]), ("-",) * n, ("u", "z")[: b.shape[1]], scale or (1.0,) * n))
        self.a, self.b = a, b

    def forward(self, x, u):
        return x @ self.a.to(x).mT + u @ self.b.to(x).mT


class Plant(System):
    """A plant that is written as its equations: its rates, as a function of each state and each input."""

    def __init__(self, names, rates, scale=None, inputs="u"):
        states, inputs = tuple(names.split()), tuple(inputs.split())
        super().__init__(Signature(states, ("-",) * len(states), inputs, scale or (1.0,) * len(states)))
        self.rates = rates

    def forward(self, x, u):
        return torch.stack(self.rates(*x.unbind(-1), *u.unbind(-1)), -1)


A = torch.tensor([[0.0, 1.0, 0.0], [-4.0, -0.8, 2.0], [0.0, 0.0, -3.0]], dtype=torch.float64)
B = torch.tensor([[0.0], [0.0], [3.0]], dtype=torch.float64)
"""A mass `p` on a spring, pushed by a motor `m` that lags."""


def spring():
    """Return the mass on its spring."""
    return Linear(A, B, (1.0, 2.0, 0.5), "pvm")


def held_motion(a, b, x0, inputs, dt):
    """Return the exact states of dx/dt = A x + B u under held inputs, by the matrix exponential of [A B; 0 0]."""
    n, n_u = np.shape(b)
    step = expm(dt * np.block([[np.array(a), np.array(b)], [np.zeros((n_u, n + n_u))]]))[:n]
    states = [np.asarray(x0, dtype=float)]
    for held in np.asarray(inputs).reshape(-1, n_u):
        states.append(step @ [*states[-1], *held])
    return np.array(states)


def pendulum_rates(_, x, u):
    """Return the rates of a `Pendulum` with the constants that it has by itself."""
    return [x[1], 12 * u - 9.81 * math.sin(x[0]) - 0.5 * x[1]]


def scipy_motion(rates, x0, inputs, dt, rtol=1e-9, atol=1e-11):
    """Return the states of x' = rates(t, x, u) under inputs, each held for dt, or for its own."""
    states = [np.asarray(x0, dtype=float)]
    for held, period in zip(inputs, np.broadcast_to(dt, len(inputs)), strict=True):
        moved = solve_ivp(rates, (0, period), states[-1], args=(held,), rtol=rtol, atol=atol)
        states.append(moved.y[:, -1])
    return np.array(states)


class Upright(System):
    """A pendulum measured from the top, a = growth sin(theta) - damping Omega + pull u + push."""

    def __init__(self, growth, pull, push=0.0, damping=0.0, scale=(1.0, 3.0)):
        super().__init__(Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), scale))
        self.growth, self.pull, self.push, self.damping = growth, pull, push, damping

    def forward(self, x, u):
        theta, rate = x.unbind(-1)
        turning = self.growth * torch.sin(theta) - self.damping * rate + self.pull * u[..., 0] + self.push
        return torch.stack((rate, turning), -1)
