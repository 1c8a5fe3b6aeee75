"""A linear model with states that no sensor sees, by a subspace method that suits closed loops, too.

The predictor of the outputs from past samples (a long ARX model) is a product of what the states show and of what tells
them; its singular vectors give the states, which least squares turn into the matrices (Chiuso 2007, PBSID). These are
of samples, and become those of rates of change where no pole lies where no differential equation has one.

| name     | meaning                                      | shape                |
| -------- | -------------------------------------------- | -------------------- |
| z        | outputs and inputs, scaled                   | `(N, n_y + n_u)`     |
| past     | z of the samples before, the newest first    | `(N, p (n_y + n_u))` |
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
import torch
from numpy.typing import NDArray

from dynasindy.sindy.lag_states import HIDDEN
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

Array = NDArray[np.float64]
ROWS = 20_000
"""Rows of a long recording that tell the matrices as well as all of them."""


def subspace_models(given: SindyModel, data: Transitions, orders: Sequence[int], past: int) -> dict[int, SindyModel]:
    """Return linear models of some orders; those that the recording does not tell, or that no rates give, are left out.

    Args:
        given: model of the same states and inputs, all measured.
        data: the recording.
        orders: numbers of states, more than are measured.
        past: samples that tell the states.
    """
    data = data.to(torch.float64).select(choose_stretches(len(data), ROWS))
    y, u = data.x.numpy(), data.u.numpy()
    centre, scale = np.nanmean(np.hstack([y, u]), 0), np.maximum(np.nanstd(np.hstack([y, u]), 0), 1e-300)
    z, n_y = (np.hstack([y, u]) - centre) / scale, y.shape[1]
    rows = np.arange(past, len(z) - 1)
    same = data.segment.numpy()
    rows = rows[same[rows - past] == same[rows + 1]]
    before = np.hstack([z[rows - k] for k in range(1, past + 1)])
    after = np.hstack([z[rows + 1 - k] for k in range(1, past + 1)])
    one = np.ones((len(rows), 1))
    sound = np.isfinite(np.hstack([before, after])).all(1)
    before, after, one, rows = before[sound], after[sound], one[sound], rows[sound]
    if len(rows) < 2 * before.shape[1] + 2:
        return {}
    markov = np.linalg.lstsq(np.hstack([before, one]), z[rows, :n_y], rcond=1e-10)[0][:-1]
    n_z = z.shape[1]
    # What comes f samples later of what was measured i samples ago has the weight of i + f samples.
    shown = np.hstack([np.vstack([markov[f * n_z :], np.zeros((f * n_z, n_y))]) for f in range(past)])
    size, vectors = np.linalg.svd(np.linalg.qr(before, mode="r") @ shown, full_matrices=False)[1:]
    found = {}
    for order in orders:
        if order > (size > 1e-9 * size[0]).sum():
            break
        tell = shown @ vectors[:order].T / (size[:order] / np.sqrt(len(rows)))
        x, x_next, here = before @ tell, after @ tell, z[rows]
        c, offset = np.split(np.linalg.lstsq(np.hstack([x, one]), here[:, :n_y], rcond=None)[0].T, [order], 1)
        left = here[:, :n_y] - x @ c.T - offset.T
        step = np.linalg.lstsq(np.hstack([x, here[:, n_y:], one, left]), x_next, rcond=None)[0].T
        model = _of_matrices(
            given, step[:, :order], step[:, order : order + n_z - n_y + 1], c, offset, centre, scale, data.dt
        )
        if model is not None:
            found[order] = model
    return found


def _of_matrices(
    given: SindyModel, a: Array, b: Array, c: Array, offset: Array, centre: Array, scale: Array, dt: float
) -> SindyModel | None:
    """Return a model whose first states are the outputs; of the others each has a deviation of one."""
    n, m, n_y = len(a), b.shape[1], len(c)
    poles = np.linalg.eigvals(a)
    if (np.abs(poles) < 1e-3).any() or ((poles.real < 0) & (np.abs(poles.imag) < 1e-9)).any():
        return None
    rates = scipy.linalg.logm(np.block([[a, b], [np.zeros((m, n)), np.eye(m)]])).real[:n] / dt
    # From states s to outputs y and others h: [y; h] = T s + t, in the units of the recording.
    others = scipy.linalg.null_space(c).T
    turn = np.vstack([scale[:n_y, None] * c, others])
    moved = np.concatenate([scale[:n_y] * offset[:, 0] + centre[:n_y], np.zeros(len(others))])
    if len(turn) != n or np.linalg.cond(turn / np.linalg.norm(turn, axis=1, keepdims=True)) > 1e6:
        return None
    a_rates = turn @ rates[:, :n] @ np.linalg.inv(turn)
    b_rates = turn @ rates[:, n:-1] / scale[n_y:]
    constant = turn @ rates[:, -1] - a_rates @ moved - b_rates @ centre[n_y:]
    signature: Signature = given.signature
    for k in range(n - n_y):
        signature = signature.with_state(HIDDEN.format(k + 1), "1", 3.0)
    names = (*signature.state_names, *signature.input_names)
    model = SindyModel(
        signature,
        Library(signature, [CONSTANT, *map(variable, names)]),
        given.regression,
        given.refinement,
        machine_code=given.machine_code,
    )
    model.initial = torch.from_numpy(np.hstack([constant[:, None], a_rates, b_rates]).T.copy())
    model.set_coefficients(model.initial)
    return model if bool(model.initial.isfinite().all()) else None
