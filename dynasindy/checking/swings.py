"""What becomes of a loop where it is not stable: it leaves its target, or it goes on swinging around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.checking.flights import fly
from dynasindy.checking.loop import Loop

LONGER = 5
"""How many times as long as the other flights these are: a slow swing has time to grow."""
GROWTH = 1.1
"""Ratio of the swings in the last part of a flight to those in the part before, from which on they grow."""


@dataclass(frozen=True)
class Swings:
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


def swings(loop: Loop, targets: Tensor, stable: Tensor, seconds: float, begin: Tensor) -> Swings:
    """Fly to the targets at which the loop is not stable.

    Args:
        loop: The loop.
        targets: References, `(n_targets, n_r)`.
        stable: Whether the loop is stable there, bool `(n_targets,)`.
        seconds: Length of the other flights [s].
        begin: State in which flights begin, `(n_x,)`.
    """
    whole = LONGER * seconds
    found = unmoved(len(targets), loop.task.n_r, loop.signature.n_u, whole)
    lost = ~stable
    if not bool(lost.any()):
        return found
    r = targets[lost]
    flights = fly(loop, begin.expand(len(r), -1), r, whole, "flights where the loop is not stable")
    part = max(1, round(seconds / loop.dt))
    y = flights.x[..., flights.outputs]
    before, last = _half(y[:, -2 * part : -part]), _half(y[:, -part:])
    found.outputs[lost] = torch.where(last > GROWTH * before, math.inf, last).nan_to_num(math.inf, math.inf)
    found.inputs[lost] = _half(flights.u[:, -part:])
    found.error[lost] = (y[:, -part:] - r.double().unsqueeze(1)).abs().mean(1).nan_to_num(math.inf, math.inf)
    return found


def unmoved(n: int, n_r: int, n_u: int, seconds: float) -> Swings:
    """Return the swings at so many targets where the loop is stable, which are none."""
    outputs, inputs, error = (torch.zeros(n, width, dtype=torch.float64) for width in (n_r, n_u, n_r))
    return Swings(outputs, inputs, error, seconds)


def _half(values: Tensor) -> Tensor:
    """Return half of the way between the least and the largest value, `(rows, T, n)` to `(rows, n)`."""
    return (values.amax(1) - values.amin(1)) / 2
