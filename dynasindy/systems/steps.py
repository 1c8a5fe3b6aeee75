"""How a system moves on: a differential equation by Runge-Kutta steps, a difference equation by steps of its own.

| equation     | form                                | a step of h [s]                                  |
| ------------ | ----------------------------------- | ------------------------------------------------ |
| differential | dx/dt = f(x, u)                     | the classical Runge-Kutta method of fourth order |
| difference   | x[k+1] = x[k] + h f(x[k], u[k])     | the equation itself; h is a part of it           |

A system says which one it is by its attribute `step`: None, or the step of its difference equation [s]. So f is a rate
of change in both, and what is scaled by rates serves both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

VectorField = Callable[[Tensor, Tensor], Tensor]
UNTOLD = 0.0
"""The step of a difference equation that is not fitted yet: any."""
ALIKE = 1e-6
"""Part of a time by which it may differ from whole steps."""


class Steps(NamedTuple):
    """Hold the steps by which a time is passed.

    Attributes:
        h: length of each [s].
        number: how many there are.
        difference: whether they are those of a difference equation.
    """

    h: float
    number: int
    difference: bool


class Rates:
    """A function that computes rates of change, with the step of the difference equation that it belongs to.

    Args:
        f: `(x, u) -> dx`.
        step: of that equation [s]; None where it belongs to a differential equation.
    """

    def __init__(self, f: VectorField, step: float | None) -> None:
        self.f, self.step = f, step

    def __call__(self, x: Tensor, u: Tensor) -> Tensor:
        return self.f(x, u)


def time_step_of(f: object) -> float | None:
    """Return the step of a difference equation [s]; None of a differential equation, and of any function.

    Raises:
        TypeError: its attribute `step` is something else.
    """
    step = getattr(f, "step", None)
    if step is None or (isinstance(step, int | float) and not isinstance(step, bool)):
        return step
    raise TypeError(
        f"system {type(f).__name__} has a 'step' of its own, a {type(step).__name__}; step is a word of System: it is "
        "the step of a difference equation [s], and None of a plant dx/dt = f(x, u): name yours otherwise"
    )


def steps_of(step: float | None, seconds: float, substeps: int, name: str = "the system") -> Steps:
    """Return the steps by which a system passes a time.

    Args:
        step: of its difference equation [s]; None of a differential equation.
        seconds: the time [s].
        substeps: Runge-Kutta steps in it, of a differential equation.
        name: what moves, in words.

    Raises:
        ValueError: the time is not made of whole steps of the difference equation.
    """
    if step is None:
        return Steps(seconds / substeps, substeps, False)
    if step == UNTOLD:
        return Steps(seconds, 1, True)
    count = round(seconds / step)
    if count < 1 or abs(count * step - seconds) > ALIKE * seconds:
        raise ValueError(
            f"{name} is a difference equation with a step of {step:g} s and cannot move by {seconds:g} s; allowed are "
            f"whole steps: give env.dt={step:g} or a multiple of it; one that is fitted to data sampled every "
            f"{seconds:g} s can move by that"
        )
    return Steps(step, count, True)


def between(u: Tensor, u_end: Tensor | None, share: float | Tensor) -> Tensor:
    """Return inputs a share of an interval after its start, `(*batch, n_u)`.

    Args:
        u: inputs at its start, `(*batch, n_u)`.
        u_end: inputs at its end, to which they move in a straight line; held if None.
        share: part of the interval.
    """
    return u if u_end is None else torch.lerp(u, u_end.to(u.dtype), share)


def split_delay(delay: float, dt: float) -> tuple[int, float]:
    """Return a delay [s] in whole control periods of dt [s] and the rest [s]."""
    whole = int(delay / dt + 1e-6)
    rest = delay - whole * dt
    return whole, rest if rest > 1e-6 * dt else 0.0


@dataclass(frozen=True)
class Stops:
    """Ends of travel of some positions of a system.

    Attributes:
        positions: Indices of the stopped positions in `x`.
        rates: Indices of their rates in `x`.
        low: Lower end of each position [unit of the position].
        high: Upper end of each position [unit of the position].

    Raises:
        ValueError: The lengths disagree or a lower end is not below its upper end.
    """

    positions: tuple[int, ...]
    rates: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        for field in ("positions", "rates", "low", "high"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        if not len(self.positions) == len(self.rates) == len(self.low) == len(self.high):
            raise ValueError(f"stops need one rate, low and high per position, got {self}; complete the lists")
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError(f"stops need low < high, got low={self.low}, high={self.high}; swap or widen them")

    def rows(self, n_x: int) -> list[tuple[int, int, float, float]]:
        """Return the places of position and rate of each stop of a system with so many states, and its ends.

        Raises:
            ValueError: They are at states that do not exist.
        """
        places = [*self.positions, *self.rates]
        if wrong := [place for place in places if type(place) is not int or not 0 <= place < n_x]:
            raise ValueError(
                f"stops are at state {str(wrong[0])[:40]!r}; allowed are whole numbers from 0 to {n_x - 1}"
            )
        return list(zip(self.positions, self.rates, self.low, self.high, strict=True))

    def apply(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Hold states at the stops.

        The gradient of a stopped position and rate is zero, as the motion of the beam there is.

        Args:
            x: States, `(*batch, n_x)`.

        Returns:
            The states with positions clamped and outward rates zeroed, `(*batch, n_x)`, and whether any stop
            was touched, bool `(*batch,)`.
        """
        columns = list(x.unbind(-1))
        touched = torch.zeros_like(columns[0], dtype=torch.bool)
        for position, rate, low, high in zip(self.positions, self.rates, self.low, self.high, strict=True):
            below, above = columns[position] <= low, columns[position] >= high
            columns[position] = columns[position].clamp(low, high)
            outward = (below & (columns[rate] < 0)) | (above & (columns[rate] > 0))
            columns[rate] = columns[rate].masked_fill(outward, 0.0)
            touched = touched | below | above
        return torch.stack(columns, -1), touched
