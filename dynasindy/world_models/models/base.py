"""A world model is a system that is fitted."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Any

from dynasindy.systems.base import System
from dynasindy.systems.transitions import Transitions


class WorldModel(System):
    """A vector field with the signature of the plant whose transitions it is fitted to.

    Attributes:
        delay: Time between an input of the plant and its effect [s]. The field itself is that of the inputs as they
            take effect.
    """

    delay: float = 0.0

    @property
    def additive(self) -> bool:
        """Whether `update` with new transitions equals `fit` to all of them, and `absorb` is known."""
        return False

    def update(self, transitions: Transitions) -> Any:
        """Fit anew to all earlier data and to new transitions, and return a report.

        Raises:
            NotImplementedError: The model keeps no sums of earlier data.
        """
        raise NotImplementedError(f"{type(self).__name__} is fitted to all transitions at once; use fit")

    def absorb(self, transitions: Transitions) -> None:
        """Add transitions to the data of the next `update`, and leave the model as it is.

        Raises:
            NotImplementedError: The model keeps no sums of earlier data.
        """
        raise NotImplementedError(f"{type(self).__name__} is fitted to all transitions at once; use fit")

    @abstractmethod
    def fit(self, transitions: Transitions) -> Any:
        """Fit to transitions, forgetting earlier data, and return a report."""

    @abstractmethod
    def equations(self, digits: int = 4) -> list[str]:
        """Return one readable equation per state."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write the model to a readable file."""
