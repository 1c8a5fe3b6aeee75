"""Noise of sensors, told from errors of a model and from random pushes."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.sindy.codegen import generate
from dynasindy.sindy.library import Library
from dynasindy.sindy.sensitivity import Parameters, trajectory_sensitivities
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions

PLAIN = -0.3
"""Correlation of neighbouring errors of single steps below which a state is noisy: -1/2 of noise of the sensors alone,
0 of random pushes alone."""
DUE = 0.6
"""Part of the squared errors of a difference equation's steps that noise of the sensors has to explain."""
KEPT = 0.5
"""Part of the errors that the functions of the model have to leave over, as they do not explain noise."""


def looks_noisy(library: Library, coefficients: Tensor, data: Transitions) -> bool:
    """Tell measurement noise from errors of the model by the one-step errors, of most states.

    White noise n of the states makes errors n_k+1 - n_k, whose neighbours correlate by -1/2; errors of a model last
    over many samples. Where the time between samples is long, these change from sample to sample, too, but are
    functions of the present states and inputs, as noise is not.
    """
    data = data.to(torch.float64)
    if library.step is not None:
        share = sensor_noise(library, coefficients, data)[1]
        return bool(coefficients.any()) and bool(2 * (share > DUE).sum() > len(share))
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


def sensor_noise(library: Library, coefficients: Tensor, data: Transitions) -> tuple[Tensor, Tensor]:
    """Tell measurement noise from random pushes of a difference equation, by the errors of its steps.

    White noise n of the states makes errors e_k = n_k+1 - A_k n_k, where A_k is the derivative of the step, and so
    E[e_k+1 e_k'] = -A_k+1 R; pushes make errors that are white. R, the variances of n, are those that explain these
    products best. A state whose value does not matter for the next step keeps no trace of its noise, which then does no
    harm.

    Args:
        library: candidate functions of a difference equation.
        coefficients: Xi, `(n_features, n_x)`.
        data: transitions; rows in which a state was not measured do not count.

    Returns:
        R, `(n_x,)`, and the part of each state's squared errors that this noise explains: its own, and A_k n_k.
    """
    data = data.to(torch.float64)
    data = data.select((data.x.isfinite() & data.x_next.isfinite()).all(-1))
    parameters, inputs = Parameters.where(coefficients != 0), data.u.unsqueeze(1)
    ends, slopes = trajectory_sensitivities(library, coefficients, parameters, data.x, inputs, data.dt, 1)
    error, a = data.x_next - ends[:, 0], slopes[:, 0, :, : data.x.shape[1]]
    scale, spread = error.square().mean(0).clamp_min(1e-300), a.square().mean(0)
    follows = (data.segment[1:] == data.segment[:-1]).nonzero().squeeze(-1)
    products = error[follows + 1].unsqueeze(-1) * error[follows].unsqueeze(-2)
    after, weight = a[follows + 1], 1 / scale.unsqueeze(-1)  # so that states of any unit count alike
    squares = (after.square() * weight).sum((0, 1)).clamp_min(1e-300)
    noise = (-(after * products * weight).sum((0, 1)) / squares).clamp_min(0.0)
    return noise, (noise + (spread * noise).sum(-1)) / scale
