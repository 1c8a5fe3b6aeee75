"""What recordings show of their sensors: steps, noise, and whether a log is too quiet to tell of a state."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dynasindy.findings import Finding, weak
from dynasindy.sindy import SindyModel
from dynasindy.sindy.delay import delay_and_trim
from dynasindy.sindy.reconstruction import interpolate_gaps
from dynasindy.sindy.regression import least_squares
from dynasindy.systems.base import WHOLE, Signature
from dynasindy.systems.smoothing import best_length, local_cubic, stretches_of
from dynasindy.systems.transitions import Transitions

Array = NDArray[np.float64]
SEVERAL = 10
"""Values of a state that are few enough to be the steps of its sensor."""
AGAIN = 5
"""Times that half of such values have to be read for them to be steps: samples of a smooth movement seldom repeat."""
ORDERS = (1, 2, 4, 8)
"""Past samples by which the next one is explained, to tell what of it is noise."""
MOST_COLUMNS = 300
"""Products of past samples up to which these explain the next one, too."""
ROWS_EACH, MOST_ROWS = 5, 5000
"""Rows per column below which what a regression leaves over tells nothing, and rows, about, that are looked at."""
FEW = 10.0
"""Steps of its sensor that a state has to move by, for its log to tell anything."""
WANTED = 100.0
"""Steps that a state should move by in a log."""
TINY = 1e-9
"""Movement of an input that is none."""
FEWEST, MOVING = 40, 0.1
"""Samples of a recording that may repeat itself, at least, and part of a column's variance in its last quarter."""
DIFFERENT, APART = 0.002, 20.0
"""Mean square of differences from what was before, of the variance, at which it is the same, and multiple of that by
which it differs in between."""


def samples_of(data: Transitions) -> list[Array]:
    """Return the samples of each state in its longest unbroken stretch."""
    return _all_samples_of(data.longest_stretch())


def _all_samples_of(data: Transitions) -> list[Array]:
    """Return the samples of each state in all unbroken stretches, one after the other."""
    begins = data.begins()
    taken = torch.stack([begins, torch.ones_like(begins)], -1)
    samples = torch.stack([data.x, data.x_next], 1)[taken].double()
    return [column.numpy() for column in samples.unbind(-1)]


def repetition(data: Transitions) -> float | None:
    """Return how long before the last quarter of a recording was the same, but for noise of the sensors [s], if it was.

    What is kept of it to judge a model on is then no test of that.
    """
    whole = data.longest_stretch()
    measured = ~whole.x.isnan().any(0)
    columns = torch.cat([whole.u, whole.x[:, measured]], -1).double()
    errors = torch.cat([torch.zeros(whole.u.shape[1]), sensor_errors(whole)[measured]]).double()
    count, start = len(columns), 3 * len(columns) // 4
    last = columns[start:]
    moving = last.var(0) > MOVING * columns.var(0) if count >= FEWEST else torch.zeros(0, dtype=torch.bool)
    if not bool(moving.any()):
        return None
    mean, allowed = last[:, moving].mean(0), DIFFERENT * last[:, moving].var(0) + 2 * errors[moving].square()
    moved: Array = (columns[:, moving] - mean).numpy()
    spectra = np.fft.rfft(moved, 2 * count, axis=0), np.fft.rfft(moved[start:], 2 * count, axis=0)
    product = np.fft.irfft(spectra[0] * spectra[1].conj(), axis=0)[: start + 1]
    energy = np.concatenate([np.zeros((1, moved.shape[1])), (moved**2).cumsum(0)])
    begins, length = np.arange(start + 1), count - start
    apart = (energy[begins + length] - energy[begins] + energy[count] - energy[start] - 2 * product) / length
    share = (apart / allowed.numpy()).max(1)[::-1]  # by how long before
    again = np.flatnonzero((share <= 1) & (np.maximum.accumulate(share) > APART))
    if not len(again):
        return None
    first = again[again == again[0] + np.arange(len(again))]
    return int(first[share[first].argmin()]) * data.dt


def resolutions(data: Transitions, model: SindyModel | None = None) -> Tensor:
    """Return what each sensor can tell, `(n_x,)`, NaN of a state that was not measured.

    That is its step, where it reads in steps, and else its noise: what no local cubic follows, or, if that is less,
    what no past samples explain. Between samples that are far apart a movement turns in ways that no cubic follows.
    What jumps from sample to sample is left over by a difference equation at most.

    Args:
        data: the recording.
        model: a model that was fitted to it.
    """
    found = torch.tensor([step or noise for step, noise in _steps_and_noise(data)])
    if model is None or model.step is None:
        return found
    late = delay_and_trim(data, model.delay)
    with torch.no_grad():
        left = model.predict(late.x, late.u, late.dt) - late.x_next
    return found.fmin(left.square().nanmean(0).sqrt())


def sensor_errors(data: Transitions) -> Tensor:
    """Return the root-mean-square error of each sensor, `(n_x,)`: its step / sqrt(12), or its noise where none is seen.

    It is in the unit of each state, NaN of one that was not measured.

    Args:
        data: the recording.
    """
    return torch.tensor([step / math.sqrt(12) or noise for step, noise in _steps_and_noise(data)])


def _steps_and_noise(data: Transitions) -> Iterator[tuple[float, float]]:
    """Yield the step of each sensor, 0 where none is seen, and its noise, both NaN of a state that was not measured."""
    whole = ~(data.x.isnan().any(0) | data.x_next.isnan().any(0))
    unforeseen = torch.full((len(whole),), math.nan, dtype=torch.float64)
    each = (torch.arange(len(whole)) == i for i in (~whole).nonzero().flatten().tolist())
    for mine in (*([whole] if bool(whole.any()) else []), *each):
        unforeseen[mine] = _left_by_past(data, torch.cat([data.x[:, mine | whole], data.u], -1).double(), mine)
    for column, left in zip(samples_of(data), unforeseen.tolist(), strict=True):
        noise = float(np.fmin(_noise(column), left))
        yield sensor_resolution(column, noise), noise


def _left_by_past(data: Transitions, both: Tensor, states: Tensor) -> Tensor:
    """Return the least that regressions on some past signals, `(N, n)`, leave over of the next samples of states."""
    target = data.x_next[:, states].double()
    least = torch.full((target.shape[1],), math.nan, dtype=torch.float64)
    both = (both - both.nanmean(0)) / (both - both.nanmean(0)).square().nanmean(0).sqrt().clamp_min(1e-300)
    place, lost = torch.arange(len(data)), both.isnan().any(-1)
    last = torch.where(lost, place, torch.where(data.begins(), place - 1, -1)).cummax(0).values  # row that is none
    for order in ORDERS:
        rows = ((place - last >= order) & ~target.isnan().any(-1)).nonzero().flatten()
        rows = rows[:: len(rows) // MOST_ROWS + 1]
        past = both[rows.unsqueeze(-1) - torch.arange(order)].flatten(1)
        columns = torch.cat([torch.ones_like(past[:, :1]), past], -1)
        pairs = torch.triu_indices(columns.shape[1], columns.shape[1])
        for trial in (columns, columns[:, pairs[0]] * columns[:, pairs[1]]):
            n, p = trial.shape
            if n < ROWS_EACH * p or p > MOST_COLUMNS:
                continue
            left = target[rows] - trial @ least_squares(trial, target[rows])
            least = least.fmin((left.square().sum(0) / (n - p)).sqrt())
    return least


def resolution(column: Array) -> float:
    """Return what a sensor can tell: its step where it reads in steps, else the standard deviation of its noise.

    Args:
        column: samples, `(n,)`; NaN if there are none.
    """
    return sensor_resolution(column) or _noise(column)


def sensor_resolution(column: Array, noise: float | None = None) -> float:
    """Return the step in which a sensor reads, 0 where none is seen.

    Args:
        column: samples, `(n,)`; lost ones are NaN.
        noise: its standard deviation, above which a step has to be; what no local cubic follows by default.
    """
    known = np.concatenate(stretches_of(column))
    known = known[~np.isnan(known)]
    moves = np.abs(np.diff(known)) if len(known) else known
    moves = moves[moves > 1e-9 * np.ptp(known)] if len(moves) else moves
    if len(moves) < 10:
        return 0.0
    step = float(moves.min())
    whole = np.abs(moves / step - np.round(moves / step)) < 0.01 * np.maximum(1, moves / step) ** 0.5
    noise = _noise(column) if noise is None else noise
    return step if whole.mean() > 0.99 and step > 1.5 * noise else 0.0


def _noise(column: Array) -> float:
    known = interpolate_gaps(column)
    if known is None or len(known) < 8:
        return float("nan")
    length = best_length(known)
    return float(np.sqrt(np.mean([np.square(c - local_cubic(c, length, 1.0, 0)).mean() for c in stretches_of(known)])))


def low_signal_states(data: Transitions, but: Collection[int] = ()) -> dict[int, float]:
    """Return the places of states that move by less than `FEW` steps of their sensors, and by how many they move.

    A state that does not move at all is none of them, nor one whose sensor shows no steps.

    Args:
        data: The log.
        but: Places of states that are not asked about: rates made of differences move in steps of their own.
    """
    moved = {}
    for place, column in enumerate(_all_samples_of(data)):
        if place in but:
            continue
        known = np.concatenate(stretches_of(column))
        levels, times = np.unique(known[~np.isnan(known)], return_counts=True)
        few = 1 < len(levels) <= SEVERAL and np.median(times) >= AGAIN  # which `sensor_resolution` sees too seldom
        step = sensor_resolution(column) or (float(np.diff(levels).min()) if few else 0.0)
        if step and (steps := float(np.nanmax(column) - np.nanmin(column)) / step) < FEW:
            moved[place] = steps
    return moved


def low_signal_findings(data: Transitions, signature: Signature, but: Collection[int] = ()) -> list[Finding]:
    """Return which states a log is too quiet to tell of, and how many times as far each input is to go.

    No input is to go farther than its actuator; of one that does not move no number is told.

    Args:
        data: The log.
        signature: Names, units and ends.
        but: Places of states that are not asked about.
    """
    if not (moved := low_signal_states(data, but)):
        return []
    steps, wanted = {signature.state_names[i]: round(count) for i, count in moved.items()}, WANTED / min(moved.values())
    limits = torch.tensor(signature.input_limits or (WHOLE,) * signature.n_u, dtype=torch.float64)
    went = (data.u.amax(0) - data.u.amin(0)).double()
    room = zip(signature.input_names, went.tolist(), (limits.diff(dim=1).flatten() / went).tolist(), strict=True)
    inputs = {name: min(times, wanted) if far > TINY else None for name, far, times in room}
    return [weak("log.low_signal", steps=steps, wanted=round(WANTED), inputs=inputs)]
