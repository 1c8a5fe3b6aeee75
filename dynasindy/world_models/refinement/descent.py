"""How trajectories are fitted: over which windows, how many steps, and what a coefficient must be worth."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from dynasindy.world_models.refinement.repeated import repetition
from dynasindy.world_models.refinement.windows import Windows


@dataclass(frozen=True)
class Descent:
    """Say how trajectories are fitted.

    Attributes:
        window: sampling intervals in a window; fewer where the model runs away in windows as long as that.
        joined: whether the windows join to one trajectory; by default they do in the end, but not while functions are
            chosen where small errors grow along the trajectory, as in chaos.
        max_rounds: limit on Gauss-Newton steps between two changes of the equations.
        correlated: whether a coefficient must be worth the more, the longer errors last.
        pushed: whether windows on their own are corrected by a Kalman filter, as far as random pushes on the plant and
            noise of the sensors, both estimated, explain what it leaves over.
        coloured: whether errors of a trajectory are taken to last, as long as they do.
    """

    window: int
    joined: bool | None = None
    max_rounds: int = 30
    correlated: bool = False
    pushed: bool = False
    coloured: bool = False

    @property
    def joins(self) -> bool:
        """Tell whether windows may join."""
        return self.joined is not False and not self.pushed


@dataclass(frozen=True)
class Limits:
    """Say what a coefficient must be worth, and how many steps are made.

    Attributes:
        price: squared error, in units of its variance, that a coefficient must be worth where errors are white.
        max_rounds: limit on Gauss-Newton steps between two changes of the equations.
        correlated: whether it must be worth the more, the longer errors last.
    """

    price: float
    max_rounds: int
    correlated: bool = False

    def at(self, errors: Tensor, windows: Windows) -> float:
        """Return what a coefficient must be worth where a model leaves over these errors, `(W, L, n_x)`."""
        return self.price * repetition(errors, windows.mask, windows.joined) if self.correlated else self.price


def price(n: int, free: Tensor) -> float:
    """Return the squared weighted error that a coefficient must be worth: extended Bayesian criterion.

    The more functions there are to choose from, the better is the best one of those that mean nothing (Chen and
    Chen 2008).

    Args:
        n: transitions.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
    """
    return math.log(max(n, 2)) + 2 * math.log(max(int(free.sum(0).max()), 1))
