"""How well a model predicts: one step ahead and open loop."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions


def one_step_error(model: System, data: Transitions, substeps: int = 1) -> Tensor:
    """Return the root-mean-square one-step error of each state, relative to its standard deviation, `(n_x,)`."""
    with torch.no_grad():
        x = moved(model, data.x, data.u, data.dt, substeps)
    return (x - data.x_next).square().mean(0).sqrt() / data.x_next.std(0).clamp_min(1e-300)


def open_loop(model: System, data: Transitions, substeps: int = 1) -> Tensor:
    """Predict each segment from its first state with the logged inputs.

    Args:
        model: vector field.
        data: transitions, N rows.
        substeps: Runge-Kutta steps between two samples.

    Returns:
        States in the place of `data.x_next`, `(N, n_x)`; what runs away is not finite or very large.
    """
    predicted = torch.empty_like(data.x_next)
    fresh = data.begins()
    with torch.no_grad():
        for k in range(len(data)):
            x = data.x[k] if fresh[k] else predicted[k - 1]
            predicted[k] = moved(model, x, data.u[k], data.dt, substeps)
    return predicted


def nrmse(predicted: Tensor, data: Transitions) -> Tensor:
    """Return the root-mean-square error of each state relative to its standard deviation, `(n_x,)`.

    Samples that were lost do not count; the error of a state that was never measured is infinite.
    """
    squares = (predicted - data.x_next).square().nan_to_num(torch.inf, torch.inf)
    error = torch.where(data.x_next.isnan(), torch.nan, squares).nanmean(0)
    return (error.sqrt() / variance(data.x_next).sqrt().clamp_min(1e-300)).nan_to_num(torch.inf, torch.inf)


def variance(x: Tensor) -> Tensor:
    """Return the variance of each column of `(N, n)` over samples that are not NaN, `(n,)`; NaN of fewer than two."""
    return (x - x.nanmean(0)).square().nansum(0) / ((~x.isnan()).sum(0) - 1)


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
