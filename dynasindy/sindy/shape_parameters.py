"""Numbers inside functions, as a width or an inertia, from mean rates of change."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.sindy.codegen import generate
from dynasindy.sindy.library import Library
from dynasindy.sindy.regression import Rows, Theta, fit_supported, least_squares

LITTLE = 1e-3
"""Gain of log-likelihood below which the numbers stand still."""
STEP = 1e-6
"""Part of a number by which it is moved, to differentiate by it."""
ROUNDED = 1e-7
"""Part of a slope that rounding may leave of it."""
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

    def _solved(library: Library, xi: Tensor) -> tuple[Tensor, float]:
        """Return the coefficients for these shapes, and N/2 log of the squared errors of all states."""
        theta, dx = rows(library, generate(library, xi))
        found = torch.where(active, 0.0, xi)
        found = found + fit_supported(theta, dx - theta @ found, active)
        shares = (dx - theta @ found).square().sum(0) / dx.square().sum(0)
        return found, 0.5 * len(dx) * float((shares + tolerance**2).log()[active.any(0)].sum())

    xi, cost = _solved(library, xi)
    for _ in range(rounds):
        numbers = torch.tensor([shape.frequency for shape in library.shapes], dtype=torch.float64)
        step, size = _step(library, numbers, xi, active, rows, tolerance), 1.0
        while size > 1e-3:
            # No number grows tenfold or changes its sign in one step.
            moved = numbers + (size * step).clamp(-0.9 * numbers.abs(), 9 * numbers.abs())
            trial = library.with_shapes(moved.tolist())
            found, lower = _solved(trial, xi)
            if lower >= cost:
                # Rates are averaged along a first model. With the moved numbers and the old coefficients that is a poor
                # one, and a good step looks bad; with the coefficients of these numbers it shows what it is worth.
                found, lower = _solved(trial, found)
            if lower < cost:
                break
            size /= 4
        else:
            return library, xi
        gain, library, xi, cost = cost - lower, trial, found, lower
        if gain < LITTLE:
            break
    return library, xi


def _step(library: Library, numbers: Tensor, xi: Tensor, active: Tensor, rows: RowsOf, tolerance: float) -> Tensor:
    """Return the Gauss-Newton step of the shapes, `(S,)`, from slopes that the coefficients cannot explain."""
    field, guesses = generate(library, xi), torch.tensor([shape.fitted for shape in library.shapes])
    by = STEP * numbers * torch.where(numbers.abs() > guesses.abs(), -1.0, 1.0)  # never beyond the limits of a number
    theta, dx = rows(library, field)
    moved = (library.with_shapes((numbers + by * unit).tolist()) for unit in torch.eye(len(by)))
    slopes = torch.stack([(rows(each, field)[0] - theta) @ xi / size for each, size in zip(moved, by, strict=True)], 1)
    both = torch.cat([slopes, (dx - theta @ xi).unsqueeze(1)], 1)  # (N, S + 1, n_x)
    columns = []
    for i in range(xi.shape[1]):
        mine = theta[:, active[:, i]]
        basis = torch.linalg.qr(mine / mine.norm(dim=0).clamp_min(1e-300))[0]
        own = both[:, :, i] - basis @ (basis.mT @ both[:, :, i])
        weight = (both[:, -1, i].norm() + tolerance * dx[:, i].norm()).clamp_min(1e-300)
        columns.append(torch.stack([own, both[:, :, i]]) / weight)
    stacked, whole = torch.cat(columns, 1)
    scale = stacked[:, :-1].norm(dim=0)
    # Of a number whose slope the coefficients explain but for rounding the data tell nothing: it stays.
    scale = torch.where(scale > ROUNDED * whole[:, :-1].norm(dim=0), scale, torch.inf)
    return least_squares(stacked[:, :-1] / scale, stacked[:, -1]) / scale
