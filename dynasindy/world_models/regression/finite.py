"""Coefficients that ran away, as a line that says which."""

from __future__ import annotations

from torch import Tensor

from dynasindy.systems.diverged import Diverged
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.writers.tables import change_of


def require_finite(coefficients: Tensor, library: Library, source: str, samples: int) -> Tensor:
    """Return coefficients as they are.

    Args:
        coefficients: Xi, `(n_features, n_x)`.
        library: its functions.
        source: what found them, for the message.
        samples: how many samples it had.

    Raises:
        Diverged: one of them is not finite.
    """
    if len(wrong := (~coefficients.isfinite()).nonzero()):
        k, i = wrong[0].tolist()
        place = f"{library.names[k]} in {change_of(library, library.signature.state_names[i])}"
        raise Diverged(
            f"model learning: the {source} on {samples} samples left {len(wrong)} coefficients that are not finite, "
            f"such as {coefficients[k, i].item()} of {place}; leave that function out of the library, or check the "
            "data's units"
        )
    return coefficients
