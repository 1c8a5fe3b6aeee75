"""How trajectories are fitted: over which windows, by how many steps, and what is taken for noise."""

from __future__ import annotations

from dataclasses import dataclass


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
