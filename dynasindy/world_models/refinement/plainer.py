"""Equations without a quotient: what 1/(1 + p cos^2 a) says where p is nearly zero, 1 says as well."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.world_models.libraries.features import Feature
from dynasindy.world_models.libraries.functions import QUOTIENTS
from dynasindy.world_models.libraries.library import Library


def plainer(library: Library, xi: Tensor, free: Tensor, place: int) -> Tensor | None:
    """Return coefficients in which a quotient is left out, its terms standing without it; None where that cannot be.

    It cannot be where the number is one of another function, where it is not in use, or where a term has no free
    coefficient without the quotient.

    Args:
        library: candidate functions, with the numbers inside them as they were found.
        xi: coefficients, `(n_features, n_x)`.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        place: place of the quotient among the fitted numbers, `library.shapes`.
    """
    shape, found = library.shapes[place], xi.clone()
    if shape.function not in QUOTIENTS:
        return None
    places = {feature.key: k for k, feature in enumerate(library.features)}
    for k, feature in enumerate(library.features):
        if shape not in (factor.base for factor in feature.factors) or not bool(found[k].any()):
            continue
        bare = places.get(Feature(tuple(factor for factor in feature.factors if factor.base != shape)).key)
        if bare is None or not bool((free[bare] & free[k])[found[k] != 0].all()):
            return None
        found[bare] += found[k]
        found[k] = torch.zeros_like(found[k])
    return None if torch.equal(found, xi) else found
