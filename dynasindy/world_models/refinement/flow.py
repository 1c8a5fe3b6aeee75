"""Trajectories of all windows side by side, and their sensitivities to start states, shapes and coefficients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from dynasindy.systems.integrators import moved
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.refinement.coloured import news
from dynasindy.world_models.refinement.windows import Windows
from dynasindy.world_models.regression.sensitivity import Parameters, Propagator, chained
from dynasindy.world_models.writers.fast_field import generate

EXACT = 1e-100
"""Error taken for that of a state that is met exactly, as one that never moves; its inverse has a finite square."""
ROUNDING = 1e-12
"""Part of a state below which errors are those of arithmetic, which differ from processor to processor."""
FINE, COARSE, STABLE, MOST_STEPS = 0.1, 0.3, 1.5, 10
"""Runge-Kutta step times the fastest rate of the model: for an error of 1e-7, for one of 2e-5, by which functions and
delays are compared, and the most that is stable; and how many steps of an interval the first two may ask for."""


@dataclass
class Estimate:
    """Hold the unknowns of a fit to trajectories: the library with its shapes, Xi, and the nodes."""

    library: Library
    xi: Tensor
    nodes: Tensor


@dataclass(frozen=True)
class Flow:
    """Hold the trajectories of all windows; their sensitivities are computed when they are first asked for.

    Attributes:
        estimate: coefficients and nodes.
        parameters: coefficients to differentiate by, P of them.
        windows: the recording.
        predicted: states at the ends of the intervals, `(W, L, n_x)`.
    """

    estimate: Estimate
    parameters: Parameters
    windows: Windows
    predicted: Tensor

    @classmethod
    def of(cls, estimate: Estimate, parameters: Parameters, windows: Windows) -> Flow:
        """Integrate all windows."""
        return cls(estimate, parameters, windows, states_of(estimate, windows))

    @cached_property
    def steps(self) -> Tensor:
        """Derivatives of the end of each interval by its beginning, shapes and Xi, `(W, L, n_x, n_x + S + P)`.

        Intervals that follow each other cost as many small operations as there are of them. Here the states are known,
        and all intervals are computed side by side.
        """
        estimate, windows = self.estimate, self.windows
        propagator = Propagator(estimate.library, estimate.xi, self.parameters, estimate.library.shapes)
        begins = torch.cat([estimate.nodes.unsqueeze(1), self.predicted[:, :-1]], 1).flatten(0, 1)
        steps = propagator.transfer(begins, windows.inputs.flatten(0, 1), windows.dt, windows.substeps)[1]
        return steps.unflatten(0, self.predicted.shape[:2])

    @cached_property
    def s(self) -> Tensor:
        """Derivatives of the states by the window's start, shapes and Xi, `(W, L, n_x, n_x + S + P)`."""
        slopes = [self.steps[:, 0]]
        for step in self.steps.unbind(1)[1:]:
            slopes.append(chained(step, slopes[-1]))
        return torch.stack(slopes, 1)

    def lost(self) -> Tensor:
        """Return which windows the model runs away in, bool `(W,)`."""
        finite = self.predicted.square().isfinite().all(-1).all(-1)
        if bool(finite.all()):
            finite = self.s.square().isfinite().flatten(1).all(-1)
        return ~finite

    def sigma(self) -> Tensor:
        """Return the error of each state, `(n_x,)`, not below rounding; of lasting ones what is new.

        It is `EXACT` where none was measured, or a state is zero throughout.
        """
        windows = self.windows
        error = white((windows.measured - self.predicted).unsqueeze(-1) * windows.mask.unsqueeze(-1), windows)
        size = (windows.measured * windows.mask).square().sum((0, 1))
        squares = (error.squeeze(-1).square().sum((0, 1)), ROUNDING**2 * size)
        return (torch.maximum(*squares) / windows.mask.sum((0, 1)).clamp_min(1)).sqrt().clamp_min(EXACT)


def states_of(estimate: Estimate, windows: Windows) -> Tensor:
    """Return the states at the ends of the intervals of all windows, `(W, L, n_x)`."""
    if not bool(estimate.xi.isfinite().all()):
        return torch.full((*windows.mask.shape[:2], estimate.xi.shape[1]), math.nan, dtype=estimate.nodes.dtype)
    field, x, states = generate(estimate.library, estimate.xi), estimate.nodes, []
    for u in windows.inputs.unbind(1):
        x = moved(field, x, u, windows.dt, windows.substeps)
        states.append(x)
    return torch.stack(states, 1)


def white(rows: Tensor, windows: Windows) -> Tensor:
    """Return errors and slopes, zero where not measured, `(W, L, n_x, C)`; of errors that last what is new."""
    return rows if windows.lasting is None else news(rows, windows.mask, windows.joined, windows.lasting)


def growth(flow: Flow, farthest: float = math.inf) -> tuple[float, Tensor]:
    """Follow an error of a start state along the windows that join, relative to the spreads of the states.

    Args:
        flow: what was integrated.
        farthest: growth beyond which a window begins at a state of its own.

    Returns:
        The largest growth without such a beginning, and which windows continue the one before with it, bool `(W,)`.
    """
    nodes, windows = flow.estimate.nodes, flow.windows
    spread = nodes.std(0, correction=0).clamp_min(1e-12)
    whole, part, largest, joined = torch.eye(len(spread), dtype=nodes.dtype), None, 0.0, windows.joined.clone()
    for j, step in enumerate((flow.s[:, -1, :, : len(spread)] * spread / spread.unsqueeze(-1)).unbind()):
        whole = step @ whole if windows.joined[j] else step
        largest = max(largest, float(whole.norm().nan_to_num(math.inf)))
        longer = step @ part if part is not None and windows.joined[j] else step
        joined[j] = bool(windows.joined[j]) and bool(longer.norm() <= farthest)
        part = longer if joined[j] else step
    return largest, joined


def turn_of(library: Library, xi: Tensor, x: Tensor, u: Tensor, dt: float) -> float:
    """Return the length of an interval by the time of the fastest motion of a model: its rate times `dt`.

    A difference equation does not move within its steps, so that it is 0, however fast the equation is.

    Args:
        library: candidate functions.
        xi: coefficients, `(n_features, n_x)`.
        x: states that occur, `(N, n_x)`.
        u: inputs there, `(N, n_u)`.
        dt: length of an interval [s].
    """
    if library.step is not None or not bool(xi.any()):
        return 0.0
    slopes = Propagator(library, xi, Parameters.where(xi != 0)).slopes_by_state(x, u)
    rates = torch.linalg.eigvals(slopes[slopes.isfinite().all(-1).all(-1)]).abs().amax(-1)
    return dt * float(torch.quantile(rates[-100_000:], 0.999)) if len(rates) else 0.0


def substeps_for(turn: float, turned: float = FINE) -> int:
    """Return into how many Runge-Kutta steps an interval is divided.

    Args:
        turn: what `turn_of` returned.
        turned: the same of a step that is wanted.
    """
    return max(1, min(math.ceil(turn / turned - 1e-6), MOST_STEPS), min(math.ceil(turn / STABLE), 10 * MOST_STEPS))
