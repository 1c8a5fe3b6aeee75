"""What the loop asks of its planning phase."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Planned:
    """What a planning phase cost.

    Attributes:
        imagined: Imagined transitions.
        updates: Gradient updates made inside the phase.
    """

    imagined: int = 0
    updates: int = 0


class Planner(ABC):
    """Dyna's planning phase: improve the policy with imagined experience.

    Args:
        every: Episodes between two planning phases (paper: N).

    Raises:
        ValueError: `every` is not positive.
    """

    learns_by_td3: bool = True
    """Whether TD3 updates the actor after each episode; False where planning alone trains it."""

    def __init__(self, every: int = 1) -> None:
        if every < 1:
            raise ValueError(f"planning.every must be at least 1 episode, got {every}; use planning=none for none")
        self.every = every

    def due(self, episode: int) -> bool:
        """Return whether a planning phase follows real episode `episode`, counted from 1."""
        return episode % self.every == 0

    @abstractmethod
    def plan(self) -> Planned:
        """Plan once with the world model as it is now."""

    @abstractmethod
    def distrust(self) -> None:
        """Drop what came from a model that is no longer trusted."""

    def summary(self) -> str:
        """Return in one line which settings it chose itself; nothing for most planners."""
        return ""

    def state_dict(self) -> dict[str, Any]:
        """Return what a resumed run needs between two planning phases, apart from agent, model and storages.

        A planner that keeps something from phase to phase, as a generator, overrides this and `load_state_dict`.
        """
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # noqa: B027 - most planners keep nothing
        """Restore what `state_dict` returned."""
