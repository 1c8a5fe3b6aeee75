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
