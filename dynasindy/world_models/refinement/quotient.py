"""Which angle a mass matrix depends on: the one whose quotients explain the rates of change best."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from dynasindy.world_models.libraries.features import Factor, Feature
from dynasindy.world_models.libraries.functions import QUOTIENTS
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.refinement.delay import unexplained
from dynasindy.world_models.regression.regression import Rows

COUPLINGS = (-0.03, -0.1, -0.3, -0.6, -0.85)
"""Numbers p that are tried where the angle is looked for that the mass matrix depends on."""


def one_quotient(library: Library, free: Tensor, rows: Callable[[Library], Rows]) -> Tensor:
    """Leave free in the equations what one angle turns, the angle whose quotients explain the rates of change best.

    A mass matrix has one determinant, by which all equations of the machine are divided. The functions of the angles
    that are not chosen are left out, but for those of gravity.

    Args:
        library: candidate functions; of quotients, those whose number is fitted are compared.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        rows: Averages the functions of a library, `(N, n_features)`, and the rates of change, `(N, n_x)`.

    Returns:
        What stays free, bool `(n_features, n_x)`; all of it where there is one angle or none.
    """
    kept = {angle: free & own.unsqueeze(-1) for angle, own in of_one_angle(library).items()}
    if len(kept) < 2:
        return free
    costs = dict.fromkeys(kept, math.inf)
    for number in COUPLINGS:
        trial = [number if shape.function in QUOTIENTS else shape.frequency for shape in library.shapes]
        theta, dx = rows(library.with_shapes(trial))
        triangle = torch.linalg.qr(torch.cat([theta, dx], -1), mode="r")[1]
        for angle, support in kept.items():
            costs[angle] = min(
                costs[angle], unexplained(support, triangle[:, : len(library)], triangle[:, len(library) :])
            )
    return kept[min(costs, key=costs.__getitem__)]


def of_one_angle(library: Library) -> dict[tuple[str, ...], Tensor]:
    """Return which functions an equation may have, by the angle of its quotients, bool `(n_features,)` each.

    They are those of that angle, those of gravity, and those of no angle; empty where the library has no quotients.

    Args:
        library: candidate functions.
    """
    angles = [_angle(shape) for shape in library.shapes if shape.function in QUOTIENTS]
    if not angles:
        return {}
    owners = [_owner(feature, angles) for feature in library.features]
    pulls = [len(feature.factors) < 2 and not _divided(feature) for feature in library.features]
    return {
        angle: torch.tensor([pull or own in (None, angle) for pull, own in zip(pulls, owners, strict=True)])
        for angle in angles
    }


def _divided(feature: Feature) -> bool:
    return any(factor.function in QUOTIENTS for factor in feature.factors)


def _owner(feature: Feature, angles: Sequence[tuple[str, ...]]) -> tuple[str, ...] | None:
    """Return the angle that turns a force: that of its quotient, else that of a sine or cosine; None of no angle."""
    quotients = sorted(feature.factors, key=lambda factor: factor.function not in QUOTIENTS)
    return next((_angle(factor) for factor in quotients if _angle(factor) in angles), None)


def _angle(factor: Factor) -> tuple[str, ...]:
    """Return the angle that a sine, a cosine or a quotient reads, as `_turned` takes it; of other functions none."""
    name, _, word = factor.function.removeprefix("per_").partition("_")
    return (*factor.variables, *([word] if word else [])) if name in ("sin", "cos", "cos2") else ()
