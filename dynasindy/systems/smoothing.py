"""Local cubics: samples are smoothed or differentiated by the best cubic through their neighbours (Savitzky, Golay)."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

LENGTHS = (5, 7, 9, 13, 17, 25, 35, 51, 71, 101)
"""Samples under a local cubic that are tried."""
AS_GOOD = 1.1
"""Factor on the smallest error of prediction up to which the longer cubic is taken: rates want a longer one."""
MANY, STRETCHES = 100_000, 10
"""Samples that tell as much of a sensor as more would, and stretches in which they lie of a longer recording."""

Array = NDArray[np.float64]


def stretches_of(column: Array) -> list[Array]:
    """Return what of a long column tells as much of its sensor as all samples would: stretches that are spread evenly.

    Args:
        column: samples, `(n,)`.
    """
    length = MANY // STRETCHES
    if len(column) <= MANY:
        return [column]
    return [column[k : k + length] for k in np.linspace(0, len(column) - length, STRETCHES).astype(int)]


def best_length(column: Array) -> int:
    """Choose how many samples lie under a local cubic: as many as predict the samples left out hardly worse.

    Args:
        column: samples, `(n,)`.
    """
    errors, parts = {}, stretches_of(column)
    for length in LENGTHS:
        if length > len(column):
            break
        own = _cubic(length, 0)[length // 2, length // 2]  # weight of a sample in its own smoothed value
        errors[length] = float(np.mean([np.square((c - _filtered(c, length, 0)) / (1 - own)).mean() for c in parts]))
    least = min(errors.values(), default=0.0)
    good = (length for length, error in errors.items() if error <= AS_GOOD * least + 1e-300)
    return max(good, default=LENGTHS[0])


def local_cubic(column: Array, length: int, dt: float, derivative: int) -> Array:
    """Smooth or differentiate samples, `(n,)`, by a cubic through `length` neighbours; fewer where there are fewer."""
    length = min(length, len(column) - 1 + len(column) % 2)
    if length < 5:
        return np.gradient(column, dt) if derivative and len(column) > 1 else column * (1 - derivative)
    return _filtered(column, length, derivative) / dt**derivative


def _filtered(column: Array, length: int, derivative: int) -> Array:
    """Return values or slopes a sample of local cubics, `(n,)`; SciPy's filter fits its edges anew each time."""
    half, cubic = length // 2, _cubic(length, derivative)
    middle = np.convolve(column, cubic[half, ::-1], "valid")
    return np.concatenate([cubic[:half] @ column[:length], middle, cubic[half + 1 :] @ column[-length:]])


@cache
def _cubic(length: int, derivative: int) -> Array:
    """Return what turns samples into the cubic that fits them best, or its slope a sample, `(length, length)`."""
    place = np.linspace(-1, 1, length)
    values = np.vander(place, 4, increasing=True)
    slopes = np.array([0, 1, 2, 3]) * np.roll(values, 1, axis=1) * 2 / (length - 1)
    return np.asarray((slopes if derivative else values) @ np.linalg.pinv(values))
