"""Which coefficients a linear least-squares model needs, decided on its triangular factor."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dynasindy.world_models.regression.sensitivity import Parameters

DEPENDENT = 1e-13
"""Part of a column of unit norm that others leave over, below which it depends on them."""
BETTER = 2.0
"""Squared weighted error that an exchange of one coefficient for one other must gain."""
IDLE = 1e-12
"""Norm of a column, of those that have norm one, below which a parameter has no effect."""


def least_missed(
    triangle: Tensor, n: int, removable: Tensor | None = None, dependent: float = DEPENDENT
) -> tuple[int, float]:
    """Find the column whose removal lets the squared residual grow least; a dependent column is free to go.

    Args:
        triangle: R of [columns, target], `(n + 1, n + 1)` or taller.
        n: number of columns.
        removable: columns to choose from, bool `(n,)`; all by default.
        dependent: part of a column that others leave over, below which it depends on them.

    Returns:
        Position of the column and the growth of the squared residual; -1 where there is nothing to choose.
    """
    if n == 0 or (removable is not None and not bool(removable.any())):
        return -1, math.inf
    square, rotated = triangle[:n, :n], triangle[:n, n]
    pivots = square.diagonal().abs()
    if removable is not None:
        pivots = torch.where(removable, pivots, math.inf)
    if float(pivots.min()) < dependent:
        return int(pivots.argmin()), 0.0
    inverse = torch.linalg.solve_triangular(square, torch.eye(n, dtype=square.dtype), upper=True)
    growth = (inverse @ rotated).square() / inverse.square().sum(-1)
    if removable is not None:
        growth = torch.where(removable, growth, math.inf)
    return int(growth.argmin()), float(growth.min())


def walk_down(triangle: Tensor, removable: Tensor, limit: float, dependent: float = DEPENDENT) -> tuple[Tensor, Tensor]:
    """Drop parameters, least missed first, while each costs less than `limit` of squared weighted error.

    Args:
        triangle: R of [columns, target], `(n + 1, n + 1)`.
        removable: parameters that may be dropped, bool `(n,)`.
        limit: growth of the squared error, in units of its variance, that a parameter must be worth.
        dependent: part of a column that others leave over, below which it depends on them.

    Returns:
        Positions of the parameters that stay, and their values, both `(n_kept,)`.
    """
    active = torch.arange(triangle.shape[1] - 1)
    # What always stays and has no effect, as the number inside a function that is not in the model, stays as it is.
    idle = (triangle[:, :-1].norm(dim=0) < IDLE) & ~removable
    if bool(idle.any()):
        unit = torch.nn.functional.pad(torch.diag(idle.to(triangle.dtype))[idle], (0, 1))
        triangle = torch.linalg.qr(torch.cat([triangle, unit]), mode="r")[1]
    while True:
        n = len(active)
        j, growth = least_missed(triangle, n, removable[active], dependent)
        if j < 0 or growth >= limit:
            break
        keep = [k for k in range(n) if k != j]
        triangle = torch.linalg.qr(triangle[:, [*keep, n]], mode="r")[1]
        active = active[keep]
    n = len(active)
    values = torch.linalg.solve_triangular(triangle[:n, :n], triangle[:n, n:], upper=True).squeeze(-1)
    return active, values


def reconsider(triangle: Tensor, n_fixed: int, active: Parameters, others: Parameters, limit: float) -> Tensor | None:
    """Look for a better set of coefficients than the one at which a refinement stands still.

    First a score test: a function outside the model that would lower the error by more than it costs comes in, the
    best one of each equation. If there is none, an exchange: a function comes in if two or more can go for it, as
    sin(alpha) for the three functions that imitate it at small angles. They may go in other equations, too: a wrong
    function in one equation may hold one in another that makes up for it. At last the best of the exchanges one for
    one, within an equation.

    Args:
        triangle: R of [fixed unknowns, active, others, target].
        n_fixed: number of unknowns that always stay (start states).
        active: coefficients in the model.
        others: coefficients outside the model that are allowed.
        limit: squared weighted error that a coefficient must be worth.

    Returns:
        Positions of the better set in `active + others`, `(n,)`; None where there is none.
    """
    n = n_fixed + len(active)
    columns, error = triangle[n:, n:-1], triangle[n:, -1]
    growth = (columns.mT @ error).square() / columns.square().sum(0).clamp_min(1e-12)
    best = others.best_of_each_state(growth, 2 * limit)
    if len(best):
        return torch.cat([torch.arange(len(active)), len(active) + best])
    swaps: dict[float, Tensor] = {}
    for k in range(len(others)):
        state = others.states[k]
        chosen = [*range(n), n + k, triangle.shape[1] - 1]
        small = torch.linalg.qr(triangle[:, chosen], mode="r")[1]
        removable = torch.zeros(n + 1, dtype=torch.bool)
        removable[n_fixed:n] = True
        kept, _ = walk_down(small, removable, limit)
        if len(kept) <= n - 1:
            stay = kept[(kept >= n_fixed) & (kept < n)] - n_fixed
            return torch.cat([stay, torch.tensor([len(active) + k])])
        removable[n_fixed:n] = active.states == state
        out, missed = least_missed(small, n + 1, removable)
        if float(growth[k]) > missed + BETTER:
            stay = torch.tensor([j for j in range(len(active)) if j != out - n_fixed], dtype=torch.int64)
            swaps[float(growth[k]) - missed] = torch.cat([stay, torch.tensor([len(active) + k])])
    return swaps[max(swaps)] if swaps else None
