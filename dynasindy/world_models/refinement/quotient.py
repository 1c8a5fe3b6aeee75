"""Which angle a mass matrix depends on: the one whose quotients explain the rates of change best."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.world_models.libraries.features import Factor
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
    angles = [_angle(shape) for shape in library.shapes if shape.function in QUOTIENTS]
    if len(angles) < 2:
        return free
    owners = [next((_angle(f) for f in feature.factors if _angle(f) in angles), None) for feature in library.features]
    bare = [len(feature.factors) < 2 for feature in library.features]
    kept = {
        angle: free & torch.tensor([b or own in (None, angle) for b, own in zip(bare, owners)]).unsqueeze(-1)
        for angle in angles
    }
    costs = dict.fromkeys(angles, math.inf)
    for number in COUPLINGS:
        trial = [number if shape.function in QUOTIENTS else shape.frequency for shape in library.shapes]
        theta, dx = rows(library.with_shapes(trial))
        triangle = torch.linalg.qr(torch.cat([theta, dx], -1), mode="r")[1]
        for angle, support in kept.items():
            costs[angle] = min(
                costs[angle], unexplained(support, triangle[:, : len(library)], triangle[:, len(library) :])
            )
    return kept[min(costs, key=costs.__getitem__)]


def _angle(factor: Factor) -> tuple[str, ...]:
    """Return the angle that a sine, a cosine or a quotient reads, as `_turned` takes it; of other functions none."""
    name, _, word = factor.function.removeprefix("per_").partition("_")
    return (*factor.variables, *([word] if word else [])) if name in ("sin", "cos", "cos2") else ()
