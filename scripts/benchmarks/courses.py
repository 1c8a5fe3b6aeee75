"""Flights that no policy was trained for: along any course, and from any state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from dynasindy.tasks import Reference, Tracking

Course = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Reference and its rate, `(*batch, n_r)` each, at times `(*batch, 1)` [s]."""


class Flight(Tracking):
    """A tracking task whose reference is any function of time, or that begins anywhere.

    Args:
        task: The task; its reward and observation stay.
        course: The reference; that of the task if omitted.
        spread: Start states are drawn uniformly within this part of the states' ranges, to both sides of zero.
    """

    def __init__(self, task: Tracking, course: Course | None = None, spread: float = 0.0) -> None:
        super().__init__(
            task.signature,
            task.references,
            task.output_names,
            task.rate_names,
            task.reward_function,
            task.max_steps,
            task.observe_rate,
            task.error_scale,
        )
        self.course, self.spread = course, spread

    def with_reference(self, reference: Reference) -> Flight:
        """Return the same flight, along the course if it has one."""
        return Flight(super().with_reference(reference), self.course, self.spread)

    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw states, `(*batch, n_x)`."""
        scale = torch.tensor(self.signature.x_scale)
        return self.spread * scale * (2 * torch.rand(*batch, len(scale), generator=generator) - 1)

    def reference(self, params: Tensor, t: Tensor) -> Tensor:
        """Return the reference, `(*batch, n_r)`, at times `t` `(*batch, 1)` [s]."""
        return super().reference(params, t) if self.course is None else self.course(t)[0].to(params)

    def error(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return e = desired - actual, `(*batch, n_r)`."""
        return self.reference(params, t) - x[..., self.outputs]

    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return what the task shows, with the rate of the course where it shows one."""
        seen = super().observation(x, params, t)
        if self.course is not None and self.observe_rate:
            seen = torch.cat([seen[..., : -self.n_r], self.course(t)[1].to(seen)], -1)
        return seen


def ramps(times: Sequence[float], targets: Sequence[Sequence[float]]) -> Course:
    """Return a course of straight lines between targets.

    Args:
        times: When each target is met [s], increasing.
        targets: One list of targets per time, `(n, n_r)` [rad].
    """
    at = torch.tensor(list(times), dtype=torch.float64)
    met = torch.tensor([list(row) for row in targets], dtype=torch.float64)
    slopes = (met[1:] - met[:-1]) / (at[1:] - at[:-1]).unsqueeze(-1)

    def _course(t: Tensor) -> tuple[Tensor, Tensor]:
        piece = (torch.searchsorted(at, t.double().contiguous(), right=True) - 1).clamp(0, len(slopes) - 1).squeeze(-1)
        return met[piece] + slopes[piece] * (t - at[piece].unsqueeze(-1)), slopes[piece]

    return _course


def stairs(targets: Sequence[Sequence[float]], seconds: float) -> Course:
    """Return a course that holds one target after the other.

    Args:
        targets: One list of targets per stair, `(n, n_r)` [rad].
        seconds: Length of a stair [s].
    """
    held = torch.tensor([list(row) for row in targets], dtype=torch.float64)

    def _course(t: Tensor) -> tuple[Tensor, Tensor]:
        # A stair begins at its own time, which sums of control periods may miss by a rounding error.
        stair = ((t.double() + 1e-6) / seconds).long().clamp(0, len(held) - 1).squeeze(-1)
        return held[stair], torch.zeros_like(held[stair])

    return _course


def chirp(amplitude: Sequence[float], frequency: float, seconds: float) -> Course:
    """Return a sine whose frequency rises evenly from zero.

    Args:
        amplitude: One per output [rad].
        frequency: At the end [Hz].
        seconds: Length of the sweep [s].
    """
    size, growth = torch.tensor(list(amplitude), dtype=torch.float64), math.pi * frequency / seconds

    def _course(t: Tensor) -> tuple[Tensor, Tensor]:
        angle = growth * t.double().square()
        return size * torch.sin(angle), size * 2 * growth * t.double() * torch.cos(angle)

    return _course


def rim(low: Sequence[float], high: Sequence[float], beyond: float = 0.0) -> list[list[float]]:
    """Return 16 targets on the edge of the target ranges of two outputs, its corners among them, five to a side.

    Args:
        low: Lower ends [rad].
        high: Upper ends [rad].
        beyond: Part by which the ranges are made larger about their centres.
    """
    sides = [k / 2 - 1 for k in range(5)]
    places = [(a, b) for a in sides for b in sides if max(abs(a), abs(b)) == 1]
    middle = [(one + other) / 2 for one, other in zip(low, high)]
    half = [(1 + beyond) * (other - one) / 2 for one, other in zip(low, high)]
    return [[m + h * s for m, h, s in zip(middle, half, place)] for place in places]
