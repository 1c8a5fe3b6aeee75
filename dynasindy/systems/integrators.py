"""Fixed-step integration under a zero-order hold of the inputs."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.plain import plain
from dynasindy.systems.stops import Stops

VectorField = Callable[[Tensor, Tensor], Tensor]


def rk4(f: VectorField, x: Tensor, u: Tensor, dt: float) -> Tensor:
    """Advance states by one classical fourth-order Runge-Kutta step.

    Args:
        f: Vector field, `(x, u) -> dx`.
        x: States, `(*batch, n_x)`.
        u: Inputs held over the step, `(*batch, n_u)`.
        dt: Length of the step [s].

    Returns:
        States one step later, `(*batch, n_x)`.
    """
    k1 = f(x, u)
    k2 = f(torch.add(x, k1, alpha=0.5 * dt), u)
    k3 = f(torch.add(x, k2, alpha=0.5 * dt), u)
    k4 = f(torch.add(x, k3, alpha=dt), u)
    return torch.add(x, torch.add(k1 + k4, k2 + k3, alpha=2.0), alpha=dt / 6)


def integrate(
    f: VectorField, x: Tensor, u: Tensor, dt: float, substeps: int, stops: Stops | None = None
) -> tuple[Tensor, Tensor]:
    """Advance states over one control period, with stops applied after each sub-step.

    A system that has machine code for states that carry no gradient is moved by that.

    Args:
        f: Vector field, `(x, u) -> dx`.
        x: States at the start of the period, `(*batch, n_x)`.
        u: Inputs held over the period, `(*batch, n_u)`.
        dt: Control period [s].
        substeps: Number of Runge-Kutta steps in the period, at least 1.
        stops: Mechanical stops, if any.

    Returns:
        The state after each sub-step, `(*batch, substeps, n_x)`, and whether a stop was touched in the
        period, bool `(*batch,)`.
    """
    if isinstance(f, System) and plain(x, u) and (code := f.compiled(x, u)) is not None:
        return code.integrate(x, u, dt, substeps, stops)
    touched = torch.zeros(x.shape[:-1], dtype=torch.bool, device=x.device)
    samples = []
    for _ in range(substeps):
        x = rk4(f, x, u, dt / substeps)
        if stops is not None:
            x, stopped = stops.apply(x)
            touched = touched | stopped
        samples.append(x)
    return torch.stack(samples, -2), touched
