"""A prior on coefficients: functions of angles that are many times what they sum to are unlikely.

Over the range of a log functions may look nearly alike, as alpha and sin(alpha) at small angles. Their differences are
then small, and a fit to noisy data makes up any function out of such differences by coefficients of 1e6 that all but
cancel one another. It follows the log, cannot be read, and predicts badly beyond the log. Here a term c f, f a function
of an angle, is a priori normally distributed about zero, its standard deviation `SHARE` times the rate of change of its
equation, both as root-mean-squares over the data. Where data tell a coefficient the prior changes nothing: it acts as
one measurement more. Where they do not, it keeps the coefficient small, so that functions can be dropped one by one.

An angle is what stands in a sine, a cosine or a quotient of the library. All functions of it are treated alike, its
powers among them: with a prior on the sines alone a fit would rather take the angle, which grows where a sine does not.
Functions of other states have no prior. Powers of a state that stays far from zero cancel one another by nature, as
those of the speed of a turbine do, and so do temperatures in deg C.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.sindy.library import Library
from dynasindy.systems.transitions import Transitions

SHARE = 10.0
"""Standard deviation of a term, in rates of change of its equation."""
TURNED = ("sin", "cos", "per_cos2")
"""How the names of the functions of angles begin, of one angle, or of the sum or the difference of two."""


def shares(library: Library) -> Tensor:
    """Return how many rates of change of its equation a term is likely to be, `(n_features,)`; infinite if not known.

    Args:
        library: candidate functions.
    """
    factors = (factor for feature in library.features for factor in feature.factors)
    angles = {name for factor in factors if factor.function.startswith(TURNED) for name in factor.variables}
    turned = [bool(angles & feature.variables) for feature in library.features]
    return torch.where(torch.tensor(turned), SHARE, torch.inf).to(torch.float64)


def likely(library: Library, xi: Tensor, x: Tensor, data: Transitions, window: int = 1) -> Tensor:
    """Return the standard deviation of each coefficient before data tell it, `(n_features, n_x)`.

    It is infinite without a prior, for a function that is zero throughout, and for a state that does not move.

    Args:
        library: candidate functions.
        xi: a first guess of the coefficients, `(n_features, n_x)`; the rates of change are those that it tells, or
            those of the states, whichever are larger.
        x: states before each transition, `(N, n_x)`, without NaN.
        data: the recording, whose inputs and stretches are read.
        window: samples over which rates of change of the states are taken, so that they are not of noise.
    """
    theta = library(x, data.u.to(x.dtype))
    rates = torch.maximum((theta @ xi).square().mean(0).sqrt(), _moved(x, data, window))
    sizes = theta.square().mean(0).sqrt()
    told = (sizes > 0).unsqueeze(-1) & (rates > 0) & sizes.isfinite().unsqueeze(-1) & rates.isfinite()
    return torch.where(told, shares(library).unsqueeze(-1) * rates / sizes.clamp_min(1e-300).unsqueeze(-1), torch.inf)


def _moved(x: Tensor, data: Transitions, window: int) -> Tensor:
    """Return rates of change over a window of samples of one stretch, root-mean-square, `(n_x,)`."""
    window = max(1, min(window, len(x) - 1))
    within = data.segment[window:] == data.segment[:-window]
    moved = (x[window:] - x[:-window])[within] / (window * data.dt)
    return moved.square().mean(0).sqrt() if len(moved) else torch.zeros_like(x[0])
