"""The true plant as its own world model: the upper bound of every comparison."""

from __future__ import annotations

import json
from pathlib import Path

from torch import Tensor

from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.models.base import WorldModel


class Oracle(WorldModel):
    """A model that is right from the start and learns nothing.

    Args:
        signature: Names, units and ranges of the plant.
        system: The plant.

    Raises:
        ValueError: The plant has another signature.
    """

    def __init__(self, signature: Signature, system: System) -> None:
        super().__init__(signature)
        if system.signature != signature:
            raise ValueError(
                f"the oracle was given a plant with states {system.signature.state_names} for one with "
                f"{signature.state_names}; give it the plant of the experiment"
            )
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
        Path(path).write_text(json.dumps({"oracle": type(self.system).__name__}, indent=2) + "\n")
