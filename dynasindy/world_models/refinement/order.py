"""Whether a state of a recording moves on by itself, as an angle does whose rate is no state of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.libraries import polynomial
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.refinement.measured import best_length, filled, has_gaps, local_cubic

CLEAR = 20.0
"""Movement over a step that is looked at [deviation of what no local cubic follows]."""
UNEXPLAINED = 0.1
"""Part of the movement that states and inputs have to leave unexplained."""
EXPLAINED = 0.9
"""Part of that which the movement just before has to explain."""
ROWS = 5000
"""Rows that are looked at."""
ALIKE = 0.01
"""Part of the movement of a state that another one may leave over which is its rate."""
WINDOW = 10
"""Samples over which the rate of another state is told by its integral, which noise leaves as it is."""
CUBIC = 8
"""States and inputs up to which cubic functions of them are looked at; of more, quadratic ones."""


def moving_on(library: Library, data: Transitions) -> list[str]:
    """Return the states that go on as they went before, whatever states and inputs say: a rate of theirs is missing.

    Where all states are there, what happens next follows from them and from the inputs. A state that is the rate of
    another one is taken to have none of its own. The movement over a step is
    regressed on the candidate functions, on polynomials, which stand for functions that the library lacks, and on the
    inputs of the step before; then also on the movement over the step before.

    Args:
        library: candidate functions.
        data: the recording; one with a state that was never measured is not judged, and none by a difference equation,
            as what it lacks is no rate. Rows that lack a sample are left out.
    """
    if library.step is not None or len(data) < WINDOW or bool(data.x.isnan().all(0).any()):
        return []
    data, signature = data.to(torch.float64), library.signature
    smooth = polynomial(signature, 3 if signature.n_x + signature.n_u <= CUBIC else 2)
    library = Library(signature, [*library.features, *smooth.features])
    rates = _rates(data)
    return [name for i, name in enumerate(signature.state_names) if i not in rates and _moves_on(library, data, i)]


def _rates(data: Transitions) -> set[int]:
    """Return the states that are rates of others: their integrals by the trapezoidal rule are what others move by."""
    data = _bridged(data)
    rows = torch.arange(len(data) - WINDOW + 1)
    last = rows + WINDOW - 1
    rows, last = (k[data.segment[rows] == data.segment[last]] for k in (rows, last))
    moved = data.x_next[last] - data.x[rows]
    sums = torch.cat([torch.zeros_like(data.x[:1]), (0.5 * data.dt * (data.x + data.x_next)).cumsum(0)])
    left = (moved.unsqueeze(-1) - (sums[last + 1] - sums[rows]).unsqueeze(-2)).square().sum(0)  # (state, rate)
    return set((left < ALIKE * moved.square().sum(0).unsqueeze(-1)).nonzero()[:, 1].tolist())


def _bridged(data: Transitions) -> Transitions:
    """Return a recording with straight lines over lost samples, zero where a segment has none of a state."""
    if not bool(has_gaps(data)):
        return data
    x, x_next = torch.zeros_like(data.x), torch.zeros_like(data.x)
    for segment in data.segment.unique_consecutive().tolist():
        rows = (data.segment == segment).nonzero().flatten()
        for i, column in enumerate(torch.cat([data.x[rows[:1]], data.x_next[rows]]).unbind(-1)):
            if (whole := filled(column.numpy())) is not None:
                x[rows, i], x_next[rows, i] = torch.from_numpy(whole[:-1]), torch.from_numpy(whole[1:])
    return replace(data, x=x, x_next=x_next)


def _moves_on(library: Library, data: Transitions, i: int) -> bool:
    found = _steps(data, i)
    if found is None:
        return False
    rows, length = found
    now, past = rows, rows - length
    moved = data.x[now + length, i] - data.x[now, i]
    before = (data.x[now, i] - data.x[past, i]).unsqueeze(-1)
    sums = torch.cat([torch.zeros_like(data.u[:1]), data.u.cumsum(0)])
    u, u_past = ((sums[k + length] - sums[k]) / length for k in (now, past))
    columns = torch.cat([library(data.x[now], u), u_past], -1)
    columns = columns[:, columns.isfinite().all(0)]
    total, everything = float((moved - moved.mean()).square().sum()), torch.cat([columns, before], -1)
    scale = everything.norm(dim=0).clamp_min(1e-300)
    triangle = torch.linalg.qr(torch.cat([everything / scale, moved.unsqueeze(-1)], -1), mode="r")[1]
    alone, _ = _left(triangle[:, : columns.shape[1]], triangle[:, -1:])
    if not alone > UNEXPLAINED * total:
        return False
    left, weight = _left(triangle[:, :-1], triangle[:, -1:])
    return left < (1 - EXPLAINED) * alone and weight > 0


def _steps(data: Transitions, i: int) -> tuple[Tensor, int] | None:
    """Return rows with a step before and after them in their segment, and its length in samples; None if too few.

    All states are there at a row, and the one that is looked at at both ends of the steps, too.
    """
    labels, counts = data.segment.unique_consecutive(return_counts=True)
    samples = data.x[data.segment == labels[int(counts.argmax())], i].numpy()
    longest, there = filled(samples), np.flatnonzero(~np.isnan(samples))
    if longest is None or len(there) < 8:
        return None
    complete, seen = ~data.x.isnan().any(-1), ~data.x[:, i].isnan()
    noise = float(torch.from_numpy(longest - local_cubic(longest, best_length(longest), 1.0, 0)).square().mean().sqrt())
    length = max(1, round(float(np.median(np.diff(there)))))  # of a sensor that is read every fifth row, five
    while 8 * length < len(longest):
        rows = torch.arange(length, len(data) - length)
        rows = rows[data.segment[rows - length] == data.segment[rows + length]]
        rows = rows[complete[rows] & seen[rows - length] & seen[rows + length]]
        if not len(rows):
            return None
        rows = rows[:: max(1, len(rows) // ROWS)]
        if float((data.x[rows + length, i] - data.x[rows, i]).square().mean().sqrt()) > CLEAR * noise:
            return rows, length
        length *= 2
    return None


def _left(columns: Tensor, target: Tensor) -> tuple[float, float]:
    """Return the squares that least squares leave over, and the weight of the last column."""
    solution = torch.linalg.lstsq(columns, target, driver="gelsd").solution
    return float((target - columns @ solution).square().sum()), float(solution[-1, 0])
