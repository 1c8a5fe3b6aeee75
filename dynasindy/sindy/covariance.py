"""How well a fit knows its coefficients: their covariance, from how they move when a stretch of the data is left out.

The textbook's covariance, s^2 inv(J'J), takes every error for a witness of its own, and is many times too small where
errors of a model last over many samples. Here each of some stretches is left out in turn, and the linear least squares
are solved without it: the jackknife over groups (Quenouille 1956, Tukey 1958). It holds for errors that are forgotten
within a stretch, and of which no size is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.sindy.sensitivity import Parameters

STRETCHES = 10
"""Stretches of the data, each of which is left out in turn; fewer where there are fewer rows. More of them tell the
size of an error more exactly, but forget less of an error that lasts."""


class Covariance(NamedTuple):
    """Hold the covariance of the coefficients that a fit found.

    Attributes:
        features: row in Xi of each coefficient, `(P,)`; others are given, or not in the equations.
        states: column in Xi of each, `(P,)`.
        factor: its rows are those of the coefficients; times its transpose it is the covariance, `(P, K)`.
    """

    features: Tensor
    states: Tensor
    factor: Tensor

    @property
    def errors(self) -> Tensor:
        """Return the standard error of each coefficient, `(P,)`."""
        return self.factor.norm(dim=-1)

    def shares(self, xi: Tensor) -> Tensor:
        """Return the standard errors as shares of coefficients `(n_features, n_x)`, `(P,)`."""
        return self.errors / xi[self.features, self.states].abs()


def of_rates(coefficients: Tensor, free: Tensor, theta: Tensor, dx: Tensor) -> Covariance | None:
    """Return the covariance of a regression of rates of change.

    It is None where nothing was fitted, or a number in it is not finite.

    Args:
        coefficients: Xi of the fit, `(n_features, n_x)`.
        free: coefficients that were fitted, bool `(n_features, n_x)`.
        theta: functions, `(N, n_features)`, in the order of time.
        dx: rates of change, `(N, n_x)`.
    """
    parameters = Parameters.where(free & (coefficients != 0))
    if not len(parameters):
        return None
    errors, factors = dx - theta @ coefficients, []
    for state in range(coefficients.shape[1]):
        active = parameters.features[parameters.states == state]
        rows = torch.cat([theta[:, active], errors[:, state : state + 1]], -1)
        factor = jackknife(rows.tensor_split(min(STRETCHES, len(rows))))
        if factor is None:
            return None
        factors.append(factor)
    return Covariance(parameters.features, parameters.states, torch.cat(factors))


def jackknife(parts: Sequence[Tensor], always: Tensor | None = None) -> Tensor | None:
    """Return how unknowns move when each part of the data is left out, as a factor of their covariance.

    Args:
        parts: slopes by the unknowns, and errors as the last column, `(R, M + 1)` of each part, in the order of time;
            or the triangular factor of such rows.
        always: rows that are never left out, `(R, M + 1)`.

    Returns:
        The factor, `(M, len(parts))`. None where a number is not finite, as of a model that all but runs away.
    """
    count, parts = len(parts), [_triangle(part) for part in parts]
    always = parts[0][:0] if always is None else always
    scale = torch.cat([*parts, always]).norm(dim=0).clamp_min(1e-100)
    if not bool(scale.isfinite().all()):
        return None
    scale[-1] = 1.0
    parts = [part / scale for part in parts]
    found = []
    for k in range(count):
        others = _triangle(torch.cat([*parts[:k], *parts[k + 1 :], always / scale]))
        solved = torch.linalg.lstsq(others[:, :-1], others[:, -1:], driver="gelsd").solution
        found.append(solved.squeeze(-1) / scale[:-1])
    apart = torch.stack(found, -1)
    apart = apart - apart.mean(-1, keepdim=True)
    return apart * ((count - 1) / count) ** 0.5


def _triangle(rows: Tensor) -> Tensor:
    """Return the triangular factor of rows, as many rows of it as there are columns at most."""
    return torch.linalg.qr(rows, mode="r")[1]
