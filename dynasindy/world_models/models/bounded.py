"""Whether a model stays near what was seen under inputs that are held: one that runs away explains a log alone.

Within a log inputs change before a wrong balance shows. A tank whose outflow does not lessen with its level, or a drain
that goes on when nothing is left, fits it, and empties without end as soon as an input is held a little longer.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions

LEVELS = 7
"""Inputs that are held, from the least to the largest of the recording, one after the other."""
DURATION = 4
"""How long they are held, in lengths of the recording."""
BEYOND = 1.0
"""How far beyond its range in the recording a measured state may go, in parts of the range."""


def stays_near(model: System, data: Transitions, start: Tensor, substeps: int = 1) -> bool:
    """Tell whether all measured states stay near their range in a recording under inputs that occur there, held.

    This is asked of plants that settle: the position of a cart runs away under any push.

    Args:
        model: the vector field.
        data: the recording, NaN where a state was not measured.
        start: state to begin with, `(n_x,)`.
        substeps: Runge-Kutta steps in an interval.
    """
    seen = torch.cat([data.x[:1], data.x_next])
    low, high = seen.nan_to_num(torch.inf).amin(0), seen.nan_to_num(-torch.inf).amax(0)
    reach, measured = BEYOND * (high - low), low <= high
    shares = torch.linspace(0, 1, LEVELS, dtype=data.u.dtype).unsqueeze(-1)
    least, most = data.u.amin(0), data.u.amax(0)
    x = start.expand(LEVELS, -1)
    with torch.no_grad():
        # One input moves at a time, the others stay at their mean.
        for i in range(data.u.shape[1]):
            u = data.u.mean(0).expand(LEVELS, -1).clone()
            u[:, i] = least[i] + shares[:, 0] * (most[i] - least[i])
            held = x
            for _ in range(DURATION * len(data)):
                held = moved(model, held, u, data.dt, substeps)
            near = (held >= low - reach) & (held <= high + reach)
            if not bool(near[:, measured].all()):
                return False
    return True
