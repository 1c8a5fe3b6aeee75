"""Gauss-Newton on the one-step prediction error, with the functions that matter selected on the way."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.library import Library
from dynasindy.world_models.regression import least_missed
from dynasindy.world_models.sensitivity import Parameters, Propagator

LONGEST_STEP = 0.005
"""Longest Runge-Kutta step [s] of a refinement: at rates of 10/s its relative error is below 1e-7."""


def substeps_for(dt: float) -> int:
    """Return into how many Runge-Kutta steps an interval of dt [s] is divided."""
    return max(1, math.ceil(dt / LONGEST_STEP - 1e-9))


def refine_one_step(
    library: Library, xi: Tensor, free: Tensor, data: Transitions, tolerance: float, max_rounds: int = 8
) -> Tensor:
    """Minimise the one-step prediction error over the active coefficients; drop those that do not matter.

    Each round makes one Gauss-Newton step with all active coefficients; from the same linear model coefficients
    are dropped, least missed first, while the Bayesian criterion gains. It ends when neither the support nor the
    coefficients move.

    Args:
        library: candidate functions.
        xi: first estimate, `(n_features, n_x)`.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: transitions.
        tolerance: error of a one-step prediction, relative to the change over the step, that is taken as exact.
        max_rounds: limit on the rounds.

    Returns:
        Coefficients, `(n_features, n_x)`.
    """
    data = data.to(torch.float64)
    floor = tolerance * (data.x_next - data.x).square().mean(0).sqrt()
    limit = math.log(len(data))
    support = (xi != 0) & free
    for _ in range(6):
        xi, support = _descend(library, xi, support, data, floor, max_rounds)
        missed = _missed(library, xi, support, free, data, floor, limit)
        if not bool(missed.any()):
            break
        support = support | missed
    return xi


def _descend(
    library: Library, xi: Tensor, support: Tensor, data: Transitions, floor: Tensor, max_rounds: int
) -> tuple[Tensor, Tensor]:
    """Step and drop until neither the support nor the coefficients move."""
    for _ in range(max_rounds):
        parameters = Parameters.where(support)
        if not len(parameters):
            break
        rows, target, scale = linear_model(library, xi, parameters, data, floor)
        triangle = torch.linalg.qr(torch.cat([rows, target], -1), mode="r")[1]
        removable = torch.ones(len(parameters), dtype=torch.bool)
        kept, values = walk_down(triangle, removable, math.log(len(data)))
        chosen = Parameters(parameters.features[kept], parameters.states[kept])
        last, xi = xi, chosen.write(torch.where(support, 0.0, xi), values / scale[kept])
        support = chosen.support(xi.shape)
        change = ((xi - last).abs() / xi.abs().clamp_min(1e-300))[support]
        if len(chosen) == len(parameters) and float(change.max()) < 1e-7:
            break
    return xi, support


def _missed(
    library: Library, xi: Tensor, support: Tensor, free: Tensor, data: Transitions, floor: Tensor, limit: float
) -> Tensor:
    """Find functions that are not in the model but would lower its error by more than they cost (a score test)."""
    others = Parameters.where(free & ~support)
    if not len(others) or not bool(support.any()):
        return torch.zeros_like(support)
    rows, target, _ = linear_model(library, xi, Parameters.where(support) + others, data, floor)
    n = int(support.sum())
    basis = torch.linalg.qr(rows[:, :n])[0]
    error, columns = (t - basis @ (basis.mT @ t) for t in (target, rows[:, n:]))
    growth = (columns.mT @ error).squeeze(-1).square() / columns.square().sum(0).clamp_min(1e-12)
    return others.best_of_each_state(growth, 2 * limit).support(support.shape)


def linear_model(
    library: Library, xi: Tensor, parameters: Parameters, data: Transitions, floor: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Linearise the one-step prediction error, each state weighted by its error.

    Args:
        library: candidate functions.
        xi: coefficients, `(n_features, n_x)`.
        parameters: coefficients to differentiate by, P of them.
        data: transitions, float64.
        floor: error of each state below which it is not weighted further, `(n_x,)`.

    Returns:
        J with columns of unit norm, `(N n_x, P)`; J xi + error, `(N n_x, 1)`; the norms, `(P,)`.
    """
    propagator = Propagator(library, xi, parameters)
    start = propagator.start(len(data))
    predicted, s = propagator.advance(data.x, start, data.u, data.dt, substeps_for(data.dt))
    error, jacobian = data.x_next - predicted, s[:, :, xi.shape[1] :]
    weight = 1 / torch.maximum(error.square().mean(0).sqrt(), floor).clamp_min(1e-300)
    rows = (jacobian * weight.unsqueeze(-1)).reshape(-1, len(parameters))
    scale = rows.norm(dim=0).clamp_min(1e-300)
    target = (error * weight).reshape(-1, 1) + rows @ parameters.read(xi).unsqueeze(-1)
    return rows / scale, target, scale


def walk_down(triangle: Tensor, removable: Tensor, limit: float) -> tuple[Tensor, Tensor]:
    """Drop parameters, least missed first, while each costs less than `limit` of squared weighted error.

    Args:
        triangle: R of [columns, target], `(n + 1, n + 1)`.
        removable: parameters that may be dropped, bool `(n,)`.
        limit: growth of the squared error, in units of its variance, that a parameter must be worth.

    Returns:
        Positions of the parameters that stay, and their values, both `(n_kept,)`.
    """
    active = torch.arange(triangle.shape[1] - 1)
    while True:
        n = len(active)
        j, growth = least_missed(triangle, n, removable[active])
        if j < 0 or growth >= limit:
            break
        keep = [k for k in range(n) if k != j]
        triangle = torch.linalg.qr(triangle[:, [*keep, n]], mode="r")[1]
        active = active[keep]
    n = len(active)
    values = torch.linalg.solve_triangular(triangle[:n, :n], triangle[:n, n:], upper=True).squeeze(-1)
    return active, values
