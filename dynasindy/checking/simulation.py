"""Simulations of the closed loop, many at a time: steps, recovery, limit cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.checking.closed_loop import ClosedLoop
from dynasindy.checking.linear_loop import at_end
from dynasindy.progress import track

FULL = 0.99
"""Part of its way from the middle to a limit at which an input counts as saturated."""
TOLERANCE = 0.05
"""Distance of a plant which has come back from where the loop rests [ranges of the output]."""

AWAY = 3.0
"""Distance from the target beyond which what ends there has run away [target ranges, or ways to it if longer]."""


@dataclass(frozen=True)
class LoopSimulation:
    """Flights of one length.

    Attributes:
        x: States, `(rows, T + 1, n_x)`.
        u: Inputs held in between, `(rows, T, n_u)`.
        r: References, `(rows, n_r)`.
        outputs: Indices of the tracked states.
        dt: Control period [s].
        limits: Least and largest inputs, `(2, n_u)`.
    """

    x: Tensor
    u: Tensor
    r: Tensor
    outputs: list[int]
    dt: float
    limits: Tensor

    @property
    def last(self) -> int:
        """How many samples at the end count as steady."""
        return at_end(self.u.shape[1], self.dt)

    @property
    def steady_error(self) -> Tensor:
        """Mean absolute error of each output over the last seconds, `(rows, n_r)`; infinite where a flight diverged."""
        error = (self.x[:, -self.last :, self.outputs] - self.r.unsqueeze(1)).abs().mean(1)
        return error.nan_to_num(torch.inf, torch.inf)

    @property
    def end(self) -> Tensor:
        """Mean of each output over the last seconds, `(rows, n_r)`."""
        return self.x[:, -self.last :, self.outputs].mean(1)

    @property
    def slew(self) -> Tensor:
        """Largest change of each input from a period to the next, the first one from zero, `(rows, n_u)`."""
        first = torch.zeros_like(self.u[:, :1])
        return torch.cat([first, self.u], 1).diff(dim=1).abs().amax(1)

    @property
    def saturated(self) -> Tensor:
        """Share of the control periods in which each input is at its limit, `(rows, n_u)`."""
        low, high = self.limits.to(self.u)
        return ((2 * self.u - low - high).abs() > FULL * (high - low)).double().mean(1)


def diverged_rows(y: Tensor, r: Tensor, reach: Tensor, dt: float) -> Tensor:
    """Return which flights have run away: they end out of reach of their target, or in no number, bool `(rows,)`.

    Args:
        y: Outputs, `(rows, T + 1, n_r)`.
        r: Their targets, `(n_r,)`.
        reach: Distance of each output from its target beyond which it is out of reach, `(n_r,)`.
        dt: Time between two samples [s].
    """
    end = y[:, -at_end(y.shape[1] - 1, dt) :]
    return ~((end - r).abs() <= reach).all(-1).all(-1)


def simulate_loop(
    loop: ClosedLoop, x: Tensor, r: Tensor, seconds: float, phase: str = "steps to the targets"
) -> LoopSimulation:
    """Switch the controller on at states `(rows, n_x)` and let it hold references `(rows, n_r)`.

    Args:
        loop: The loop.
        x: States.
        r: References.
        seconds: Length of each flight [s].
        phase: What is under way, in words.
    """
    (z, covariance), r, states, inputs = loop.started(x.double()), r.double(), [x.double()], []
    periods = max(1, round(seconds / loop.dt))
    for _ in track(phase, range(periods), periods, "control periods"):
        z, covariance, u = loop.step(z, covariance, r)
        states.append(z[:, loop.parts["x"]])
        inputs.append(u)
    return LoopSimulation(
        torch.stack(states, 1), torch.stack(inputs, 1), r, loop.task.outputs, loop.dt, loop.task.input_limits
    )


@dataclass(frozen=True)
class Plane:
    """Initial errors of two states, all others at rest, and whether the plant comes back from them.

    Attributes:
        names: The two states.
        units: Their units.
        first, second: Errors of each, `(n,)` [their units].
        back: Whether it comes back to where the loop rests, bool `(n, n)`, rows by the first state.
        steady_error: Error of each output where the loop rests, `(n_r,)`; infinite if it runs away from its rest.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    first: Tensor
    second: Tensor
    back: Tensor
    steady_error: Tensor

    @property
    def share(self) -> float:
        """Share of the grid from which it comes back."""
        return float(self.back.double().mean())


def recovery_plane(loop: ClosedLoop, x: Tensor, r: Tensor, reach: float, points: int, seconds: float) -> list[Plane]:
    """Start around a state of rest in planes of outputs and rates, and see from where the plant comes back.

    It has come back where it ends as a flight without an initial error does: a loop that rests beside its target comes
    back to there, and its steady error is told apart.

    Args:
        loop: The loop.
        x: State of rest, `(n_x,)`.
        r: Its reference, `(n_r,)`.
        reach: Largest initial error [ranges of the states].
        points: Errors along each axis.
        seconds: Length of a flight [s].

    Returns:
        A plane of each output and its rate, and of each two outputs; where there is neither, of the output and another
        state, and none of a plant with one state.
    """
    task, signature = loop.task, loop.signature
    # A plant of the first order has no rates.
    pairs = [(task.outputs[k], rate) for k, rate in zip(task.rated, task.rates, strict=True)]
    pairs += [(a, b) for k, a in enumerate(task.outputs) for b in task.outputs[k + 1 :]]
    if not pairs:
        pairs = [(a, b) for a in task.outputs for b in range(signature.n_x) if a != b][:1]
    if not pairs:
        return []
    scale = torch.tensor(signature.x_scale, dtype=torch.float64)
    axis = reach * torch.linspace(-1.0, 1.0, points, dtype=torch.float64)
    starts = x.double().repeat(len(pairs), points, points, 1)
    for start, (a, b) in zip(starts, pairs, strict=True):
        start[..., a] += scale[a] * axis.unsqueeze(1)
        start[..., b] += scale[b] * axis
    flat = starts.flatten(0, -2)
    if loop.plant.stops is not None:
        flat = loop.plant.stops.apply(flat)[0]
    flat = torch.cat([flat, x.to(flat).unsqueeze(0)])
    flights = simulate_loop(loop, flat, r.expand(len(flat), -1), seconds, "recovery from initial errors")
    home = replace(flights, r=flights.end[-1:]).steady_error  # from there, not from the target
    back = (home <= TOLERANCE * scale[task.outputs]).all(-1)[:-1].unflatten(0, (len(pairs), points, points))
    left = flights.steady_error[-1]
    names, units = signature.state_names, signature.state_units
    return [
        Plane((names[a], names[b]), (units[a], units[b]), scale[a] * axis, scale[b] * axis, found, left)
        for (a, b), found in zip(pairs, back, strict=True)
    ]


LONGER = 5
"""How many times as long as the other flights these are: a slow swing has time to grow."""
GROWTH = 1.1
"""Ratio of the swings in the last part of a flight to those in the part before, from which on they grow."""


@dataclass(frozen=True)
class LimitCycles:
    """The end of long flights, as long as one of the other flights; a row is zero where the loop is stable.

    Attributes:
        outputs: Half of the way between the ends of each output, `(n_targets, n_r)`; infinite where it grows.
        inputs: Half of the way between the ends of each input, `(n_targets, n_u)`.
        error: Mean absolute error of each output, `(n_targets, n_r)`; infinite where a flight diverged.
        seconds: Length of a flight [s].
    """

    outputs: Tensor
    inputs: Tensor
    error: Tensor
    seconds: float


def find_limit_cycles(loop: ClosedLoop, targets: Tensor, stable: Tensor, seconds: float, begin: Tensor) -> LimitCycles:
    """Fly to the targets at which the loop is not stable.

    Args:
        loop: The loop.
        targets: References, `(n_targets, n_r)`.
        stable: Whether the loop is stable there, bool `(n_targets,)`.
        seconds: Length of the other flights [s].
        begin: State in which flights begin, `(n_x,)`.
    """
    whole = LONGER * seconds
    n_r, n_u = loop.task.n_r, loop.signature.n_u
    outputs, inputs, error = (torch.zeros(len(targets), n, dtype=torch.float64) for n in (n_r, n_u, n_r))
    found = LimitCycles(outputs, inputs, error, whole)
    lost = ~stable
    if not bool(lost.any()):
        return found
    r = targets[lost]
    flights = simulate_loop(loop, begin.expand(len(r), -1), r, whole, "flights where the loop is not stable")
    part = max(1, round(seconds / loop.dt))
    y = flights.x[..., flights.outputs]
    before, last = _half(y[:, -2 * part : -part]), _half(y[:, -part:])
    found.outputs[lost] = torch.where(last > GROWTH * before, math.inf, last).nan_to_num(math.inf, math.inf)
    found.inputs[lost] = _half(flights.u[:, -part:])
    found.error[lost] = (y[:, -part:] - r.double().unsqueeze(1)).abs().mean(1).nan_to_num(math.inf, math.inf)
    return found


def _half(values: Tensor) -> Tensor:
    """Return half of the way between the least and the largest value, `(rows, T, n)` to `(rows, n)`."""
    return (values.amax(1) - values.amin(1)) / 2
