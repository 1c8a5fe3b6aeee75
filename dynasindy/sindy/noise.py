"""Noise of sensors, told from errors of a model and from random pushes."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.sindy.codegen import generate
from dynasindy.sindy.library import Library
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions

PLAIN = -0.3
"""Correlation of neighbouring errors of single steps below which a state is noisy: -1/2 of noise of the sensors alone,
0 of random pushes alone."""
KEPT = 0.5
"""Part of the errors that the functions of the model have to leave over, as they do not explain noise."""


def looks_noisy(library: Library, coefficients: Tensor, data: Transitions) -> bool:
    """Tell measurement noise from errors of the model by the one-step errors, of most states.

    White noise n of the states makes errors n_k+1 - n_k, whose neighbours correlate by -1/2; errors of a model last
    over many samples. Where the time between samples is long, these change from sample to sample, too, but are
    functions of the present states and inputs, as noise is not.
    """
    data = data.to(torch.float64)
    error = data.x_next - moved(generate(library, coefficients), data.x, data.u, data.dt, 1, data.u_end)
    # A constant, too, as a library need not have one.
    functions = torch.nn.functional.pad(library(data.x, data.u), (0, 1), value=1.0)
    functions = functions / functions.norm(dim=0).clamp_min(1e-300)
    left = error - functions @ torch.linalg.lstsq(functions, error, driver="gelsd").solution
    kept = left.norm(dim=0) > KEPT * error.norm(dim=0)
    follows = data.segment[1:] == data.segment[:-1]
    before, after = error[:-1][follows], error[1:][follows]
    correlation = (before * after).sum(0) / (before.norm(dim=0) * after.norm(dim=0)).clamp_min(1e-300)
    return bool(2 * ((correlation < PLAIN) & kept).sum() > len(kept))
