"""Whether what single steps of a model miss is noise of the sensors."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.writers.fast_field import generate

NOISE = -0.6
"""Correlation of neighbouring changes of the errors of single steps below which samples are noisy: -2/3 of noise of the
sensors alone, -1/2 of random pushes alone; here noise has half the variance of the pushes of a step."""


def looks_noisy(library: Library, coefficients: Tensor, data: Transitions) -> bool:
    """Tell measurement noise from errors of the model by the one-step errors.

    White noise n of the states makes errors n_k+1 - n_k, whose changes from one to the next correlate by -2/3 with the
    changes before. Errors of a model last over many samples, so they hardly change; pushes at random make errors that
    are white, and changes that correlate by -1/2. The errors themselves would hide the noise beneath those of a model
    that lacks something: noise has to be seen first, as a delay and a state that no sensor sees are looked for by it.
    """
    data = data.to(torch.float64)
    error = data.x_next - rk4(generate(library, coefficients), data.x, data.u, data.dt)
    follows = data.segment[1:] == data.segment[:-1]
    change, both = error.diff(dim=0), follows[1:] & follows[:-1]
    before, after = change[:-1][both], change[1:][both]
    correlation = (before * after).sum(0) / (before.norm(dim=0) * after.norm(dim=0)).clamp_min(1e-300)
    return bool((correlation < NOISE).any())
