"""What a run says while it works: the episode, what came of the last one, and the steps so far."""

from __future__ import annotations

from tensordict import TensorDict

from dynasindy.dyna.callback import Callback, Cost, Episode, Place
from dynasindy.told import tell


class Progress(Callback):
    """Tell episode, return, open-loop reward error of the model and real steps.

    Args:
        episodes: Episodes of the run.
        place: Where a resumed run goes on.
    """

    def __init__(self, episodes: int, place: Place | None = None) -> None:
        self.episodes, self.words = episodes, ""
        self._tell((place or Place()).episodes)

    def fitted(self, report: object, excited: TensorDict, cost: Cost) -> None:
        """Tell how long the plant was excited."""
        self.words = f"real steps {cost.real_steps}"
        self._tell(0)

    def episode(self, episode: Episode, cost: Cost) -> None:
        """Tell what came of an episode."""
        total = episode.rollout["next", "reward"].sum().item()
        self.words = (
            f"return {total:.1f}, open-loop reward error {episode.error.reward_error:.3g}, real steps {cost.real_steps}"
        )
        self._tell(episode.number)

    def _tell(self, done: int) -> None:
        tell("run", done, self.episodes, "episodes", self.words, around=True)
