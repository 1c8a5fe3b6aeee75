"""Numbers inside functions, as a width or an inertia, from mean rates of change."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.sindy.codegen import generate
from dynasindy.sindy.functions import QUOTIENTS
from dynasindy.sindy.library import Feature, Library
from dynasindy.sindy.regression import Rows, Theta, fit_supported, least_squares

LITTLE = 1e-3
"""Gain of log-likelihood below which the numbers stand still."""
RowsOf = Callable[[Theta, Theta], Rows]
"""Functions `(x, u) -> (N, n_features)` and a first model `(x, u) -> dx` to averaged functions and rates of change."""


def fit_shapes(
    library: Library, xi: Tensor, free: Tensor, rows: RowsOf, tolerance: float, rounds: int = 10
) -> tuple[Library, Tensor]:
    """Fit the numbers inside the fitted factors, and the active coefficients with them.

    `rows` averages functions and rates of change, given the functions and a first model.

    Returns:
        The library with its shapes, and coefficients, `(n_features, n_x)`.
    """
    active = (xi != 0) & free
    used = {f.base for k in active.any(-1).nonzero().flatten().tolist() for f in library.features[k].factors}
    if not used & set(library.shapes):
        return library, xi
    xi, cost = _solved(library, xi, active, rows, tolerance)
    for _ in range(rounds):
        step, size = _step(library, xi, active, rows, tolerance), 1.0
        numbers = torch.tensor([shape.frequency for shape in library.shapes], dtype=torch.float64)
        while size > 1e-3:
            # No number grows tenfold or changes its sign in one step.
            moved = numbers + (size * step).clamp(-0.9 * numbers.abs(), 9 * numbers.abs())
            trial = library.with_shapes(moved.tolist())
            found, lower = _solved(trial, xi, active, rows, tolerance)
            if lower >= cost:
                # Rates are averaged along a first model. With the moved numbers and the old coefficients that is a poor
                # one, and a good step looks bad; with the coefficients of these numbers it shows what it is worth.
                found, lower = _solved(trial, found, active, rows, tolerance)
            if lower < cost:
                break
            size /= 4
        else:
            return library, xi
        gain, library, xi, cost = cost - lower, trial, found, lower
        if gain < LITTLE:
            break
    return library, xi


def _solved(library: Library, xi: Tensor, active: Tensor, rows: RowsOf, tolerance: float) -> tuple[Tensor, float]:
    """Return the coefficients for these shapes, and N/2 log of the squared errors of all states."""
    theta, dx = rows(library, generate(library, xi))
    found = torch.where(active, 0.0, xi)
    found = found + fit_supported(theta, dx - theta @ found, active)
    shares = (dx - theta @ found).square().sum(0) / dx.square().sum(0)
    return found, 0.5 * len(dx) * float((shares + tolerance**2).log()[active.any(0)].sum())


def _step(library: Library, xi: Tensor, active: Tensor, rows: RowsOf, tolerance: float) -> Tensor:
    """Return the Gauss-Newton step of the shapes, `(S,)`."""
    shapes, n = library.shapes, len(library)

    def _both(x: Tensor, u: Tensor) -> Tensor:
        slopes = library.by_shapes(x, u, shapes).mT @ xi  # (N, S, n_x)
        return torch.cat([library(x, u), slopes.flatten(-2)], -1)

    both, dx = rows(_both, generate(library, xi))
    theta, slopes = both[:, :n], both[:, n:].unflatten(-1, (len(shapes), -1))
    error = dx - theta @ xi
    normal, target = [], []
    for i in range(xi.shape[1]):
        weight = 1 / (error[:, i].norm() + tolerance * dx[:, i].norm()).clamp_min(1e-300)
        mine = theta[:, active[:, i]]
        basis = torch.linalg.qr(mine / mine.norm(dim=0).clamp_min(1e-300))[0]
        own = slopes[:, :, i] - basis @ (basis.mT @ slopes[:, :, i])
        normal.append(weight * own)
        target.append(weight * error[:, i : i + 1])
    columns = torch.cat(normal)
    scale = columns.norm(dim=0).clamp_min(1e-300)
    return least_squares(columns / scale, torch.cat(target)).flatten() / scale


def is_quotient(feature: Feature) -> bool:
    """Tell whether a function is divided by a moment of inertia."""
    return any(factor.function in QUOTIENTS for factor in feature.factors)
