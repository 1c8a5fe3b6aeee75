"""Recordings of simulated plants."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.integrators import integrate
from dynasindy.systems.transitions import Transitions


def record(plant: System, u: Tensor, dt: float, substeps: int = 10, x0: Tensor | None = None) -> Transitions:
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
    return record_all(plant, u.unsqueeze(0), dt, substeps, x0)[0]


def record_all(plant: System, u: Tensor, dt: float, substeps: int = 10, x0: Tensor | None = None) -> list[Transitions]:
    """Record several experiments side by side, `u` `(experiments, T, n_u)`; otherwise as `record`."""
    u = u.to(torch.float64)
    x = torch.zeros(plant.signature.n_x, dtype=torch.float64) if x0 is None else x0.to(torch.float64)
    states, free = [x.expand(len(u), -1)], []
    with torch.no_grad():
        for held in u.unbind(1):
            samples, touched = integrate(plant, states[-1], held, dt, substeps, plant.stops)
            states.append(samples[:, -1])
            free.append(~touched)
    kept = torch.stack(free, 1)
    whole = zip(torch.stack(states, 1), u, kept, strict=True)
    return [Transitions.from_trajectory(x, held, dt).select(mask) for x, held, mask in whole]


def disturb(data: Transitions, level: float, seed: int) -> Transitions:
    """Add white measurement noise to a recording; a state that two rows share gets one error.

    Args:
        data: recording without noise.
        level: standard deviation of the noise, relative to that of each state.
        seed: seed of the noise.

    Returns:
        The recording as a sensor would have logged it.
    """
    if level == 0:
        return data
    generator = torch.Generator().manual_seed(seed)
    scale = level * data.x_next.std(0)
    after, first = (scale * torch.randn(data.x.shape, generator=generator, dtype=data.x.dtype) for _ in range(2))
    before = torch.where(data.begins().unsqueeze(-1), first, after.roll(1, 0))
    return replace(data, x=data.x + before, x_next=data.x_next + after)
