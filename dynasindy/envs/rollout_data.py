"""Identification data out of rollouts of a real or a simulated plant."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.systems.base import Signature, System
from dynasindy.systems.integrators import simulate
from dynasindy.systems.transitions import Transitions


def transitions(rows: TensorDictBase, log_dt: float, among: Tensor | None = None) -> Transitions:
    """Return the logged samples of real control periods as transitions, in float64.

    Of a plant behind sensors these are the measured samples, NaN where nothing was measured.
    Periods in which a mechanical stop was touched are left out: they are not smooth dynamics.

    Args:
        rows: Control periods `(T,)` in the order of time, with `state` or, behind sensors, `measurement`,
            `action`, ("next", "samples") and ("next", "at_stop").
        log_dt: Time between samples [s].
        among: Which of these periods to return, bool `(T,)`; all if omitted.

    Returns:
        Up to `T * substeps` transitions.
    """
    samples, free = rows["next", "samples"].double(), ~rows["next", "at_stop"].reshape(-1)
    start = rows["measurement"] if "measurement" in set(rows.keys()) else rows["state"]
    logged = Transitions.from_samples(start.double(), rows["action"].double(), samples, log_dt)
    return logged.select((free if among is None else free & among).repeat_interleave(logged.substeps))


def measurements_and_inputs(rows: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Return what an observer reads of an episode: measurements `(T + 1, n_x)` and the commands between them.

    Args:
        rows: Control periods `(T,)` of one episode behind sensors.
    """
    return torch.cat([rows["measurement"][:1], rows["next", "samples"][:, -1]]), rows["action"]


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


def disturb(
    data: Transitions, level: float | Mapping[str, float], seed: int, signature: Signature | None = None
) -> Transitions:
    """Add white measurement noise to a recording; a state that two rows share gets one error.

    Args:
        data: recording without noise.
        level: standard deviation of the noise: one number, relative to that of each state, or by the name of a state in
            its unit.
        seed: seed of the noise.
        signature: names of the states, for noise by name.

    Returns:
        The recording as a sensor would have logged it.

    Raises:
        ValueError: noise is given of what is no state.
    """
    scale = data.x_next.std(0)
    if isinstance(level, Mapping):
        assert signature is not None
        scale = torch.zeros_like(scale)
        for name, std in level.items():
            scale[signature.state_index(name, "data.noise")] = std
        level = 1.0
    scale = level * scale
    if level == 0 or not bool(scale.any()):
        return data
    generator = torch.Generator().manual_seed(seed)
    return data.observed(lambda x: x + scale * torch.randn(x.shape, generator=generator, dtype=x.dtype))
