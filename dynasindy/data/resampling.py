"""Samples at uneven times, taken to even ones: what a held input did to the states stays what it did.

A digital controller that is late now and then sets its input late, too. So the input jumps between two even times, and
with it the slopes of the states. Each of the two costs little to respect, and much if it is not: a spline over such a
jump swings, and the value of an input at the beginning of an even step is not what acted during that step.

| of       | taken is                                                                                        |
| -------- | ----------------------------------------------------------------------------------------------- |
| a state  | a cubic spline over the samples between two jumps of an input; straight lines between single ones |
| an input | its mean over the step, held from each sample to the next: to first order in the step the same    |
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynasindy.findings import Finding, LogError, note

Array = NDArray[np.float64]
GAP = 1.5
"""Sampling times from which on what lies between two samples is lost."""
EVEN = 0.02
"""Part of a sampling time by which samples may be early or late and are taken as they are."""
FEWEST = 4
"""Samples in a stretch from which on it is resampled."""
JUMP = 0.05
"""Part of its range by which an input changes from sample to sample where it jumps; one that moves less is smooth."""


def resample(
    t: Array, x: dict[str, Array], u: Array, dt: float, findings: list[Finding]
) -> tuple[Array, dict[str, Array], Array, NDArray[np.int64]]:
    """Return times, states, inputs and segments of samples at even times; segments break at gaps.

    Args:
        t: Times of the samples [s], increasing, `(N,)`.
        x: States by name, `(N,)` each, NaN where one was not measured; so are even times next to such a sample.
        u: Inputs, held from each sample to the next, `(N, n_u)`.
        dt: Sampling time [s].
        findings: What was decided; what is done here is added.

    Raises:
        ValueError: No stretch without a gap has enough samples.
    """
    breaks = np.diff(t) > GAP * dt
    if breaks.any():
        findings.append(note("log.gaps", count=int(breaks.sum())))
    segment = np.concatenate([[0], np.cumsum(breaks)])
    uneven = np.abs(np.diff(t)[~breaks] - dt) > EVEN * dt
    if not uneven.any():
        return t, x, u, segment
    findings.append(note("log.resampled", count=int(uneven.sum()), total=len(t) - 1, dt=dt))
    states, wide = np.stack(list(x.values()), -1), np.ptp(u, axis=0)
    parts = []
    for label, rows in enumerate(np.split(np.arange(len(t)), np.flatnonzero(breaks) + 1)):
        if len(t[rows]) < FEWEST:
            continue
        grid = np.arange(t[rows][0], t[rows][-1] + 1e-9 * dt, dt)
        # The mean of held inputs over each even step, that of the last one up to the last sample.
        at, held = t[rows], u[rows]
        moved = np.concatenate([np.zeros((1, u.shape[1])), np.cumsum(held[:-1] * np.diff(at)[:, None], 0)])
        ends = np.minimum(np.append(grid, grid[-1] + dt), at[-1])
        sums, widths = np.stack([np.interp(ends, at, column) for column in moved.T], -1), np.diff(ends)[:, None]
        held = held[np.searchsorted(at, grid + 1e-6 * dt, side="right") - 1]
        means = np.where(widths > 1e-6 * dt, np.diff(sums, axis=0) / np.maximum(widths, 1e-6 * dt), held)
        jumps = (np.abs(np.diff(u[rows], axis=0)) > JUMP * wide).any(-1)
        parts.append((grid, _between_jumps(t[rows], states[rows], jumps, grid), means, np.full(len(grid), label)))
    if not parts:
        raise LogError("log.uneven", dt=dt)
    times, found, inputs, labels = (np.concatenate(column) for column in zip(*parts, strict=True))
    return times, {name: found[:, k] for k, name in enumerate(x)}, inputs, labels


def _between_jumps(t: Array, x: Array, jumps: NDArray[np.bool_], grid: Array) -> Array:
    """Return states at even times, `(n, n_x)`; `jumps` says at which samples but the first an input jumps."""
    from scipy.interpolate import CubicSpline  # half a second of imports that most logs do without

    lost = ~np.isfinite(x)
    if lost.any():
        return np.stack([_measured_between(t, column, jumps, grid) for column in x.T], -1)
    found = np.stack([np.interp(grid, t, column) for column in x.T], -1)
    edges = [0, *(np.flatnonzero(jumps) + 1).tolist(), len(t) - 1]
    for start, end in pairwise(edges):
        if end - start > 1:  # of two samples alone the line is all that is known
            here = slice(*np.searchsorted(grid, (t[start], t[end] * (1 + 1e-12))))
            found[here] = CubicSpline(t[start : end + 1], x[start : end + 1])(grid[here])
    return found


def _measured_between(t: Array, column: Array, jumps: NDArray[np.bool_], grid: Array) -> Array:
    """Return one state with lost samples at even times, `(n,)`; NaN where no sample is within half a step."""
    measured = np.isfinite(column)
    if measured.sum() < FEWEST:
        return np.full(len(grid), np.nan)
    steps = np.concatenate([[0], np.cumsum(jumps)])  # jumps until each sample
    t = t[measured]
    values = _between_jumps(t, column[measured, None], np.diff(steps[measured]) > 0, grid)[:, 0]
    off = np.abs(t[np.searchsorted(0.5 * (t[1:] + t[:-1]), grid)] - grid)
    return np.where(off > 0.5001 * np.ptp(grid) / max(len(grid) - 1, 1), np.nan, values)
