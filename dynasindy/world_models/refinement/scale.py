"""The unit of a state that no sensor sees: nothing measured tells it, so a fit has to hold it.

A hidden state z in another unit is c z. Its equation has c times its coefficients then, and a function that grows as
the p-th power of z has c^-p times its coefficient in every equation. What is measured stays the same.

| name      | symbol                                                               | shape                     |
| --------- | -------------------------------------------------------------------- | ------------------------- |
| exponents | e: a coefficient becomes c^e times itself in the new unit            | `(n_x, n_features, n_x)`  |
| scales    | how many times the logarithm of c each state takes part in a change  | `(D, n_x)`                |
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.libraries.features import Feature
from dynasindy.world_models.libraries.library import Library

DEGREES = {"id": 1.0, "abs": 1.0, "sqrt": 0.5, "sign": 0.0}
"""Elementary functions of one variable that are c^p times themselves where it is c times itself, and p."""
SMALL = 1e-9
"""What counts as zero among singular values and exponents."""


def free_scales(library: Library, xi: Tensor, free: Tensor, unseen: Tensor) -> tuple[Tensor, Tensor]:
    """Return which units of hidden states are free, and how coefficients change with them.

    A unit is held by a coefficient that is given, as a known equation has, and by a function that is no power, as a
    sine or a bend at a given level. Units of several hidden states may be free only together.

    Args:
        library: candidate functions.
        xi: coefficients, `(n_features, n_x)`.
        free: which of them were fitted, bool `(n_features, n_x)`; others are given.
        unseen: states that no sensor sees, bool `(n_x,)`.

    Returns:
        Scales, `(D, n_x)`, D of them, and the exponents of the coefficients for each, `(D, n_features, n_x)`.
    """
    names, used = library.signature.state_names, xi != 0
    degrees = torch.tensor([[_degree(f, name) for name in names] for f in library.features], dtype=torch.float64)
    degrees = torch.where(used.any(-1, keepdim=True), degrees, 0.0)
    own = torch.eye(len(names), dtype=torch.float64).unsqueeze(1) - degrees.mT.unsqueeze(-1)
    exponents = torch.where(used, own.nan_to_num(), 0.0)
    takes_part = unseen & ~degrees.isnan().any(0) & (exponents != 0).flatten(1).any(-1)
    given = exponents[:, used & ~free]  # these may not change
    held = torch.cat([given.mT, torch.diag(1 - takes_part.double())])
    _, singular, directions = torch.linalg.svd(held)
    rank = int((singular > SMALL).sum())
    scales = directions[rank:]
    return scales, torch.einsum("di,ifx->dfx", scales, exponents)


def unscaled(library: Library, xi: Tensor, free: Tensor, data: Transitions) -> tuple[str, ...]:
    """Return the names of the hidden states whose unit nothing tells.

    Args:
        library: candidate functions.
        xi: coefficients, `(n_features, n_x)`.
        free: which of them were fitted, bool `(n_features, n_x)`; others are given.
        data: the recording, NaN where a state was not measured.
    """
    unseen = data.x.isnan().all(0) & data.x_next.isnan().all(0)
    if not bool(unseen.any()):
        return ()
    takes_part = free_scales(library, xi, free, unseen)[0].abs().sum(0) > SMALL
    return tuple(n for n, part in zip(library.signature.state_names, takes_part.tolist(), strict=True) if part)


def _degree(feature: Feature, name: str) -> float:
    """Return the power with which a function grows with a variable; NaN if it is no power."""
    mine = [factor for factor in feature.factors if name in factor.variables]
    return sum(
        factor.power * (DEGREES.get(factor.function, torch.nan) if not factor.fitted else torch.nan) for factor in mine
    )


def holding(exponents: Tensor, xi: Tensor, rows: Tensor, places: tuple[Tensor, Tensor]) -> Tensor:
    """Return rows that keep a fit from changing the units of hidden states, `(D, F + P + 1)`.

    Nothing measured depends on such a change, so the fit of everything else is the same with them.

    Args:
        exponents: of the coefficients, `(D, n_features, n_x)`.
        xi: coefficients, `(n_features, n_x)`.
        rows: slopes by the F fixed unknowns and the P coefficients, and errors, `(M, F + P + 1)`.
        places: rows and columns of the coefficients in Xi, `(P,)` both.
    """
    features, states = places
    count = len(features)
    norms = rows[:, -1 - count : -1].norm(dim=0)
    # The direction in which the fit would move, in coefficients by which the errors move alike.
    along = exponents[:, features, states] * xi[features, states] * norms
    held = rows.new_zeros(len(exponents), rows.shape[1])
    held[:, -1 - count : -1] = along * norms / along.norm(dim=-1, keepdim=True).clamp_min(1e-300)
    return held
