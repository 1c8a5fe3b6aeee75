"""What the loop tells the outside: its place, costs, episodes, and the one hook that logging hangs on."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from tensordict import TensorDict

from dynasindy.dyna.refit import Refit
from dynasindy.planning import ModelError, Planned


@dataclass
class Cost:
    """What a run has cost so far; evaluation is not part of it.

    Attributes:
        real_steps: Control periods on the real system, excitation included.
        imagined: Imagined transitions.
        updates: Gradient updates.
    """

    real_steps: int = 0
    imagined: int = 0
    updates: int = 0

    def add(self, planned: Planned) -> None:
        """Add the cost of a planning phase."""
        self.imagined += planned.imagined
        self.updates += planned.updates


@dataclass
class Place:
    """Where a run stands; a resumed run goes on from there.

    Attributes:
        excited: Whether the real system was excited and the first model fitted.
        planned: Whether the planning phase before the first episode is done.
        episodes: Finished real episodes.
        cost: What the run has cost so far.
    """

    excited: bool = False
    planned: bool = False
    episodes: int = 0
    cost: Cost = field(default_factory=Cost)

    @property
    def number(self) -> int:
        """Return how many places come before this one."""
        return self.excited + self.planned + self.episodes

    def summary(self) -> str:
        """Return the latest thing that is done, in words."""
        if self.episodes:
            return f"episode {self.episodes}"
        return "the first planning phase" if self.planned else "the excitation" if self.excited else "nothing"

    def present(self, episodes: int) -> str:
        """Return what is under way in a run of so many episodes, in words."""
        if not self.excited:
            return "the excitation"
        if self.episodes == episodes:
            return "the last evaluation"
        return f"episode {self.episodes + 1}" if self.planned else "the first planning phase"

    def past_excitation(self) -> Place:
        """Move past the excitation and the first fit."""
        self.excited = True
        return self

    def past_planning(self) -> Place:
        """Move past the planning phase before the first episode."""
        self.planned = True
        return self

    def past_episode(self, number: int) -> Place:
        """Move past an episode and what follows it."""
        self.episodes = number
        return self

    def state_dict(self) -> dict[str, Any]:
        """Return it as plain numbers."""
        return asdict(self)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.excited, self.planned, self.episodes = state["excited"], state["planned"], state["episodes"]
        self.cost = Cost(**state["cost"])


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

    def fitted(self, report: object, excited: TensorDict, cost: Cost) -> None:
        """Hear of the first fit: its report, the excitation data `(T,)` and the cost so far."""

    def episode(self, episode: Episode, cost: Cost) -> None:
        """Hear of a finished episode and the cost so far."""

    def reached(self, place: Place) -> None:
        """Hear that a place is reached at which a run can be left and resumed."""
