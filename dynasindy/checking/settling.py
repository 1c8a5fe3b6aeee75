"""How long a loop takes to close a step between two targets, by its linear models: z[k+1] = z_r + A (z[k] - z_r).

What limits and large movements add is not in it. So it tells the end of a step, which an observer may make long: where
the plant is not as the model says, it first has to find the push that makes up for the difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynasindy.checking.linear import Array

CLOSED = 0.02
"""Part of the way to a target within which the outputs have to stay."""
LONGEST = 20
"""Flights after which it is no longer looked when they do."""


def settling(a: Array, away: Array, outputs: list[int], ways: Array, periods: int) -> NDArray[np.float64]:
    """Return after how many control periods the outputs of loops stay within `CLOSED` of their way, `(rows,)`.

    Args:
        a: From z to z, `(rows, n, n)`.
        away: How far z is from its rest at the beginning, `(rows, n)`.
        outputs: Places of the outputs in z.
        ways: How far each output has to go, `(n_r,)`; one that stays where it is does not count.
        periods: Control periods of a flight.

    Returns:
        The periods, infinite where `LONGEST` flights are not enough.
    """
    z, left = away.copy(), np.zeros(len(away))
    moving = np.abs(ways) > 0
    for k in range(LONGEST * periods):
        beyond = (np.abs(z[:, outputs][:, moving]) > CLOSED * np.abs(ways[moving])).any(-1)
        left[beyond] = k + 1
        if not beyond.any() and k > left.max() + periods:
            break
        z = (a @ z[..., None])[..., 0]
    return np.where(left >= LONGEST * periods, np.inf, left)
