"""Sparse regression: rows out of a recording, their triangular factor, and the coefficients that they need."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor

from dynasindy.safe_io import checked_class
from dynasindy.systems.steps import time_step_of
from dynasindy.systems.transitions import Transitions

REFITS = 20
"""Refits of a target at most."""
DEPENDENT = 1e-13
"""Part of a column of unit norm that others leave over, below which it depends on them."""


def least_missed(
    triangle: Tensor, n: int, removable: Tensor | None = None, dependent: float = DEPENDENT
) -> tuple[int, float]:
    """Return the removable column of R without which the squared residual grows least, and by how much; -1 if none.

    A column of which others leave over less than `dependent` is free to go.
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


def _backward(
    triangle: Tensor, active: Tensor, removable: Tensor | None = None, dependent: float = DEPENDENT
) -> Iterator[tuple[Tensor, Tensor, float]]:
    """Drop columns of R of [columns, target], least missed first; yield R, their places, and what the next costs."""
    # R is factored anew after each drop: nearly collinear functions (alpha, sin alpha) ruin cheaper updates.
    while True:
        n = len(active)
        j, growth = least_missed(triangle, n, None if removable is None else removable[active], dependent)
        yield triangle, active, growth
        if j < 0:
            return
        keep = [k for k in range(n) if k != j]
        triangle, active = torch.linalg.qr(triangle[:, [*keep, n]], mode="r")[1], active[keep]


def _best_set(
    theta: Tensor,
    target: Tensor,
    active: Tensor,
    score: Callable[[Tensor, Tensor], float],
    dependent: float = DEPENDENT,
) -> tuple[float, Tensor]:
    """Return the least score, of R of [columns, target] and their places, that `_backward` comes by, and the places."""
    n, rows = len(active), torch.cat([theta[:, active], target.unsqueeze(-1)], -1)
    triangle = torch.linalg.qr(torch.nn.functional.pad(rows, (0, 0, 0, max(0, n + 1 - len(rows)))), mode="r")[1]
    sets = ((left, some) for left, some, _ in _backward(triangle, active, dependent=dependent))
    # Dependent columns leave a row of R to nobody, which would count as explained: they go before a set is scored.
    apart = (pair for pair in sets if bool((pair[0].diagonal()[: len(pair[1])].abs() >= dependent).all()))
    return min(((score(*pair), pair[1]) for pair in apart), key=lambda scored: scored[0])


def _solution(triangle: Tensor, n: int) -> Tensor:
    """Return the least squares solution for n columns, `(n,)`."""
    return torch.linalg.solve_triangular(triangle[:n, :n], triangle[:n, n:], upper=True).squeeze(-1)


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
    sets = _backward(triangle, active, removable, dependent)
    left, active = next((left, active) for left, active, growth in sets if growth >= limit)
    return active, _solution(left, len(active))


SAMPLES_EACH = 5
"""Samples for each function of a library that is cut to the size of the data."""


EDGE = 0.25
"""Part of the samples that is kept back, those farthest from the middle of what was seen."""
PER_TERM = 0.1
"""Part of the error at the edge that a linear term must be worth; one of another function twice as much."""
NEGLIGIBLE = 1e-8
"""Part of a rate of change at the edge below which an error is none."""


def needed_at_edge(rows: Rows, x: Tensor, free: Tensor, offset: Tensor, complexity: Sequence[float]) -> Tensor:
    """Choose functions by samples at the edge of what was seen, which their coefficients are not fitted to.

    Functions that look alike over what was seen, as an angle and its sine, differ beyond it, where a policy goes. So
    coefficients are fitted to the inner samples, functions are dropped one by one, least missed first, and the set
    that predicts the outer samples best stays, a small one sooner than a large one. That is done with the simplest
    functions alone, then with more and more complex ones beside them.

    Args:
        rows: functions `(N, n_features)` and rates of change `(N, n_x)`.
        x: states of the rows, `(N, n_x)`.
        free: where coefficients are sought, bool `(n_features, n_x)`.
        offset: coefficients that are given, `(n_features, n_x)`.
        complexity: of each function, the least first.

    Returns:
        Where coefficients are to be sought, bool `(n_features, n_x)`.
    """
    theta, dx = rows[0], rows[1] - rows[0] @ offset
    away = (x - x.median(0).values).abs()
    away = (away / away.amax(0).clamp_min(1e-300)).amax(-1)
    outer = away > away.quantile(1 - EDGE)
    if not bool(outer.any()):  # more than that lie at the very edge, as of a plant that rests at two places
        return free
    theta = theta / theta.norm(dim=0).clamp_min(1e-300)
    ranks, needed = torch.tensor(complexity), free.clone()  # all where nothing tells
    weights = torch.where(ranks > 1, 2.0, 1.0)
    inside, beyond = theta[~outer], theta[outer]
    for i in free.any(0).nonzero().flatten().tolist():
        real, best, tried = dx[outer, i], math.inf, -1

        def _score(triangle: Tensor, active: Tensor, real: Tensor = real) -> float:
            if not len(active):
                return math.inf
            error = (real - beyond[:, active] @ _solution(triangle, len(active))).norm() / real.norm().clamp_min(1e-300)
            return math.log(max(float(error), NEGLIGIBLE)) + PER_TERM * float(weights[active].sum())

        for rank in ranks.unique().tolist():
            mine = (free[:, i] & (ranks <= rank)).nonzero().flatten()
            if len(mine) == tried or 2 * len(mine) > len(inside):
                continue
            tried = len(mine)
            score, chosen = _best_set(inside, dx[~outer, i], mine, _score)
            if score < best:
                best = score
                needed[:, i] = False
                needed[chosen, i] = True
    return needed


Rows = tuple[Tensor, Tensor]
Theta = Callable[[Tensor, Tensor], Tensor]


def integral_form(library: Theta, data: Transitions, field: Theta | None = None) -> Rows:
    """Average the functions over each sampling interval and take the mean rate of change over it.

    Under zero-order hold the input is constant within an interval and jumps between two, so neither a centred
    difference nor a derivative filter is right; the trapezoidal rule within the interval is. With a first model it is
    Simpson's rule, whose midpoint is the cubic Hermite interpolant 0.5 (x_k + x_k+1) + dt/8 (f_k - f_k+1): fourth order
    instead of second, which is what data at the control period (0.05 s) need. Inputs that move are taken where the
    interval ends. A difference equation has its functions where the interval begins, and nothing is averaged.

    Args:
        library: `(x, u) -> (N, n_features)`.
        data: transitions, N rows.
        field: first model `(x, u) -> dx`, `(N, n_x)`. That it is one of a difference equation is told by its `step`, or
            by that of the library where there is no model.

    Returns:
        Averaged functions, `(N, n_features)`, and `(x_k+1 - x_k) / dt`, `(N, n_x)`, float64.
    """
    data = data.to(torch.float64)
    rates, begin = (data.x_next - data.x) / data.dt, library(data.x, data.u)
    if time_step_of(field or library) is not None:
        return begin, rates
    ends = begin + library(data.x_next, data.last_inputs)
    if field is None:
        return 0.5 * ends, rates
    bend = field(data.x, data.u) - field(data.x_next, data.last_inputs)
    middle = 0.5 * (data.x + data.x_next) + data.dt / 8 * bend
    return (ends + 4 * library(middle, data.mean_inputs)) / 6, rates


class TriangularFactor:
    """Hold the triangular factor R of samples, which tells all that a regression asks of them.

    Args:
        rows: theta `(N, n_features)` and dx `(N, n_x)`.
        block: samples handled at once, which bounds the memory.

    Raises:
        ValueError: a sample is not finite.
    """

    def __init__(self, rows: Rows, block: int = 20_000) -> None:
        stacked = torch.cat(rows, -1).to(torch.float64)
        # A sum is a pass over the numbers; of numbers that are finite it may be too large for one.
        if not math.isfinite(float(stacked.sum())) and not bool(torch.isfinite(stacked).all()):
            bad = int((~torch.isfinite(stacked)).any(-1).sum())
            raise ValueError(
                f"{bad} of {len(stacked)} samples give functions that are not finite; allowed are finite ones: "
                "remove those samples or the function that overflows"
            )
        self.n_features, self.count = rows[0].shape[1], len(stacked)
        self.r = stacked.new_zeros(stacked.shape[1], stacked.shape[1])
        for part in stacked.split(block):
            self.r = torch.linalg.qr(torch.cat([self.r, part]), mode="r")[1]

    def norms(self) -> Tensor:
        """Return the 2-norm of every column of [Theta dX], `(n_features + n_x,)`."""
        return self.r.norm(dim=0)

    def theta(self) -> Tensor:
        """Return the columns of R that belong to the functions."""
        return self.r[:, : self.n_features]

    def targets(self) -> Tensor:
        """Return the columns of R that belong to the rates of change."""
        return self.r[:, self.n_features :]

    def residual(self, coefficients: Tensor) -> Tensor:
        """Return the 2-norm of dX - Theta Xi of each state, `(n_x,)`."""
        return (self.targets() - self.theta() @ coefficients).norm(dim=0)


@checked_class
@dataclass(frozen=True, config={"extra": "forbid"})
class Regression:
    """Settings of a sparse regression.

    Attributes:
        method: `stlsq` (sequentially thresholded least squares) or `bic` (backward elimination, Bayesian criterion).
        threshold: lambda of the paper, for `stlsq`; it acts on coefficients of columns of unit norm.
        normalize: `two_norm`, PySINDy's rule, which weakens as samples accumulate.
        tolerance: residual, relative to the rate of change, below which `bic` takes a fit as exact.
        dependent: part of a function that others leave over, below which `bic` takes it as one of them.
    """

    method: Literal["stlsq", "bic"] = "stlsq"
    threshold: Annotated[float, Field(ge=0)] = 0.9
    normalize: Literal["two_norm"] = "two_norm"
    tolerance: Annotated[float, Field(gt=0)] = 1e-5
    dependent: float = DEPENDENT

    def solve(self, factor: TriangularFactor, support: Tensor, offset: Tensor) -> Tensor:
        """Find sparse coefficients.

        Args:
            factor: of the samples.
            support: coefficients that may differ from zero, bool `(n_features, n_x)`.
            offset: coefficients that are given and stay, `(n_features, n_x)`.

        Returns:
            Coefficients, offset included, in the units of the data, `(n_features, n_x)`.
        """
        norms = factor.norms()
        scale = torch.where(norms > 0, norms, 1.0)
        columns, rates = scale[: factor.n_features], scale[factor.n_features :]
        theta = factor.theta() / columns
        targets = factor.targets() - factor.theta() @ offset
        if self.method == "bic":
            support = support & (norms[: factor.n_features] > 0).unsqueeze(-1)
            found = rates * _eliminate(theta, targets / rates, support, factor.count, self.tolerance, self.dependent)
        else:
            found = _stlsq(theta, targets, support, self.threshold)
        return offset + found / columns.unsqueeze(-1)


def least_squares(theta: Tensor, target: Tensor) -> Tensor:
    """Solve min |target - theta xi|, of least norm where theta is rank-deficient."""
    return torch.linalg.lstsq(theta, target.reshape(target.shape[0], -1), driver="gelsd").solution.reshape(
        theta.shape[1], *target.shape[1:]
    )


def fit_supported(theta: Tensor, dx: Tensor, support: Tensor) -> Tensor:
    """Return the least squares coefficients of rates `(N, n_x)` where `support` `(n_features, n_x)` is, else zero."""
    scale = theta.norm(dim=0).clamp_min(1e-300)
    return _stlsq(theta / scale, dx, support, 0.0) / scale.unsqueeze(-1)


def _stlsq(theta: Tensor, targets: Tensor, support: Tensor, limit: float) -> Tensor:
    """Threshold and refit until the support stands still (Brunton, Proctor, Kutz 2016), ridge 0.

    Args:
        theta: columns of unit norm, `(M, n_features)`.
        targets: `(M, n_x)`.
        support: coefficients to begin with, bool `(n_features, n_x)`.
        limit: smallest coefficient that stays.

    Returns:
        Coefficients, `(n_features, n_x)`.
    """
    coefficients = torch.zeros(theta.shape[1], targets.shape[1], dtype=theta.dtype)
    for i in support.any(0).nonzero().flatten().tolist():
        active = support[:, i].nonzero().squeeze(-1)
        xi = least_squares(theta[:, active], targets[:, i])
        for _ in range(REFITS):
            big = xi.abs() >= limit
            if bool(big.all()):
                break
            active = active[big]
            xi = least_squares(theta[:, active], targets[:, i]) if len(active) else xi[:0]
        coefficients[active, i] = xi
    return coefficients


def _eliminate(
    theta: Tensor, targets: Tensor, support: Tensor, count: int, tolerance: float, dependent: float = DEPENDENT
) -> Tensor:
    """Return coefficients of best Bayesian criterion, of columns of unit norm; an error of `tolerance` is exact."""
    coefficients = torch.zeros(theta.shape[1], targets.shape[1], dtype=theta.dtype)
    for i in support.any(0).nonzero().flatten().tolist():

        def _score(triangle: Tensor, active: Tensor) -> float:
            n = len(active)
            squared = float(triangle[n:, n].square().sum())
            return count * math.log(squared + tolerance**2) + n * math.log(max(count, 2))

        _, chosen = _best_set(theta, targets[:, i], support[:, i].nonzero().squeeze(-1), _score, dependent)
        if len(chosen):
            coefficients[chosen, i] = least_squares(theta[:, chosen], targets[:, i])
    return coefficients


OVERLAP = 4
"""Bumps that cover a sample."""


def weak_form(theta: Theta, measured: Transitions, guess: Transitions, rates: Mapping[int, int], half: int) -> Rows:
    """Average the functions and the rates of change by bumps of `2 half - 1` samples (Messenger and Bortz 2021).

    Whatever is done to the rates has to be done to the functions, or the fit explains the difference: a smoothed speed
    no longer jumps with its input. States that are the rate of a measured one enter by second differences of that.

    Returns:
        Averaged functions, `(M, n_features)`, and averaged rates of change, `(M, n_x)`, M about N over `half / 4`.

    Raises:
        ValueError: no segment has two transitions.
    """
    functions, changes, inputs = [], [], guess.mean_inputs
    for segment in guess.segment.unique_consecutive().tolist():
        mine = guess.segment == segment
        rows = mine.nonzero().flatten()
        if len(rows) < 2:
            continue
        within = min(half, max(1, (len(rows) - 1) // 2))
        mean = theta(0.5 * (guess.x[rows] + guess.x_next[rows]), inputs[rows])
        rate = _rates(measured, guess, rows, rates)
        bump = (1 - torch.linspace(-1, 1, 2 * within + 1, dtype=torch.float64)[1:-1].square()) ** 4
        both = torch.cat([0.5 * (mean[:-1] + mean[1:]), rate], -1)
        stride = max(1, within // OVERLAP)
        count = (len(both) - len(bump)) // stride + 1
        averaged = both.new_zeros(count, both.shape[1])
        for k, weight in enumerate((bump / bump.sum()).tolist()):
            averaged.add_(both[k : k + stride * (count - 1) + 1 : stride], alpha=weight)
        functions.append(averaged[:, : mean.shape[1]])
        changes.append(averaged[:, mean.shape[1] :])
    if not functions:
        raise ValueError(
            "a recording with states that were not measured has no two samples that follow each other; allowed are "
            "segments of two transitions or more: give unbroken stretches"
        )
    return torch.cat(functions), torch.cat(changes)


def _rates(measured: Transitions, guess: Transitions, rows: Tensor, rates: Mapping[int, int]) -> Tensor:
    """Return rates of change over two neighbouring intervals, `(n - 1, n_x)`."""
    x = torch.cat([guess.x[rows[:1]], guess.x_next[rows]])
    raw = torch.cat([measured.x[rows[:1]], measured.x_next[rows]])
    x = torch.where(raw.isnan(), x, raw)
    rate = (x[2:] - x[:-2]) / (2 * guess.dt)
    for i, of in rates.items():
        if bool(raw[:, i].isnan().all()):
            rate[:, i] = (x[2:, of] - 2 * x[1:-1, of] + x[:-2, of]) / guess.dt**2
    return rate
