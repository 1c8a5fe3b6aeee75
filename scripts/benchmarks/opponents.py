"""Simple models of a log, to stand beside ours: ARX, subspace, and least squares on physics written by hand.

Each predicts what is measured `steps` samples after some samples, from what was measured up to these and from the
inputs since. What a model leaves open, as its order, is chosen on the last quarter of the training logs; then it is
fitted to all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

Array = NDArray[np.float64]
Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Log:
    """A log at even times.

    Attributes:
        y: What was measured, `(N, n_y)`.
        u: Inputs, `(N, n_u)`, each held until the next sample, or their means if the log was thinned.
        dt: Sampling time [s].
        whole: The log from which every n-th sample was kept.
    """

    y: Array
    u: Array
    dt: float
    whole: Log | None = None

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.y)

    def part(self, first: float, last: float = 1.0) -> Log:
        """Return a part, from and to shares of the length."""
        cut = slice(round(first * len(self)), round(last * len(self)))
        return Log(self.y[cut], self.u[cut], self.dt, self.whole and self.whole.part(first, last))

    def thinned(self, by: int) -> Log:
        """Keep every n-th sample; of the inputs in between the mean."""
        if by == 1:
            return self
        n = (len(self) - 1) // by
        means = self.u[: n * by].reshape(n, by, -1).mean(1)
        return Log(self.y[: n * by + 1 : by], np.vstack([means, self.u[n * by :][:1]]), self.dt * by, self)


class Predictor(Protocol):
    """A model that predicts a log."""

    @property
    def coefficients(self) -> int:
        """How many numbers were fitted."""

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return what is predicted for the samples after each start, `(S, steps, n_y)`."""


Fit = Callable[[Sequence[Log]], Predictor]
MOST, LATEST = 20, 5
"""Largest order, and longest delay in samples, of ARX; past samples that the subspace method reads at most."""
FIRST = MOST + LATEST + 1
"""Samples that are known before a prediction, at least."""
KEPT = 0.25
"""Part of each training log, at its end, on which orders are chosen."""


def choose(fits: Iterable[Fit], logs: Sequence[Log], cost: Callable[[Predictor], float]) -> Predictor:
    """Fit all training logs in the way that costs least when their last quarter is not fitted."""
    early = tuple(log.part(0, 1 - KEPT) for log in logs)

    def _cost(fit: Fit) -> float:
        try:
            return cost(fit(early))
        except (ValueError, np.linalg.LinAlgError):  # too few samples for so many coefficients
            return math.inf

    with np.errstate(all="ignore"):
        return min(fits, key=_cost)(tuple(logs))


@dataclass(frozen=True)
class Held:
    """The last value held."""

    coefficients: int = 0

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return the last values."""
        return np.repeat(log.y[starts][:, None], steps, 1)


@lru_cache(maxsize=4)
def _lagged(logs: tuple[Log, ...]) -> tuple[Array, int]:
    """Return the triangle of a QR decomposition of lagged samples, and how many rows it stands for.

    Its columns are outputs 1 to `MOST` samples ago, inputs 0 to `MOST + LATEST` ago, cubes of outputs 1 to 3 ago, one,
    and the outputs.
    """
    rows = []
    for log in logs:
        t = np.arange(FIRST, len(log))
        past = [log.y[t - i] for i in range(1, MOST + 1)] + [log.u[t - j] for j in range(MOST + LATEST + 1)]
        rows.append(np.hstack([*past, *(log.y[t - i] ** 3 for i in (1, 2, 3)), np.ones((len(t), 1)), log.y[t]]))
    both = np.vstack(rows)
    return np.linalg.qr(both).R, len(both)


@dataclass(frozen=True)
class Arx:
    """Outputs as a linear function of past outputs and inputs, and of cubes of outputs.

    Attributes:
        own: Weights of outputs, newest first, `(order * n_y, n_y)`.
        driven: Weights of inputs, those `lags` samples ago, `(L, n_u, n_y)`.
        lags: `(L,)`.
        cubes: Weights of the cubes, newest first, `(C * n_y, n_y)`.
        constant: `(n_y,)`.
    """

    own: Array
    driven: Array
    lags: Sequence[int]
    cubes: Array
    constant: Array

    @classmethod
    def fit(
        cls, logs: Sequence[Log], order: int, delay: int = 0, direct: bool = False, ridge: float = 0.0, cubes: int = 0
    ) -> Arx:
        """Fit an order by least squares, with the input at the end of the interval, too, if it is `direct`.

        Raises:
            ValueError: There are fewer rows than twice as many as coefficients.
        """
        n_y, n_u = logs[0].y.shape[1], logs[0].u.shape[1]
        triangle, rows = _lagged(tuple(logs))
        lags = range(delay + (not direct), delay + order + 1)
        inputs = n_y * MOST
        powers = inputs + n_u * (MOST + LATEST + 1)
        one = powers + 3 * n_y
        groups = [range(n_y * order), *(range(inputs + n_u * j, inputs + n_u * (j + 1)) for j in lags)]
        columns = [k for group in (*groups, range(powers, powers + cubes * n_y), [one]) for k in group]
        if rows < 2 * len(columns):
            raise ValueError("too few samples")
        a, b = triangle[:, columns], triangle[:, one + 1 :]
        scale = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
        a = np.vstack([a / scale, math.sqrt(ridge) * np.eye(len(columns))])
        found = np.linalg.lstsq(a, np.vstack([b, np.zeros((len(columns), n_y))]), rcond=1e-13)[0] / scale[:, None]
        ends = np.cumsum([n_y * order, n_u * len(lags), cubes * n_y])
        own, driven, cubic, constant = np.split(found, ends)
        return cls(own, driven.reshape(len(lags), n_u, n_y), lags, cubic, constant[0])

    @classmethod
    def ways(cls, logs: Sequence[Log], cubic: bool = False) -> list[Fit]:
        """Return the fits to choose from."""
        # The mean of an interval is not known at its start.
        direct = (False, True) if logs[0].whole is None else (False,)
        cubes, ridges = ((1, 3), (0.0,)) if cubic else ((0,), (0.0, 1e-6))
        grid = product(range(1, MOST + 1), range(LATEST + 1), direct, ridges, cubes)
        return [
            partial(cls.fit, order=order, delay=delay, direct=end, ridge=ridge, cubes=powers)
            for order, delay, end, ridge, powers in grid
        ]

    @property
    def coefficients(self) -> int:
        """How many numbers were fitted."""
        return self.own.size + self.driven.size + self.cubes.size + self.constant.size

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return what is predicted for the samples after each start."""
        later, n_y = starts[:, None] + np.arange(1, steps + 1), log.y.shape[1]
        path = np.broadcast_to(self.constant, (len(starts), steps, n_y)).copy()
        for lag, weights in zip(self.lags, self.driven, strict=True):
            path += log.u[later - lag] @ weights
        order = len(self.own) // n_y
        recent = log.y[starts[:, None] - np.arange(max(order, 3))].reshape(len(starts), -1)
        for k in range(steps):
            now = path[:, k] + recent[:, : len(self.own)] @ self.own
            if len(self.cubes):
                now += recent[:, : len(self.cubes)] ** 3 @ self.cubes
            recent[:, n_y:] = recent[:, :-n_y].copy()
            path[:, k] = recent[:, :n_y] = now
        return path


@dataclass(frozen=True)
class StateSpace:
    """A linear model `x' = A x + B u + K e`, `y = C x + D u + e` by a subspace method that suits closed loops, too.

    The predictor of the outputs from past samples (a long ARX model) is a product of what the states show and of what
    tells them; its singular vectors give the states, which least squares turn into the matrices (Chiuso 2007, PBSID).

    Attributes:
        a: `(n, n)`; `b`, of inputs and of one, `(n, n_u + 1)`; `c` `(n_y, n)`; `d` `(n_y, n_u + 1)`; `k` `(n, n_y)`.
        from_past: States from past samples, newest first, each outputs, inputs, `(n, past * (n_y + n_u))`.
        centre: Of outputs and inputs, `(n_y + n_u,)`.
        scale: Of outputs and inputs, `(n_y + n_u,)`.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    k: Array
    from_past: Array
    centre: Array
    scale: Array

    @classmethod
    def fit(cls, logs: Sequence[Log], order: int, past: int = 10, direct: bool = False) -> StateSpace:
        """Fit a model of some order that reads so many past samples.

        Raises:
            ValueError: There are fewer rows than twice as many as coefficients, or fewer states than the order.
        """
        z, y, u, vectors, size, shown, centre, scale = _subspace(tuple(logs), past, direct)
        if order > len(size):
            raise ValueError("too few states")
        known = np.hstack([u[:, :-1] * direct, u[:, -1:]])
        from_past = (shown @ vectors[:order].T / (size[:order] / math.sqrt(len(y)))).T
        x = np.vstack(z) @ from_past.T
        c, d = np.split(np.linalg.lstsq(np.hstack([x, known]), y, rcond=None)[0].T, [order], 1)
        left = y - x @ c.T - known @ d.T
        ends = np.cumsum([len(part) for part in z])
        now = np.delete(np.arange(len(y)), ends - 1)
        step = np.linalg.lstsq(np.hstack([x, u, left])[now], x[now + 1], rcond=None)[0].T
        a, b, k = np.split(step, [order, order + u.shape[1]], 1)
        return cls(a, b, c, d, k, from_past, centre, scale)

    @classmethod
    def ways(cls, logs: Sequence[Log]) -> list[Fit]:
        """Return the fits to choose from."""
        direct = (False, True) if logs[0].whole is None else (False,)
        grid = product(range(1, 11), (5, 10, MOST), direct)
        return [partial(cls.fit, order=order, past=past, direct=end) for order, past, end in grid]

    @property
    def coefficients(self) -> int:
        """How many numbers were fitted."""
        return sum(matrix.size for matrix in (self.a, self.b, self.c, self.d, self.k))

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return what is predicted after each start, where a Kalman filter on the samples before tells the states."""
        z = (np.hstack([log.y, log.u]) - self.centre) / self.scale
        n_y, past = len(self.c), self.from_past.shape[1] // z.shape[1]
        u = np.hstack([z[:, n_y:], np.ones((len(z), 1))])
        x, states = self.from_past @ _past(z[: past + 1], past)[0], np.zeros((len(z) + 1, len(self.a)))
        own = self.a - self.k @ self.c
        driven = u @ (self.b - self.k @ self.d).T + z[:, :n_y] @ self.k.T
        for t in range(past, int(starts.max()) + 1):
            states[t + 1] = x = own @ x + driven[t]
        x, path = states[starts + 1], np.empty((len(starts), steps, n_y))
        for k in range(steps):
            now = u[starts + 1 + k]
            path[:, k] = x @ self.c.T + now @ self.d.T
            x = x @ self.a.T + now @ self.b.T
        return path * self.scale[:n_y] + self.centre[:n_y]


@lru_cache(maxsize=16)
def _subspace(logs: tuple[Log, ...], past: int, direct: bool) -> tuple[Any, ...]:
    """Return past samples of each log, outputs, inputs and one, and what tells the states from the past.

    Raises:
        ValueError: There are fewer rows than twice as many as coefficients.
    """
    n_y = logs[0].y.shape[1]
    both = np.vstack([np.hstack([log.y, log.u]) for log in logs])
    centre, scale = both.mean(0), np.maximum(both.std(0), 1e-300)
    parts = [(np.hstack([log.y, log.u]) - centre) / scale for log in logs]
    n_z, z = len(centre), [_past(part, past) for part in parts]
    y, u = (np.vstack([part[past:, cut] for part in parts]) for cut in (slice(n_y), slice(n_y, None)))
    u = np.hstack([u, np.ones((len(y), 1))])
    regressors = np.hstack([np.vstack(z), u[:, :-1] * direct, u[:, -1:]])
    if len(y) < 2 * regressors.shape[1]:
        raise ValueError("too few samples")
    markov = np.linalg.lstsq(regressors, y, rcond=1e-12)[0][: past * n_z]
    # What comes f samples later of what was measured i samples ago is the weight of i + f samples.
    shown = np.hstack([np.vstack([markov[f * n_z :], np.zeros((f * n_z, n_y))]) for f in range(past)])
    _, size, vectors = np.linalg.svd(np.linalg.qr(np.vstack(z)).R @ shown, full_matrices=False)
    return z, y, u, vectors, size, shown, centre, scale


def _past(z: Array, past: int) -> Array:
    """Return the samples before each one that has so many, newest first, `(N - past, past * n_z)`."""
    return np.hstack([z[past - i : len(z) - i] for i in range(1, past + 1)])


@dataclass(frozen=True)
class InverseDynamics:
    """An axis by least squares of its force: mass, viscous and dry friction, and a constant, `(4,)`."""

    constants: Array
    coefficients: int = 4

    @classmethod
    def fit(cls, logs: Sequence[Log], cutoff: float) -> InverseDynamics:
        """Fit rates and accelerations of places filtered forth and back below a frequency [Hz]."""
        rows, forces = [], []
        for log in (log.whole or log for log in logs):
            weights = butter(4, 2 * cutoff * log.dt)

            def _filtered(signal: Array, weights: tuple[Array, Array] = weights) -> Array:
                found: Array = filtfilt(*weights, signal)
                return found

            v = np.gradient(_filtered(log.y[:, 0]), log.dt)
            # Whatever is compared went through the filter twice.
            parts = [_filtered(np.gradient(v, log.dt)), _filtered(v), _filtered(_filtered(np.sign(v))), np.ones(len(v))]
            inside = slice(FIRST, len(v) - FIRST)
            rows.append(np.stack(parts, -1)[inside])
            forces.append(_filtered(_filtered(log.u[:, 0]))[inside])
        return cls(np.linalg.lstsq(np.vstack(rows), np.hstack(forces), rcond=None)[0])

    @classmethod
    def ways(cls, logs: Sequence[Log]) -> list[Fit]:
        """Return the fits to choose from."""
        dt = (logs[0].whole or logs[0]).dt
        return [partial(cls.fit, cutoff=hertz) for hertz in (5.0, 10.0, 20.0, 40.0, 80.0) if 2 * hertz * dt < 1]

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return places after each start, where a cubic through ten samples tells place and speed."""
        mass, viscous, dry, constant = self.constants
        t = log.dt * np.arange(-9, 1)
        cubic = np.linalg.lstsq(np.vander(t, 4), log.y[starts[:, None] + np.arange(-9, 1), 0].T, rcond=None)[0]
        q, v, path, dt = cubic[3], cubic[2], np.empty((len(starts), steps, 1)), log.dt / 2

        def _rate(speed: Array, force: Array) -> Array:
            return (force - viscous * speed - dry * np.tanh(1e3 * speed) - constant) / mass

        for k in range(steps):
            force = log.u[starts + k, 0]
            for _ in range(2):
                k1 = _rate(v, force)
                k2 = _rate(v + dt / 2 * k1, force)
                k3 = _rate(v + dt / 2 * k2, force)
                k4 = _rate(v + dt * k3, force)
                q, v = q + dt * v + dt**2 / 6 * (k1 + k2 + k3), v + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            path[:, k, 0] = q
        return path


@dataclass(frozen=True)
class HeatedBodies:
    """Temperatures that a heater each, which lags behind its input, and the air change: `T' = a h - b (T - T_air)`.

    Attributes:
        numbers: a, b, the temperature of the air, and how fast the heater follows [1/s], `(4, n_y)`.
    """

    numbers: Array

    @classmethod
    def fit(cls, logs: Sequence[Log]) -> HeatedBodies:
        """Fit simulations of whole logs, each temperature alone."""
        found = []
        for i in range(logs[0].y.shape[1]):
            one = [Log(log.y[:, i : i + 1], log.u[:, i : i + 1], log.dt) for log in logs]

            def _errors(logarithms: Array, one: Sequence[Log] = one) -> Array:
                model = cls(np.exp(logarithms)[:, None])
                paths = (model.predict(log, np.array([0]), len(log) - 1)[0] - log.y[1:] for log in one)
                return np.concatenate(list(paths))[:, 0]

            start = np.log([0.005, 0.006, one[0].y.min(), 0.05])
            found.append(np.exp(least_squares(_errors, start, x_scale=[1, 1, 0.1, 1]).x))
        return cls(np.stack(found, -1))

    @property
    def coefficients(self) -> int:
        """How many numbers were fitted."""
        return self.numbers.size

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return temperatures after each start; heaters are cold at the beginning of the log."""
        gain, loss, air, speed = self.numbers
        follows = np.exp(-speed * log.dt)
        heaters = np.zeros_like(log.y)
        for t in range(len(log) - 1):
            heaters[t + 1] = follows * heaters[t] + (1 - follows) * log.u[t]
        x, path = log.y[starts], np.empty((len(starts), steps, log.y.shape[1]))
        keeps = np.exp(-loss * log.dt)
        for k in range(steps):
            now = (heaters[starts + k] + heaters[starts + k + 1]) / 2
            x = keeps * x + (1 - keeps) * (air + gain / loss * now)
            path[:, k] = x
        return path
