"""Plants that are pushed at random: what a Kalman filter of a model leaves over, and how large pushes and noise are.

A trajectory that is simulated without correction counts a push again in every sample that follows it, and explains it
by whatever coefficient resembles the drift it left. A Kalman filter corrects the state by each measurement, as far as
pushes have moved it by more than the sensors' noise: what it leaves over, its innovations, are white, and minimising
them is maximum likelihood (Åström 1980). Within a window the filter is that of the model linearised along the window's
own trajectory. Applied to errors and to their sensitivities alike it makes them independent with variance one, after
which least squares are what they are for white noise.

| name   | meaning                                                      | shape                |
| ------ | ------------------------------------------------------------ | -------------------- |
| rows   | errors and their slopes, at a window's start and its samples | `(W, L + 1, n_x, C)` |
| phi    | slopes of the end of each interval by its beginning          | `(W, L, n_x, n_x)`   |
| seen   | 1 where a state was measured, else 0                         | `(W, L + 1, n_x)`    |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

FLOOR = 1e-7
"""Part of the spread of a state below which its noise, or what pushes add in a sample, is that of the arithmetic."""
DIFFUSE = 1e3
"""Spreads of a state that its start in a window may lie from what was guessed."""
STEPS = 25
"""Steps in which the sizes of noise and pushes are found."""


@dataclass(frozen=True)
class Noise:
    """Say how noisy sensors are and how hard a plant is pushed.

    Attributes:
        sensor: standard deviation of the measurement of each state, `(n_x,)`.
        push: standard deviation of what random pushes add to each state in a second, `(n_x,)`.
    """

    sensor: Tensor
    push: Tensor


def whiten(rows: Tensor, seen: Tensor, phi: Tensor, noise: Noise, dt: float) -> tuple[Tensor, Tensor]:
    """Make errors under pushes and noise independent with variance one, the start of each window being an unknown.

    Args:
        rows: errors and their slopes, `(W, L + 1, n_x, C)`.
        seen: 1 where a state was measured, else 0, `(W, L + 1, n_x)`.
        phi: slopes of the end of each interval by its beginning, `(W, L, n_x, n_x)`.
        noise: sizes of noise and pushes.
        dt: length of an interval [s].

    Returns:
        The whitened rows, `(W, L + 1, n_x, C)`, zero where nothing was measured, and half of the logarithm of the
        determinant of their covariance, `()`.
    """
    n_x = rows.shape[2]
    variance, push = noise.sensor.square(), torch.diag(noise.push.square()) * dt
    state, covariance = torch.zeros_like(rows[:, 0]), torch.zeros(len(rows), n_x, n_x, dtype=rows.dtype)
    white = [rows[:, 0] * (seen[:, 0] / noise.sensor).unsqueeze(-1)]
    half = (seen[:, 0] * noise.sensor.log()).sum()
    for k in range(phi.shape[1]):
        step, mine = phi[:, k], seen[:, k + 1].unsqueeze(-1)
        # A push acts all through an interval: the mean of one at its beginning and one at its end.
        covariance = step @ (covariance + 0.5 * push) @ step.mT + 0.5 * push
        state = step @ state
        own = torch.diag_embed(torch.where(mine[..., 0] > 0, variance, 1.0))
        # Not a number, which no step survives, where a trial has left what numbers can hold.
        root = torch.linalg.cholesky_ex(mine * covariance * mine.mT + own)[0]
        shared = torch.linalg.solve_triangular(root, mine * covariance, upper=False)
        error = torch.linalg.solve_triangular(root, mine * (rows[:, k + 1] - state), upper=False)
        state = state + shared.mT @ error
        covariance = covariance - shared.mT @ shared
        white.append(error)
        half = half + root.diagonal(dim1=-2, dim2=-1).log().sum()
    return torch.stack(white, 1), half


def estimated(rows: Tensor, seen: Tensor, phi: Tensor, pushed: Tensor, spread: Tensor, dt: float) -> Noise:
    """Estimate how noisy sensors are and how hard the plant is pushed, by the likelihood of what windows leave over.

    The starts of the windows are integrated out, which allows for what they fit of the noise (restricted likelihood).

    Args:
        rows: slopes by the start state of each window and errors, `(W, L + 1, n_x, n_x + 1)`.
        seen: 1 where a state was measured, else 0, `(W, L + 1, n_x)`.
        phi: slopes of the end of each interval by its beginning, `(W, L, n_x, n_x)`.
        pushed: states whose rates may be pushed, bool `(n_x,)`.
        spread: spread of each state, `(n_x,)`.
        dt: length of an interval [s].
    """
    measured = (seen.sum((0, 1)) > 0).to(torch.float64)
    first = (rows[..., -1].square() * seen).sum((0, 1)) / seen.sum((0, 1)).clamp_min(1)
    guess = torch.stack([0.1 * first.sqrt(), spread / math.sqrt(dt * max(len(rows), 1) * rows.shape[1])])
    floors = torch.stack([FLOOR * spread, FLOOR * spread / math.sqrt(dt)]).clamp_min(1e-100)
    logs = guess.clamp_min(floors).log().requires_grad_(True)
    known = torch.diag(1 / (DIFFUSE * spread.clamp_min(1e-100)))
    known = torch.cat([known, torch.zeros(len(spread), 1, dtype=known.dtype)], -1).expand(len(rows), -1, -1)

    def _noise() -> Noise:
        sensor, push = logs.exp().clamp_min(floors)
        return Noise(torch.where(measured > 0, sensor, 1.0), torch.where(pushed, push, 0.0))

    optimizer = torch.optim.LBFGS([logs], max_iter=STEPS, tolerance_change=1e-3, line_search_fn="strong_wolfe")

    def _cost() -> float:
        optimizer.zero_grad()
        with torch.enable_grad():
            white, half = whiten(rows, seen, phi, _noise(), dt)
            upper = torch.linalg.qr(torch.cat([white.flatten(1, 2), known], 1))[1].diagonal(dim1=-2, dim2=-1)
            cost = half + upper[:, :-1].abs().clamp_min(1e-300).log().sum() + 0.5 * upper[:, -1].square().sum()
        cost.backward()
        return float(cost.detach())

    optimizer.step(_cost)
    found = _noise()
    return Noise(found.sensor.detach(), found.push.detach())
