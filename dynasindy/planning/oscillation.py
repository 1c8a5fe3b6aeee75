"""The oscillations of a model near a place, and how fast it leaves that place, by its linearisation there.

| name        | symbol | equation                                                                             |
| ----------- | ------ | ------------------------------------------------------------------------------------ |
| mode        | s, v, w | A v = s v, w' A = s w', states in their ranges, v and w of length 1                 |
| damping     | z      | -Re(s) / abs(s)                                                                      |
| oscillation | T      | 2 pi / abs(Im(s)) [s]                                                                |
| moved       |        | by an input whose b has abs(w' b) > SHARE abs(s) abs(w' v): it bends the mode by so much |
| seen        |        | in an output whose part of v is larger than SHARE                                    |
| doubling    |        | log(2) / Re(s) [s], of a mode that grows                                             |
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from scipy.linalg import eig
from torch import Tensor

from dynasindy.planning.linear_model import told_by_time
from dynasindy.planning.rests import slopes
from dynasindy.systems import System

LIGHT = 0.5
"""Damping ratio below which a mode swings on; at 0.5 each swing is a sixth of the one before."""
SHARE = 1e-3
"""Part of the ranges of the states by which a mode has to be moved by an input, or seen in an output, to count."""


def fastest_oscillation(system: System, x: Tensor, u: Tensor, outputs: Sequence[int]) -> float:
    """Return the shortest period of the lightly damped oscillations of a model [s]; inf where it has none.

    An oscillation that no input moves and that no output shows does not count.

    Args:
        system: Vector field.
        x: Where it is linearised, `(n_x,)`.
        u: Inputs there, `(n_u,)`.
        outputs: Places of the tracked states.
    """
    rates, counts = _modes(system, x, u, outputs)
    counts = counts & (rates.imag > 0) & (rates.real.abs() < LIGHT * rates.abs())
    return 2 * math.pi / float(rates.imag[counts].max()) if bool(counts.any()) else math.inf


def fastest_doubling(system: System, x: Tensor, u: Tensor, outputs: Sequence[int]) -> float:
    """Return the shortest time in which a deviation doubles that nothing controls [s]; inf where none grows.

    What no input moves and no output shows does not count.

    Args:
        system: Vector field.
        x: Where it is linearised, `(n_x,)`.
        u: Inputs there, `(n_u,)`.
        outputs: Places of the tracked states.
    """
    rates, counts = _modes(system, x, u, outputs)
    grows = rates.real[counts & (rates.real > 0)]
    return math.log(2) / float(grows.max()) if len(grows) else math.inf


def _modes(system: System, x: Tensor, u: Tensor, outputs: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return the rates of the modes [1/s] and which of them are moved or seen; none of a slope that is not finite."""
    a, b = (found[0] for found in slopes(system, x.double().unsqueeze(0), u.double().unsqueeze(0)))
    if not bool(a.isfinite().all() & b.isfinite().all()):
        return torch.zeros(0, dtype=torch.complex128), torch.zeros(0, dtype=torch.bool)
    scale = torch.tensor(system.signature.x_scale, dtype=torch.float64)
    rates, left, right = map(torch.as_tensor, eig((a * scale / scale.unsqueeze(-1)).numpy(), left=True))
    reach = (left.mH @ (b / scale.unsqueeze(-1)).to(left)).abs().amax(-1)
    moved = reach > SHARE * rates.abs() * (left.conj() * right).sum(0).abs()
    seen = right[list(outputs)].abs().amax(0) > SHARE
    return rates if system.step is None else told_by_time(rates, system.step), moved | seen
