"""The linear model of a closed loop at rest, z[k+1] = A z + B v + E n, u = C z + F n: margins and noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg import eig, matrix_balance, solve_discrete_lyapunov
from torch import Tensor

from dynasindy.evaluation.closed_loop import PERIODS, ClosedLoop, at_limit
from dynasindy.planning.margins import MOVEMENT
from dynasindy.progress import report_progress
from dynasindy.systems.equilibria import central_differences, find_equilibria

NUDGE = 1e-5
"""Step of the differences of Newton's method [ranges]."""
NEWTON = 15
"""Newton steps at most."""
LARGEST = 0.3
"""Longest Newton step [ranges]."""
STILL = 1e-8
"""What a loop at rest may move in a control period [ranges]."""
Array = NDArray[np.float64]

NEUTRAL = MOVEMENT / PERIODS
"""How far from the unit circle an eigenvalue may lie and be taken for one on it: what it belongs to neither grows nor
dies out by more than `MOVEMENT` of itself in a flight."""
BOUNDLESS = 1e3
"""Inputs beyond their limits that a model may rest by."""
RESTS = "where the loop rests"
"""What is under way, in words."""


class Linear(NamedTuple):
    """Linear closed loops, one per row.

    Attributes:
        dt: Control period [s].
        a, b, c: From z and added inputs to z and commands, `(rows, n, n)`, `(rows, n, n_u)`, `(rows, n_u, n)`.
        e, f: From noise of each state's measurement to z and commands, `(rows, n, n_x)`, `(rows, n_u, n_x)`.
    """

    dt: float
    a: Array
    b: Array
    c: Array
    e: Array
    f: Array

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of each loop, largest first, `(rows, n)`."""
        found = np.linalg.eigvals(self.a)
        return np.take_along_axis(found, np.argsort(-np.abs(found), axis=-1), -1).astype(np.complex128)

    @property
    def radius(self) -> Array:
        """Spectral radius of each loop, `(rows,)`."""
        return np.abs(np.linalg.eigvals(self.a)).max(-1)

    @property
    def stable(self) -> Tensor:
        """Whether no mode of each loop grows, bool `(rows,)`."""
        return torch.from_numpy(self.radius < 1 + NEUTRAL)

    def decaying(self) -> Linear:
        """Return one loop without its neutral modes, as those of an integral that is held."""
        values, left, right = eig(self.a, left=True)
        kept = self.a.astype(complex)
        for k in np.flatnonzero(np.abs(np.abs(values) - 1) <= NEUTRAL):
            mode, row = right[:, k], left[:, k].conj()
            kept -= values[k] * np.outer(mode, row) / (row @ mode)
        return self._replace(a=kept.real)

    def finite(self) -> Linear:
        """Return the same with 0 for what is not finite: a plant that runs away has no slope."""
        return Linear(self.dt, *(np.nan_to_num(matrix, posinf=0.0, neginf=0.0) for matrix in self[1:]))

    def row(self, k: int | NDArray[np.bool_] | NDArray[np.int64]) -> Linear:
        """Return one loop, its matrices without the dimension of rows, or several, by places or bool."""
        return Linear(self.dt, *(matrix[k] for matrix in self[1:]))

    def noise_gain(self) -> Array:
        """Return the standard deviation of each input per unit of white noise on each measurement, `(n_u, n_x)`.

        It is that of one loop. G = A' G A + c' c is the energy of an input after unit noise on z, so that e' G e + f^2
        is its variance under unit noise of a measurement. A state that is not measured has none, and a loop that is not
        stable no steady spread.
        """
        # States in rpm beside states in rad: what is balanced solves without a loss of digits.
        a, scale = matrix_balance(self.a, permute=False)
        units = np.diag(scale)
        e = self.e / units[:, None]
        energies = [solve_discrete_lyapunov(a.T, np.outer(c, c)) for c in self.c * units]
        after = np.stack([np.einsum("ij,ik,kj->j", e, energy, e) for energy in energies])
        return np.sqrt((after + self.f**2).clip(0))


class RestingLoop(NamedTuple):
    """Where loops rest, one per row.

    Attributes:
        z: The vectors, `(rows, n)`.
        covariance: Of the observer, `(rows, n_o, n_o)`.
        u: Commands, `(rows, n_u)`.
        still: Whether a point of rest was found, bool `(rows,)`.
        error: Absolute error of the outputs there, `(rows, n_r)`; where there is none, its mean in the last seconds of
            a run.
        linear: The loops linearised there, over movements of `MOVEMENT`.
    """

    z: Tensor
    covariance: Tensor
    u: Tensor
    still: Tensor
    error: Tensor
    linear: Linear

    @property
    def stable(self) -> Tensor:
        """Whether each loop comes to rest and is stable there, bool `(rows,)`."""
        return self.still & self.linear.stable

    def select(self, rows: Tensor) -> RestingLoop:
        """Return some rows, by their places or bool `(rows,)`."""
        z, covariance, u, still, error = (each[rows] for each in self[:-1])
        return RestingLoop(z, covariance, u, still, error, self.linear.row(rows.numpy()))


def _guess_rest(loop: ClosedLoop, r: Tensor) -> Tensor:
    """Return vectors near those at rest, `(rows, n)`: the plant where the model rests with its outputs at `r`.

    Where the model has no such place, it is the state at the origin with the outputs put to `r`.
    """
    n_x, n_u = loop.signature.n_x, loop.signature.n_u
    x, u = torch.zeros(len(r), n_x, dtype=torch.float64), torch.zeros(len(r), n_u, dtype=torch.float64)
    x[:, loop.task.outputs] = r
    # Inputs beyond their limits are cut off below: near enough to begin from.
    limits = torch.tensor([[-BOUNDLESS], [BOUNDLESS]]).expand(-1, n_u)
    found = find_equilibria(loop.model, loop.task.outputs, r, torch.zeros(n_x), loop.dt, limits)
    for target, state, command in zip(found.targets, found.x, found.u, strict=True):
        same = (r == target).all(-1)
        x[same], u[same] = state, command
    return loop.at(x, loop.task.limit(u))


def _linearise(
    loop: ClosedLoop, z: Tensor, covariance: Tensor, r: Tensor, size: float = MOVEMENT
) -> tuple[Linear, Tensor, Tensor]:
    """Return loops linearised at `z`, how far each moves from there in a period `(rows, n)`, and its commands."""
    n, n_u = loop.size, loop.signature.n_u
    scale = torch.cat([loop.scale, torch.ones(n_u), loop.scale[loop.parts["x"]]]).double()

    def _ends(points: Tensor) -> Tensor:
        off, added, noise = points.expand(len(z), -1, -1).split([n, n_u, len(scale) - n - n_u], -1)
        held = r.unsqueeze(1).expand(-1, len(points), -1)
        moved = loop.step(z.unsqueeze(1) + off, covariance.unsqueeze(1), held, added, noise)
        return torch.cat([moved.z, moved.u], -1)

    centre, slopes = central_differences(_ends, size * scale)
    a, b, e = np.split(slopes[:, :n].numpy(), [n, n + n_u], -1)
    c, _, f = np.split(slopes[:, n:].numpy(), [n, n + n_u], -1)
    return Linear(loop.dt, a, b, c, e, f), centre[:, :n] - z, centre[:, n:]


def find_rest(loop: ClosedLoop, r: Tensor, start: RestingLoop | None = None, seconds: float = 20.0) -> RestingLoop:
    """Find where loops rest, by Newton's method.

    Where it fails, the loop is not stable or an input is at its end, they run first: other rests may be nearer.

    Args:
        loop: The loop, of as many rows as `r` has, or of one plant.
        r: References, `(rows, n_r)`.
        start: Where to begin, such as the same loops with other coefficients; by default where the model rests.
        seconds: How long the loop may run [s].
    """
    r = r.double()
    z = _guess_rest(loop, r) if start is None else start.z
    covariance = loop.steady_covariance(z) if start is None else start.covariance
    found, still = _newton(loop, z, covariance, r)
    linear, _, u = _linearise(loop, found, covariance, r)
    stable = linear.finite().stable
    # With dry friction, and with an input at its end, there are rests that no flight reaches.
    lost = (~(still & stable) | at_limit(u, loop.task.input_limits).any(-1)).nonzero().flatten()
    ran = torch.zeros(len(r), loop.task.n_r, dtype=torch.float64)
    if len(lost):
        flown, moved, spread = loop.rows(lost).run(z[lost], covariance[lost], r[lost], seconds, RESTS)
        ran[lost] = flown.steady_error
        again, calm = _newton(loop.rows(lost), moved, spread, r[lost])
        new = calm | ~still[lost]
        lost, again, spread, calm = lost[new], again[new], spread[new], calm[new]
        found, covariance = found.index_copy(0, lost, again), covariance.index_copy(0, lost, spread)
        still = still.index_copy(0, lost, calm)
        linear, _, u = _linearise(loop, found, covariance, r)
    error = (r - found[:, loop.parts["x"]][:, loop.task.outputs]).abs().where(still.unsqueeze(-1), ran)
    return RestingLoop(found, covariance, u, still, error, linear.finite())


def _newton(loop: ClosedLoop, z: Tensor, covariance: Tensor, r: Tensor) -> tuple[Tensor, Tensor]:
    """Return vectors at rest, as far as they are found, and whether they are, bool `(rows,)`."""
    scale, unit = loop.scale, np.eye(loop.size)
    z, still, left = z.clone(), torch.zeros(len(z), dtype=torch.bool), torch.arange(len(z))
    for k in range(NEWTON):
        report_progress(RESTS, note=f"step {k + 1} of Newton's method")
        linear, moved, _ = _linearise(loop.rows(left), z[left], covariance[left], r[left], NUDGE)
        calm = ((moved / scale).abs() < STILL).all(-1)
        still[left] = calm
        sound = moved.isfinite().all(-1) & torch.from_numpy(np.isfinite(linear.a).all((-2, -1)))
        on = (~calm & sound).nonzero().flatten()
        if not len(on):
            break
        # In ranges of z, so that least squares weigh what is alike; a loop may be free to rest anywhere.
        ranged = (unit - linear.a[on.numpy()]) * scale.numpy() / scale.numpy()[:, None]
        wanted = (moved[on] / scale).numpy()
        solved = [np.linalg.lstsq(a, b, rcond=1e-12)[0] for a, b in zip(ranged, wanted, strict=True)]
        step, left = torch.from_numpy(np.stack(solved)), left[on]
        longest = step.abs().amax(-1, keepdim=True).clamp_min(LARGEST)
        z[left] += step * LARGEST / longest * scale
    return z, still


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


def open_loop_response(linear: Linear, omega: Array) -> Complex:
    """Return the loop L opened at each input, `(n_omega, n_u)`; closed it is 1 + L = 0 at the limit of stability."""
    return 1 / sensitivity(linear, omega) - 1


def loop_margins(linear: Linear) -> list[Margins]:
    """Return the margins of one loop, input by input; all are used up of one that is not stable."""
    if linear.radius >= 1:
        return [Margins(gain=1.0, lower=1.0, phase=0.0, delay=0.0, disk=0.0)] * linear.b.shape[1]
    omega = frequencies(linear)
    s = sensitivity(linear, omega)
    return [_of(linear, omega, s[:, i], i) for i in range(linear.b.shape[1])]


def _of(linear: Linear, omega: Array, s: Complex, place: int) -> Margins:
    def _loop(w: float) -> complex:
        return complex(open_loop_response(linear, np.array([w]))[0, place])

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
    from scipy.optimize import brentq  # a tenth of a second of imports

    places = np.nonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)[0]
    return [float(brentq(function, omega[k], omega[k + 1], xtol=1e-10 * omega[-1])) for k in places]
