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

    @abstractmethod
    def fit(self, transitions: Transitions) -> Any:
        """Fit to transitions, forgetting earlier data, and return a report."""

    @abstractmethod
    def equations(self, digits: int = 4) -> list[str]:
        """Return one readable equation per state."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write the model to a readable file."""
