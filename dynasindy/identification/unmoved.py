"""Columns of a log that are no states of the plant: nothing moves them, and they tell nothing of what is moved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import torch
from torch import Tensor

from dynasindy.identification.forecast_errors import (
    LinearModel,
    characteristic,
    errors_over,
    samples_after,
    start_rows,
)
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

PAST, FEW, ROWS, JUDGED = 8, 3, 4000, 40_000
"""Past samples that a linear model may read, also with products, and rows for its fit and its judgement, at most."""
SLOWEST, FARTHEST, HORIZONS = 3, 1000, 5
"""How far ahead they predict [times in which the slowest state changes], [samples] at most, and over how many times."""
WIDEST = 8
"""States that move of which products are looked at, at most."""
BETTER = 0.95
"""Part of an error to which another one must fall at some time ahead, to be of a model that knows more."""


def unmoved_states(data: Transitions, signature: Signature) -> list[str]:
    """Return states that are foretold best by their own past alone, and that foretell no other one (Granger 1969).

    Those are a temperature of the computer or its free memory, say, beside the states of a plant. Linear models of
    past samples with and without the others are fitted to the first three quarters and compared on the last one, and
    those that know the samples of others, their sines and their products, by which a heading turns a speed.

    Args:
        data: the recording.
        signature: its names.
    """
    cut = 3 * len(data) // 4
    parts = choose_stretches(cut, ROWS), choose_stretches(len(data) - cut, JUDGED)
    none = [torch.zeros_like(each) for each in parts]
    fit, kept = data.select(torch.cat([parts[0], none[1]])), data.select(torch.cat([none[0], parts[1]]))
    reach = start_rows(kept, PAST)[1]
    last = min(reach // 5, max(round(SLOWEST * characteristic(fit, signature) / data.dt), 2), FARTHEST)
    if data.x.shape[1] < 2 or last < 2:
        return []
    starts, _ = start_rows(kept, PAST, last)
    later, real = samples_after(kept, starts, last)
    steps = sorted({round(k) for k in np.geomspace(1, last, HORIZONS).tolist()})

    def _errors(states: Sequence[int], driven: bool = True, known: Sequence[int] = ()) -> Tensor:
        """Return errors of models of some states, of the best one over each horizon, `(H, n)`."""
        mine, theirs = (_of_states(part, states, driven, known) for part in (fit, kept))
        models = LinearModel.candidates(mine, FEW if known else PAST)
        errors = [errors_over(model.predict(theirs, starts, later), real[..., states], steps) for model in models]
        return torch.stack(errors or [real.new_full((len(steps), len(states)), math.nan)]).amin(0)

    def _no_better(ours: Tensor, theirs: Tensor) -> Tensor:
        return (theirs.isfinite() & (ours >= BETTER * theirs)).all(0)

    states = list(range(data.x.shape[1]))
    alone, together = torch.cat([_errors([i], driven=False) for i in states], 1), _errors(states)
    unmoved = [i for i in states if _no_better(together, alone)[i] and _no_better(_errors([i])[:, 0], alone[:, i])]
    moved = [i for i in states if i not in unmoved]
    if not unmoved or not 0 < len(moved) <= WIDEST or not bool(_no_better(together[:, moved], _errors(moved)).all()):
        return []
    known = {j: _errors([j], known=[k for k in moved if k != j]) for j in states}
    acts = set[int]()
    for i, j in product(unmoved, moved):
        error = _errors([j], known=[k for k in (*moved, i) if k != j])
        if not (error / known[j].minimum(together[:, [j]])).median() >= BETTER:  # far ahead one alone may be by chance
            acts.add(i)
    free = [i for i in unmoved if i not in acts and _no_better(known[i][:, 0], alone[:, i])]
    return [signature.state_names[i] for i in free]


def _of_states(data: Transitions, states: Sequence[int], driven: bool, known: Sequence[int]) -> Transitions:
    """Return a recording of some states, driven by nothing, the inputs, or also others that are known and products."""
    u = data.u if driven else torch.zeros_like(data.u)
    mine = replace(data, x=data.x[:, states], x_next=data.x_next[:, states], u=u, u_end=data.u_end if driven else None)
    if not known:
        return mine
    x = data.x[:, known].double()
    terms = torch.cat([x, x.sin(), x.cos(), u], 1)
    low, high = torch.triu_indices(terms.shape[1], terms.shape[1])
    return replace(mine, u=torch.cat([terms, terms[:, low] * terms[:, high]], 1), u_end=None)
