"""A world model is a system that is fitted, and predicts one step ahead or open loop."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.safe_io import write_json
from dynasindy.systems.base import Signature, System
from dynasindy.systems.integrators import moved, trajectory
from dynasindy.systems.transitions import Transitions


class WorldModel(System):
    """A vector field with the signature of the plant whose transitions it is fitted to.

    Attributes:
        delay: Time between an input of the plant and its effect [s]. The field itself is that of the inputs as they
            take effect.
    """

    delay: float = 0.0

    def kept(self) -> Callable[[], object]:
        """Return what takes the model back to what it has learnt so far, its `state_dict`, when called."""
        return partial(self.load_state_dict, copy.deepcopy(self.state_dict()))

    @abstractmethod
    def fit(self, transitions: Transitions) -> Any:
        """Fit to transitions, forgetting earlier data, and return a report."""

    @abstractmethod
    def equations(self, digits: int = 4) -> list[str]:
        """Return one readable equation per state."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write the model to a readable file."""


class Oracle(WorldModel):
    """A model that is right from the start and learns nothing.

    Args:
        signature: Names, units and ranges of the plant.
        system: The plant, which has this signature.
    """

    def __init__(self, signature: Signature, system: System) -> None:
        super().__init__(signature)
        self.system = system

    @property
    def step(self) -> float | None:
        """Step of the difference equation that it is [s]; None of a differential equation."""
        return self.system.step

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return the plant's dx/dt, `(*batch, n_x)`."""
        dx: Tensor = self.system(x, u)
        return dx

    def fit(self, transitions: Transitions) -> None:
        """Do nothing: the plant needs no data."""

    def equations(self, digits: int = 4) -> list[str]:
        """Name the plant; its equations stand in its own file."""
        return [f"{name}' = that of {type(self.system).__name__}" for name in self.signature.state_names]

    def save(self, path: str | Path) -> None:
        """Write which plant this is."""
        write_json(path, {"oracle": type(self.system).__name__})


def one_step_error(model: System, data: Transitions, substeps: int = 1) -> Tensor:
    """Return the root-mean-square one-step error of each state, relative to its standard deviation, `(n_x,)`."""
    with torch.no_grad():
        x = moved(model, data.x, data.u, data.dt, substeps, data.u_end)
    return (x - data.x_next).square().mean(0).sqrt() / data.x_next.std(0).clamp_min(1e-300)


def open_loop(model: System, data: Transitions, substeps: int = 1) -> Tensor:
    """Predict each segment from its first state with the logged inputs.

    Args:
        model: vector field.
        data: transitions, N rows.
        substeps: Runge-Kutta steps between two samples.

    Returns:
        States in the place of `data.x_next`, `(N, n_x)`; what runs away is not finite or very large.
    """
    begins = data.begins().nonzero().flatten().tolist()
    with torch.no_grad():
        parts = [
            trajectory(model, data.x[first], u, data.dt, substeps, u_end)
            for first, last in pairwise([*begins, len(data)])
            for u, u_end in [data.inputs_of(slice(first, last))]
        ]
    return torch.cat(parts) if parts else torch.empty_like(data.x_next)


def nrmse(predicted: Tensor, data: Transitions) -> Tensor:
    """Return the root-mean-square error of each state relative to its standard deviation, `(n_x,)`.

    Samples that were lost do not count; the error of a state that was never measured is infinite.
    """
    squares = (predicted - data.x_next).square().nan_to_num(torch.inf, torch.inf)
    error = torch.where(data.x_next.isnan(), torch.nan, squares).nanmean(0)
    return (error.sqrt() / variance(data.x_next).sqrt().clamp_min(1e-300)).nan_to_num(torch.inf, torch.inf)


def variance(x: Tensor) -> Tensor:
    """Return the variance of each column of `(N, n)` over samples that are not NaN, `(n,)`; NaN of fewer than two."""
    return (x - x.nanmean(0)).square().nansum(0) / ((~x.isnan()).sum(0) - 1)
