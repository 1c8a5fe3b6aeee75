"""What the loop tells the outside: its place and cost, episodes, and the one hook that logging hangs on."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from tensordict import TensorDict

from dynasindy.dyna.refit import Refit
from dynasindy.planning import ModelError, Planned

FIRST = ("the excitation", "the first planning phase")
"""Phases before the first episode."""


@dataclass
class Place:
    """Where a run stands, and what it has cost so far, without evaluation; a resumed run goes on from there.

    Attributes:
        number: Phases that are done: the excitation with the first fit, the first planning phase, then episodes.
        real_steps: Control periods on the real system, excitation included.
        imagined: Imagined transitions.
        updates: Gradient updates.
    """

    number: int = 0
    real_steps: int = 0
    imagined: int = 0
    updates: int = 0

    def add(self, planned: Planned) -> None:
        """Add the cost of a planning phase."""
        self.imagined += planned.imagined
        self.updates += planned.updates

    @property
    def episodes(self) -> int:
        """Finished real episodes."""
        return max(0, self.number - len(FIRST))

    def summary(self) -> str:
        """Return the latest thing that is done, in words."""
        return f"episode {self.episodes}" if self.episodes else ("nothing", *FIRST)[self.number]

    def present(self, episodes: int) -> str:
        """Return what is under way in a run of so many episodes, in words."""
        if self.number < len(FIRST):
            return FIRST[self.number]
        return "the last evaluation" if self.episodes == episodes else f"episode {self.episodes + 1}"

    def state_dict(self) -> dict[str, int]:
        """Return it as plain numbers."""
        return asdict(self)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        vars(self).update(state)


@dataclass(frozen=True)
class Episode:
    """A finished real episode.

    Attributes:
        number: Counted from 1.
        rollout: What happened, `(T,)`.
        error: Open-loop error of the model on it, before the model was fitted to it.
        one_step: The same of each control period alone.
        trusted: Whether the gate is open.
        refit: What came of the refit after it; None if there was none.
    """

    number: int
    rollout: TensorDict
    error: ModelError
    one_step: ModelError
    trusted: bool
    refit: Refit | None = None


class Callback:
    """Does nothing; subclasses override what they want to hear of."""

    def fitted(self, report: object, excited: TensorDict, place: Place) -> None:
        """Hear of the first fit: its report, the excitation data `(T,)` and the cost so far."""

    def episode(self, episode: Episode, place: Place) -> None:
        """Hear of a finished episode and the cost so far."""

    def reached(self, place: Place) -> None:
        """Hear that a place is reached at which a run can be left and resumed."""
