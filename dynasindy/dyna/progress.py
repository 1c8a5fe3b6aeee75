"""What a command says while it works: lines, and a progress bar over the real episodes."""

from __future__ import annotations

from tensordict import TensorDict

from dynasindy.dyna.callback import Callback, Cost, Episode, Place
from dynasindy.world_models.progress import Steps


def say(*lines: str) -> None:
    """Print lines at once, whoever reads them."""
    print(*lines, sep="\n", flush=True)


class ProgressBar(Callback):
    """Show episode, return, open-loop reward error of the model, real steps and the time left.

    Args:
        episodes: Episodes of the run.
        shown: Show the bar at all.
        place: Where a resumed run goes on.
    """

    def __init__(self, episodes: int, shown: bool = True, place: Place | None = None) -> None:
        place = place or Place()
        self.bar = Steps(
            total=episodes, initial=place.episodes, unit="episode", disable=not shown,
            desc="learning" if place.planned else "planning" if place.excited else "exciting the plant",
        )  # fmt: skip

    def fitted(self, report: object, excited: TensorDict, cost: Cost) -> None:
        """Say that the model is identified."""
        self.bar.set_description("planning")
        self.bar.set_postfix_str(f"real steps {cost.real_steps}")

    def episode(self, episode: Episode, cost: Cost) -> None:
        """Advance by an episode."""
        total = episode.rollout["next", "reward"].sum().item()
        self.bar.set_description("learning")
        self.bar.set_postfix_str(
            f"return {total:.1f}, open-loop reward error {episode.error.reward_error:.3g}, real steps {cost.real_steps}"
        )
        self.bar.update()

    def close(self) -> None:
        """Leave the bar as it is."""
        self.bar.close()
