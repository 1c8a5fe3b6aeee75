"""What noise of the sensors does to the inputs of a plant that is held."""

from __future__ import annotations

import numpy as np
from scipy.linalg import matrix_balance, solve_discrete_lyapunov

from dynasindy.checking.linear import Array, Linear


def noise_gain(linear: Linear) -> Array:
    """Return the standard deviation of each input per unit of white noise on each state's measurement, `(n_u, n_x)`.

    S = A S A' + e e' is the covariance of z under unit noise of one measurement, that of the inputs C S C' + f f'.
    A state that is not measured has none.

    Raises:
        ValueError: The loop is not stable, and its inputs have no steady spread.
    """
    if np.abs(np.linalg.eigvals(linear.a)).max() >= 1:
        raise ValueError("the loop is not stable, so its inputs have no steady spread")
    # States in rpm beside states in rad: what is balanced solves without a loss of digits.
    a, scale = matrix_balance(linear.a, permute=False)
    units = np.diag(scale)
    found = np.zeros(linear.f.shape)
    for i in range(linear.f.shape[1]):
        if not (linear.e[:, i].any() or linear.f[:, i].any()):
            continue
        e = linear.e[:, i] / units
        c = linear.c * units
        inputs = c @ solve_discrete_lyapunov(a, np.outer(e, e)) @ c.T + np.outer(linear.f[:, i], linear.f[:, i])
        found[:, i] = np.sqrt(np.diag(inputs).clip(0))
    return found
