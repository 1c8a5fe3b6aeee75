"""Ends of states that are given by name, as the limits of a plant and where it begins."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.text import did_you_mean

Ends = float | Sequence[float]
"""A number, or the two ends of a range."""


def state_limits(signature: Signature, given: Mapping[str, Ends], key: str = "plant.bounds") -> Tensor:
    """Return lower and upper limits of states, `(2, n_x)`, infinite where there is none.

    Args:
        signature: Names of the states.
        given: Limits by state: one for both sides of zero, or both ends.
        key: Setting in which they were given.

    Raises:
        ValueError: One is of no state, or is no range.
    """
    both = {name: [-v, v] if isinstance(v, int | float) else v for name, v in given.items()}
    free = torch.tensor([[-math.inf], [math.inf]], dtype=torch.float64).expand(-1, signature.n_x)
    return _put(signature, both, key, free.clone())


def start_ranges(signature: Signature, given: Mapping[str, Ends], key: str = "plant.start") -> Tensor:
    """Return the ends of the range in which states begin, `(2, n_x)`; those that are not named begin at zero.

    Args:
        signature: Names of the states.
        given: Where they begin, by state: a value, or the two ends of a range.
        key: Setting in which that was given.

    Raises:
        ValueError: One is of no state, or is no range.
    """
    return _put(signature, given, key, torch.zeros(2, signature.n_x))


def require_start_within(
    signature: Signature,
    start: Tensor,
    bounds: Tensor,
    names: Collection[str] | None = None,
    group: str = "plant",
) -> None:
    """Refuse limits that exclude where a plant begins: it would leave them with the first period of every try.

    Args:
        signature: Names of the states.
        start: Ends of the range in which they begin, `(2, n_x)`.
        bounds: Their limits, `(2, n_x)`, infinite where there is none.
        names: States that are looked at; all if omitted.
        group: Group of settings in which `start` and `bounds` were given.

    Raises:
        ValueError: A state begins outside of its limits.
    """
    low, high = bounds.to(start)
    outside = ((start < low) | (start > high)).any(0).tolist()
    for name, out, begin, ends in zip(signature.state_names, outside, start.T.tolist(), bounds.T.tolist(), strict=True):
        if out and (names is None or name in names):
            raise ValueError(
                f"{group}.start has {name} at {' to '.join(f'{value:g}' for value in dict.fromkeys(begin))}, and "
                f"{group}.bounds are {ends[0]:g} to {ends[1]:g}; allowed is a start within the bounds: correct either"
            )


def sample_states(ends: Tensor, batch: torch.Size, generator: torch.Generator) -> Tensor:
    """Return states between their ends `(2, n_x)`, `(*batch, n_x)`; nothing is drawn where every range is one value."""
    low, high = ends
    if torch.equal(low, high):
        return low.expand(*batch, -1).clone()
    return low + (high - low) * torch.rand(*batch, len(low), generator=generator)


def _put(signature: Signature, given: Mapping[str, Ends], key: str, ends: Tensor) -> Tensor:
    """Return the ends with those that are given put in."""
    for name, value in given.items():
        pair = [value, value] if isinstance(value, int | float) else list(value)
        if name not in signature.state_names or len(pair) != 2 or not -math.inf < pair[0] <= pair[1] < math.inf:
            hint = "" if name in signature.state_names else did_you_mean(name, signature.state_names)
            raise ValueError(
                f"{key} has {name}: {value}; name one of the states {', '.join(signature.state_names)}, with a "
                f"value or the two ends of a range{hint}"
            )
        ends[:, signature.state_index(name)] = torch.tensor(pair).to(ends)
    return ends
