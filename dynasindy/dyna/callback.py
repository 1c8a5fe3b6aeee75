"""What the loop tells the outside: costs, episodes, and the one hook that logging hangs on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Episode:
    """A finished real episode.

    Attributes:
        number: Counted from 1.
        rollout: What happened, `(T,)`.
        error: Open-loop error of the model on it, before the model was fitted to it.
        trusted: Whether the gate is open.
        refit: What came of the refit after it; None if there was none.
    """

    number: int
    rollout: TensorDict
    error: ModelError
    trusted: bool
    refit: Refit | None = None


class Callback:
    """Does nothing; subclasses override what they want to hear of."""

    def fitted(self, report: object, excited: TensorDict, cost: Cost) -> None:
        """Hear of the first fit: its report, the excitation data `(T,)` and the cost so far."""

    def episode(self, episode: Episode, cost: Cost) -> None:
        """Hear of a finished episode and the cost so far."""


class Callbacks(Callback):
    """Several callbacks, called in order.

    Args:
        callbacks: The callbacks.
    """

    def __init__(self, callbacks: Sequence[Callback]) -> None:
        self.callbacks = list(callbacks)

    def fitted(self, report: object, excited: TensorDict, cost: Cost) -> None:
        """Pass the first fit on."""
        for callback in self.callbacks:
            callback.fitted(report, excited, cost)

    def episode(self, episode: Episode, cost: Cost) -> None:
        """Pass a finished episode on."""
        for callback in self.callbacks:
            callback.episode(episode, cost)
