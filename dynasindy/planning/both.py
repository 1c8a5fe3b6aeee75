"""Planning both ways: by the model's gradient, then by imagined transitions for TD3."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.envs import ControlEnv
from dynasindy.limits import Count
from dynasindy.planning.base import Planned, Planner


class GradientThenReplay(Planner):
    """Plan by the model's gradient, then imagine transitions for TD3, which goes on with the same actor.

    Args:
        env: Imagined environment.
        agent: Agent whose actor learns.
        replay: Both storages.
        gradient: Builder of the planning by gradient, called with `env`, `agent`, `replay` and `seed`.
        replayed: Builder of the planning by imagined replay, called alike.
        critic_updates: Updates of the critics alone at the end of a phase, which value the planned actor.
        seed: Seed of both.

    Raises:
        ValueError: `critic_updates` is negative or no whole number.
    """

    def __init__(
        self,
        env: ControlEnv,
        agent: TD3,
        replay: DynaReplay,
        gradient: Callable[..., Planner],
        replayed: Callable[..., Planner],
        critic_updates: Count = 1000,
        seed: int = 0,
    ) -> None:
        if critic_updates < 0 or not float(critic_updates).is_integer():
            raise ValueError(f"planning.critic_updates is {critic_updates}; give a whole number >= 0")
        self.agent, self.replay, self.critic_updates = agent, replay, int(critic_updates)
        self.planners = [build(env=env, agent=agent, replay=replay, seed=seed) for build in (gradient, replayed)]
        super().__init__(min(planner.every for planner in self.planners))

    def plan(self) -> Planned:
        """Plan both ways, the gradient first, so that the transitions are those of its policy."""
        parts = [planner.plan() for planner in self.planners]
        # Critics that do not know the planned actor would pull it away.
        warming = self.critic_updates if parts[0].updates else 0
        for _ in range(warming):
            self.agent.update_critics(self.replay.sample())
        return Planned(sum(p.imagined for p in parts), sum(p.updates for p in parts) + warming)

    def distrust(self) -> None:
        """Drop what was imagined."""
        for planner in self.planners:
            planner.distrust()

    def state_dict(self) -> dict[str, Any]:
        """Return what both planners keep."""
        return {"planners": [planner.state_dict() for planner in self.planners]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for planner, kept in zip(self.planners, state["planners"], strict=True):
            planner.load_state_dict(kept)
