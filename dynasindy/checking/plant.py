"""The model in the place of the plant, with coefficients that may differ from row to row."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.control.controller import ControlSetup
from dynasindy.sindy import SindyModel
from dynasindy.systems import Stops, integrate, steps_needed
from dynasindy.systems.steps import Rates

FINE = 1e-6
"""How far from each other a control period and one of steps half as long may end [ranges of a state]."""
TRIED, AROUND = 256, 2.0
"""States, drawn at random, whose periods are compared, and how far from zero they may be [ranges of a state]."""


def step_for(model: SindyModel, setup: ControlSetup, finest: float) -> float:
    """Return the longest Runge-Kutta step by which a model is moved well [s]: a shorter one ends periods where it does.

    Args:
        model: The model; what moves slowly is passed in few steps, however long a control period is.
        setup: Control period, steps to begin with, stops and targets of its controller.
        finest: A step that is short enough for whatever moves [s].
    """
    generator = torch.Generator().manual_seed(0)
    size = torch.tensor(model.signature.x_scale, dtype=torch.float64)
    x, u = (
        2 * torch.rand(TRIED, width, generator=generator, dtype=torch.float64) - 1
        for width in (model.signature.n_x, model.signature.n_u)
    )
    low, high = setup.task.input_limits.double()
    x, u = AROUND * size * x, low + (high - low) * (u + 1) / 2
    number, _ = steps_needed(model, x, u, setup.dt, max(1, setup.substeps), setup.stops, FINE)
    return min(finest, setup.dt) if number is None else max(min(finest, setup.dt), setup.dt / number)


@dataclass(frozen=True)
class Plant:
    """A model that is moved on by one control period at a time, its inputs as late as it says.

    Attributes:
        model: The identified model.
        dt: Control period [s].
        step: Longest Runge-Kutta step [s].
        stops: Mechanical stops, if any.
        coefficients: Xi of each row of a batch, `(rows, n_features, n_x)`; None for those of the model.
        gain: Factor on the effect of all inputs, or one for each row, `(rows, 1)`.
        later: How much later all inputs act than the model says [s].
    """

    model: SindyModel
    dt: float
    step: float
    stops: Stops | None = None
    coefficients: Tensor | None = None
    gain: float | Tensor = 1.0
    later: float = 0.0

    @property
    def late(self) -> tuple[int, float]:
        """Delay of the inputs, in whole control periods and the rest [s]."""
        delay = self.model.delay + self.later
        whole = int(delay / self.dt + 1e-6)
        rest = delay - whole * self.dt
        return whole, rest if rest > 1e-6 * self.dt else 0.0

    @property
    def pending(self) -> int:
        """How many inputs of earlier periods still have to act."""
        whole, rest = self.late
        return whole + (rest > 0)

    def rates(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(rows, n_x)` or `(rows, n, n_x)`, of as many states under inputs that act."""
        if self.coefficients is None:
            dx: Tensor = self.model(x, u)
            return dx
        theta, xi = self.model.library(x, u), self.coefficients
        return (theta.unsqueeze(1) @ xi).squeeze(1) if theta.dim() == 2 else theta @ xi

    def period(self, x: Tensor, inputs: Tensor) -> Tensor:
        """Return the states one control period later.

        Args:
            x: States, `(*batch, n_x)`.
            inputs: Inputs of earlier periods that are pending and that of this one, `(*batch, pending + 1, n_u)`.
        """
        whole, rest = self.late
        if rest:
            x = self._flow(x, inputs[..., -whole - 2, :], rest)
        return self._flow(x, inputs[..., -whole - 1, :], self.dt - rest)

    def _flow(self, x: Tensor, u: Tensor, seconds: float) -> Tensor:
        steps = max(1, math.ceil(seconds / self.step - 1e-6))
        rates = Rates(self.rates, self.model.step)
        return integrate(rates, x, self.gain * u, seconds, steps, self.stops)[0][..., -1, :]
