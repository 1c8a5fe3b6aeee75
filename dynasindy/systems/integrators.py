"""How a system moves under inputs that are held, or move in straight lines, by fixed steps."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.autograd import forward_ad

from dynasindy.systems.base import System
from dynasindy.systems.interpreter import simulate_program
from dynasindy.systems.steps import Stops, VectorField, between, steps_of, time_step_of

COARSE = 1e-3
"""How far from each other a control period and one of steps half as long may end [ranges of a state]."""
MOST_DOUBLINGS = 5
"""How often they are halved at most."""

AT_ONCE = 1 << 22
"""Numbers of a trajectory that machine code holds at once, all steps of a period included."""


def rk4(f: VectorField, x: Tensor, u: Tensor, dt: float, u_end: Tensor | None = None) -> Tensor:
    """Advance states by one classical fourth-order Runge-Kutta step.

    Args:
        f: Vector field, `(x, u) -> dx`.
        x: States, `(*batch, n_x)`.
        u: Inputs at the start of the step, `(*batch, n_u)`.
        dt: Length of the step [s].
        u_end: Inputs at its end, to which they move in a straight line, `(*batch, n_u)`; held if omitted.

    Returns:
        States one step later, `(*batch, n_x)`.
    """
    k1 = f(x, u)
    middle = between(u, u_end, 0.5)
    k2 = f(torch.add(x, k1, alpha=0.5 * dt), middle)
    k3 = f(torch.add(x, k2, alpha=0.5 * dt), middle)
    k4 = f(torch.add(x, k3, alpha=dt), u if u_end is None else u_end)
    return torch.add(x, torch.add(k1 + k4, k2 + k3, alpha=2.0), alpha=dt / 6)


def _stepped(f: VectorField, x: Tensor, u: Tensor, h: float, difference: bool, u_end: Tensor | None = None) -> Tensor:
    """Return states, `(*batch, n_x)`, one step of h [s] later: of a difference equation, or a Runge-Kutta step."""
    return torch.add(x, f(x, u), alpha=h) if difference else rk4(f, x, u, h, u_end)


def moved(
    f: VectorField, x: Tensor, u: Tensor, seconds: float, substeps: int = 1, u_end: Tensor | None = None
) -> Tensor:
    """Advance states by some time, without stops.

    Args:
        f: Vector field, `(x, u) -> dx`; with an attribute `step` [s] that of a difference equation.
        x: States, `(*batch, n_x)`.
        u: Inputs at its start, `(*batch, n_u)`.
        seconds: The time [s].
        substeps: Runge-Kutta steps in it; a difference equation has its own.
        u_end: Inputs at its end, to which they move in a straight line, `(*batch, n_u)`; held if omitted.

    Returns:
        States at its end, `(*batch, n_x)`.

    Raises:
        ValueError: The time is not made of whole steps of a difference equation.
    """
    h, count, difference = steps_of(time_step_of(f), seconds, substeps)
    for k in range(count):
        begin, end = between(u, u_end, k / count), None if u_end is None else between(u, u_end, (k + 1) / count)
        x = _stepped(f, x, begin, h, difference, end)
    return x


def integrate(
    f: VectorField, x: Tensor, u: Tensor, dt: float, substeps: int, stops: Stops | None = None
) -> tuple[Tensor, Tensor]:
    """Advance states over one control period, with stops applied after each sub-step.

    A system that has machine code for states that carry no gradient is moved by that.

    Args:
        f: Vector field, `(x, u) -> dx`; with an attribute `step` [s] that of a difference equation.
        x: States at the start of the period, `(*batch, n_x)`.
        u: Inputs held over the period, `(*batch, n_u)`.
        dt: Control period [s].
        substeps: Number of Runge-Kutta steps in the period, at least 1.
        stops: Mechanical stops, if any.

    Returns:
        The state after each sub-step, `(*batch, substeps, n_x)`, and whether a stop was touched in the
        period, bool `(*batch,)`. A difference equation says nothing of the time within its steps: each state is the
        one at the end of the period.

    Raises:
        ValueError: The period is not made of whole steps of a difference equation.
    """
    samples, touched = simulate(f, x, u.unsqueeze(0), dt, substeps, stops)
    return samples.squeeze(0), touched.squeeze(0)


def simulate(
    f: VectorField, x: Tensor, u: Tensor, dt: float, substeps: int, stops: Stops | None = None
) -> tuple[Tensor, Tensor]:
    """Advance states over control periods that follow each other, as `integrate` does again and again.

    A system that has machine code for states that carry no gradient moves through all of them at once.

    Args:
        f: Vector field, `(x, u) -> dx`; with an attribute `step` [s] that of a difference equation.
        x: States at the start of the first period, `(*batch, n_x)`.
        u: Inputs held over each period, `(T, *batch, n_u)`, of one period or more.
        dt: Control period [s].
        substeps: Number of Runge-Kutta steps in a period, at least 1.
        stops: Mechanical stops, if any.

    Returns:
        The states after each sub-step, `(T, *batch, substeps, n_x)`, and whether a stop was touched in each period,
        bool `(T, *batch)`.

    Raises:
        ValueError: The period is not made of whole steps of a difference equation.
    """
    h, count, difference = steps_of(time_step_of(f), dt, substeps)
    if isinstance(f, System) and plain(x, u) and (code := f.compiled(x, u[0])) is not None:
        x, u = x.contiguous(), u.contiguous()
        samples = x.new_empty(*u.shape[:-1], count, x.shape[-1])
        touched = torch.empty(u.shape[:-1], dtype=torch.bool)
        code.bind(x, u, samples, touched, dt, substeps, stops)()
    else:
        periods, hits = list[Tensor](), list[Tensor]()
        for held in u:
            ends, hit = list[Tensor](), torch.zeros(x.shape[:-1], dtype=torch.bool, device=x.device)
            for _ in range(count):
                x = _stepped(f, x, held, h, difference)
                if stops is not None:
                    x, stopped = stops.apply(x)
                    hit = hit | stopped
                ends.append(x)
            periods.append(torch.stack(ends, -2))
            hits.append(hit)
        samples, touched = torch.stack(periods), torch.stack(hits)
    if difference and not samples.shape[-2] == substeps == 1:  # the samples are all from the end of the period
        samples = samples[..., -1:, :].repeat_interleave(substeps, -2)
    return samples, touched


def trajectory(
    f: VectorField, x: Tensor, u: Tensor, dt: float, substeps: int = 1, u_end: Tensor | None = None
) -> Tensor:
    """Advance states over times that follow each other, as `simulate` does, in little memory.

    Args:
        f: Vector field, `(x, u) -> dx`; with an attribute `step` [s] that of a difference equation.
        x: States at the start, `(*batch, n_x)`.
        u: Inputs at the start of each time, `(T, *batch, n_u)`, of one time or more.
        dt: Length of each time [s].
        substeps: Runge-Kutta steps in it.
        u_end: Inputs at its end, to which they move in a straight line, `(T, *batch, n_u)`; held if omitted.

    Returns:
        States at the end of each time, `(T, *batch, n_x)`.
    """
    ends = []
    if u_end is not None:
        double = x.dtype == u.dtype == torch.float64
        if double and isinstance(f, System) and plain(x, u) and (code := f.compiled(x, u[0])) is not None:
            flat = (part.flatten(1, -2).movedim(0, 1) for part in (u.unsqueeze(1), u_end.unsqueeze(1)))
            found = simulate_program(code.program, x.reshape(-1, x.shape[-1]), next(flat), dt, substeps, next(flat))[0]
            return found.movedim(1, 0).reshape(*u.shape[:-1], x.shape[-1])
        for begin, end in zip(u, u_end, strict=True):
            x = moved(f, x, begin, dt, substeps, end)
            ends.append(x)
        return torch.stack(ends)
    for held in u.split(max(1, AT_ONCE // (max(x.numel(), 1) * substeps))):
        ends.append(simulate(f, x, held, dt, substeps)[0][..., -1, :].clone())
        x = ends[-1][-1]
    return torch.cat(ends)


def steps_needed(
    f: System, x: Tensor, u: Tensor, dt: float, substeps: int, stops: Stops | None = None, apart: float = COARSE
) -> tuple[int | None, float]:
    """Return how many Runge-Kutta steps a control period needs so that twice as many end it in the same place.

    Args:
        f: Vector field, whose signature has the ranges of the states.
        x: States at the start of the period, `(n, n_x)`.
        u: Inputs held over the period, `(n, n_u)`.
        dt: Control period [s].
        substeps: Number of Runge-Kutta steps in the period that is asked about.
        stops: Mechanical stops, if any; periods that touch them do not count.
        apart: How far from each other both may end [ranges of a state].

    Returns:
        `substeps`, doubled as often as it takes, and None where so many as `MOST_DOUBLINGS` allows are not enough; and
        how far from where `substeps` ends a period twice as many do, at most [ranges of a state], infinite where either
        ends at no number.
    """
    scale = torch.tensor(f.signature.x_scale, dtype=x.dtype)

    def _ends(steps: int) -> tuple[Tensor, Tensor]:
        samples, touched = integrate(f, x, u, dt, steps, stops)
        return samples[..., -1, :].clone(), touched

    (ends, touched), first = _ends(substeps), math.nan
    for doublings in range(MOST_DOUBLINGS + 1):
        finer, also = _ends(substeps * 2 ** (doublings + 1))
        distance = ((finer - ends).abs() / scale)[~(touched | also)].nan_to_num(torch.inf, torch.inf)
        farthest = float(distance.amax()) if distance.numel() else 0.0
        first = farthest if doublings == 0 else first
        if farthest <= apart:
            return substeps * 2**doublings, first
        ends, touched = finer, also
    return None, first


def plain(*tensors: Tensor) -> bool:
    """Return whether no derivative is asked of tensors, and no transform of `torch.func` is under way."""
    if torch._C._are_functorch_transforms_active():
        return False
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        return False
    # Outside of forward mode, to unpack them would cost several times what is asked here.
    return forward_ad._current_level < 0 or all(forward_ad.unpack_dual(tensor).tangent is None for tensor in tensors)
