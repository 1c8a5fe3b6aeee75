"""Samples that a log lacks: for a moment the fit bridges them, over longer stretches their rows are left out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HOLE = 10
"""Usual distances between two samples of a state from which on what lies between them is no moment."""
RATED = 5
"""Samples under a local cubic, of those that it would have, from which on it gives a rate."""


def holes(x: Mapping[str, Array], segment: NDArray[np.int64], notes: list[str]) -> NDArray[np.bool_]:
    """Tell which rows lie in a long stretch without a state, or where a recording has not begun or is over.

    A sensor that is read every fifth row has no such stretches: what is long depends on how often it is read.

    Args:
        x: Samples by name, NaN where one is lost, `(N,)` each.
        segment: Number of the segment of each row, `(N,)`.
        notes: Sentences on what was read; those on what is left out are added.

    Returns:
        Rows to leave out, `(N,)`.
    """
    out = np.zeros(len(segment), dtype=bool)
    for name, column in x.items():
        seen = np.flatnonzero(np.isfinite(column))
        if len(seen) in (len(column), 0, 1):
            continue
        longest = HOLE * np.median(np.diff(seen))
        ends = np.concatenate([[-1], seen, [len(column)]])
        long = np.flatnonzero(np.diff(ends) > longest)
        for first, last in zip(ends[long], ends[long + 1], strict=True):
            out[first + 1 : last] = True
        if len(long):
            rows = int((ends[long + 1] - ends[long] - 1).sum())
            notes.append(f"{rows} rows in stretches of more than {longest:g} rows without {name} were left out")
    measured = np.zeros(len(segment), dtype=bool)
    for column in x.values():
        measured |= np.isfinite(column)
    return out | _outside(measured, segment)


def _outside(seen: NDArray[np.bool_], segment: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which rows come before the first measured one of their segment, or after the last one, `(N,)`."""
    labels = np.cumsum(np.concatenate([[False], np.diff(segment) != 0]))
    rows = np.arange(len(seen))
    first, last = np.full(labels[-1] + 1, len(seen)), np.full(labels[-1] + 1, -1)
    np.minimum.at(first, labels[seen], rows[seen])
    np.maximum.at(last, labels[seen], rows[seen])
    return (rows < first[labels]) | (rows > last[labels])


def rates_beside(column: Array, length: int, dt: float) -> Array:
    """Return slopes of local cubics over `length` samples, `(n,)`, NaN where too few of these were measured.

    Args:
        column: Samples, NaN where one is lost, `(n,)`, n at least `length`.
        length: Samples under a cubic, an odd number.
        dt: Time between two samples.
    """
    n = len(column)
    first = np.clip(np.arange(n) - length // 2, 0, n - length)
    windows = column[first[:, None] + np.arange(length)]
    seen, here = np.isfinite(windows), (np.arange(n) - first - length // 2).astype(float)
    powers = np.arange(-(length // 2), length // 2 + 1.0)[:, None] ** np.arange(4)
    weighed = seen[..., None] * powers
    normal, right = weighed.mT @ powers, (weighed * np.nan_to_num(windows)[..., None]).sum(1)
    enough = seen.sum(1) >= RATED
    cubic = np.linalg.solve(normal[enough], right[enough][..., None])[..., 0]
    rates = np.full(n, np.nan)
    at = here[enough]
    rates[enough] = (cubic[:, 1] + 2 * cubic[:, 2] * at + 3 * cubic[:, 3] * at**2) / dt
    return rates
