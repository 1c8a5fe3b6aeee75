"""Identification data out of rollouts of a real or a simulated plant."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.integrators import simulate
from dynasindy.systems.transitions import Transitions


def record_plant(plant: System, u: Tensor, dt: float, substeps: int = 10, x0: Tensor | None = None) -> Transitions:
    """Excite a plant and log its states; samples that touch a stop are left out.

    Args:
        plant: system to excite.
        u: inputs held in each interval, `(T, n_u)`.
        dt: time between two samples [s].
        substeps: Runge-Kutta steps between two samples.
        x0: start state, `(n_x,)`; zero by default.

    Returns:
        Up to T transitions, float64.
    """
    x = torch.zeros(plant.signature.n_x, dtype=torch.float64) if x0 is None else x0.to(torch.float64)
    with torch.no_grad():
        samples, touched = simulate(plant, x, u := u.to(torch.float64), dt, substeps, plant.stops)
    return Transitions.from_trajectory(torch.cat([x.unsqueeze(0), samples[..., -1, :]]), u, dt).select(~touched)
