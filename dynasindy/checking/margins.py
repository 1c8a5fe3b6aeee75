"""Margins of a loop that is opened at one input of the plant, all other inputs closed.

| name    | meaning                                                                                | unit |
| ------- | -------------------------------------------------------------------------------------- | ---- |
| `gain`  | factor by which the effect of the input may grow until the loop is no longer stable    | 1    |
| `lower` | factor to which it may fall                                                            | 1    |
| `phase` | lag, or lead, at the frequencies where the loop has gain 1 that it bears               | deg  |
| `delay` | further delay of the input that it bears                                               | s    |
| `disk`  | balanced disk margin: gain and phase that may change together, 2 is the most           | 1    |

With T(z) = C (zI - A)^-1 B of the closed loop, from what is added at the input to what is commanded, the sensitivity is
S = 1 + T and the loop L = 1/S - 1. Disk margin: 1 / max |S - 1/2|; Seiler, Packard, Gahinet, An Introduction to Disk
Margins (2020), theorem 1. A delay acts as exp(-j omega tau); of whole control periods that is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from dynasindy.checking.linear import Array, Linear

Complex = NDArray[np.complex128]
POINTS = 600
"""Frequencies of the grid, besides those near eigenvalues."""
SLOWEST = 1e-4
"""Lowest frequency of the grid [of the highest, half the sampling rate]."""


@dataclass(frozen=True)
class Margins:
    """Margins at one input, infinite where nothing ends the stability; see the table of the module.

    `lower` is 0 where it may fall to nothing.
    """

    gain: float
    lower: float
    phase: float
    delay: float
    disk: float


def frequencies(linear: Linear) -> Array:
    """Return a grid up to half the sampling rate, denser near the eigenvalues of the loop, `(n,)` [rad/s]."""
    highest = math.pi / linear.dt
    grid = np.concatenate([np.geomspace(SLOWEST * highest, highest, POINTS), np.linspace(0, highest, POINTS // 2)[1:]])
    poles = np.linalg.eigvals(linear.a)
    poles = poles[(np.abs(poles) > 0.3) & (poles.imag > 0)]
    width = np.linspace(-4.0, 4.0, 33)
    # A resonance is as wide as its eigenvalue is far from the unit circle.
    near = (np.angle(poles)[:, None] + width * np.abs(1 - np.abs(poles))[:, None]).ravel() / linear.dt
    return np.unique(np.concatenate([grid, near[(near > SLOWEST * highest) & (near < highest)], [highest]]))


def sensitivity(linear: Linear, omega: Array) -> Complex:
    """Return S at each input, `(n_omega, n_u)`, of one loop at frequencies `(n_omega,)` [rad/s]."""
    unit = np.eye(len(linear.a))
    around = np.exp(1j * omega * linear.dt)[:, None, None] * unit - linear.a
    solved = np.linalg.solve(around, np.broadcast_to(linear.b.astype(complex), (len(omega), *linear.b.shape)))
    found: Complex = 1 + np.einsum("ui,wiu->wu", linear.c, solved)
    return found


def broken(linear: Linear, omega: Array) -> Complex:
    """Return the loop L opened at each input, `(n_omega, n_u)`; closed it is 1 + L = 0 at the limit of stability."""
    return 1 / sensitivity(linear, omega) - 1


def margins(linear: Linear) -> list[Margins]:
    """Return the margins of one stable loop, input by input.

    Raises:
        ValueError: The loop is not stable, and has no margins.
    """
    if np.abs(np.linalg.eigvals(linear.a)).max() >= 1:
        raise ValueError("the loop is not stable, so it has no margins")
    omega = frequencies(linear)
    s = sensitivity(linear, omega)
    return [_of(linear, omega, s[:, i], i) for i in range(linear.b.shape[1])]


def _of(linear: Linear, omega: Array, s: Complex, place: int) -> Margins:
    def _loop(w: float) -> complex:
        return complex(broken(linear, np.array([w]))[0, place])

    values = 1 / s - 1
    # The loop is real at the ends of the grid, too; under integral action it has no end below.
    still = sensitivity(linear, np.zeros(1))[0, place]
    ends = [values[-1]] if abs(still) < 1e-7 else [1 / still - 1, values[-1]]
    real = [*ends, *(_loop(w) for w in _crossings(omega, values.imag, lambda w: _loop(w).imag))]
    factors = [float(-1 / value.real) for value in real if value.real < -1e-9]
    unit = _crossings(omega, np.abs(values) - 1, lambda w: abs(_loop(w)) - 1)
    # The lag after which the loop is at -1, from 0 to one turn.
    lags = [(w, (math.pi + math.atan2(_loop(w).imag, _loop(w).real)) % (2 * math.pi)) for w in unit]
    return Margins(
        gain=min((k for k in factors if k > 1), default=math.inf),
        lower=max((k for k in factors if k < 1), default=0.0),
        phase=math.degrees(min((min(lag, 2 * math.pi - lag) for _, lag in lags), default=math.inf)),
        delay=min((lag / w for w, lag in lags), default=math.inf),
        disk=float(1 / np.abs(s - 0.5).max()),
    )


def _crossings(omega: Array, values: Array, function: Callable[[float], float]) -> list[float]:
    """Return where a function is zero between points of a grid."""
    places = np.nonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)[0]
    return [float(brentq(function, omega[k], omega[k + 1], xtol=1e-10 * omega[-1])) for k in places]
