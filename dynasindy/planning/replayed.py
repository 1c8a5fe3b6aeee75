"""Planning by imagined replay, as in the paper, and no planning, which leaves plain TD3."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.envs import ControlEnv
from dynasindy.planning.base import Planned, Planner
from dynasindy.planning.imagine import Imagination


class NoPlanning(Planner):
    """Plan nothing: the loop is then TD3 on real data alone.

    Args:
        **parts: What other planners are built from; not used.
    """

    def __init__(self, **parts: object) -> None:
        super().__init__()

    def due(self, episode: int) -> bool:
        """Return False: there is no planning phase, and the model is not fitted again."""
        return False

    def plan(self) -> Planned:
        """Return a cost of zero."""
        return Planned()

    def distrust(self) -> None:
        """Do nothing."""


class ImaginedReplay(Planner):
    """Branch imagined rollouts from real states and store them beside the real transitions.

    Args:
        env: Imagined environment, `real.with_system(world_model)`.
        agent: Agent whose exploring policy acts in it.
        replay: Both storages; the `Imagination` transform is appended to the model's.
        rollouts: Imagined rollouts per planning phase (paper: 400 or 800); 0 plans nothing.
        horizon: Length of a rollout [control periods].
        every: Episodes between two planning phases (paper: N).
        evict: Drop what older models imagined before each phase.
        reach: Cut a rollout where a state exceeds this multiple of the largest value seen on the plant.
        seed: Seed of the choice of start states.

    Raises:
        ValueError: A number is out of range.
    """

    # Departure: the paper adds imagined transitions to one buffer for good; with `evict` those of the newest
    # model alone are kept, since the models that made the others are gone.

    def __init__(
        self,
        env: ControlEnv,
        agent: TD3,
        replay: DynaReplay,
        rollouts: int = 400,
        horizon: int = 20,
        every: int = 1,
        evict: bool = True,
        reach: float = 1.5,
        seed: int = 0,
    ) -> None:
        super().__init__(every)
        if rollouts < 0 or not reach > 0:
            raise ValueError(f"planning needs rollouts >= 0 and reach > 0, got {rollouts} and {reach}; mend planning")
        self.replay, self.rollouts, self.evict, self.reach = replay, rollouts, evict, reach
        self.generator = torch.Generator().manual_seed(seed)
        self.imagination = Imagination(env, agent.explore_imagined, horizon)
        replay.model.append_transform(self.imagination)

    def plan(self) -> Planned:
        """Imagine `rollouts` rollouts with the model and policy as they are now."""
        if not self.rollouts:
            return Planned()
        if self.evict:
            self.replay.model.empty()
        real = self.replay.real[:]
        rows = torch.randint(len(real), (self.rollouts,), generator=self.generator)
        self.imagination.limit = self.reach * real["next", "state"].abs().amax(0)
        starts = TensorDict({"state": real["state"][rows]}, [self.rollouts])
        return Planned(imagined=len(self.replay.model.extend(starts)))

    def distrust(self) -> None:
        """Empty the model storage."""
        self.replay.model.empty()
