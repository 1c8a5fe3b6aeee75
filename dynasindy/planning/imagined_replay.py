"""Planning by imagined replay, as in the paper.

A TorchRL transform turns real start states into imagined transitions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn.functional import pad
from torchrl.envs import Transform

from dynasindy.agents import TD3, DynaReplay
from dynasindy.agents.replay import LEARN_KEYS
from dynasindy.envs import ControlEnv
from dynasindy.limits import Count, Positive, check_memory
from dynasindy.planning.gate import Bound
from dynasindy.progress import report_progress
from dynasindy.safe_io import checked
from dynasindy.sentences import setting
from dynasindy.systems import Diverged


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
        every: Episodes between two planning phases, at least one (paper: N).
    """

    learns_by_td3: bool = True
    """Whether TD3 updates the actor after each episode; False where planning alone trains it."""
    imagined_error: float | None = None
    """Mean error at the end of imagined episodes after the last phase [target ranges]; None where none is known."""

    def __init__(self, every: int = 1) -> None:
        self.every = every

    def due(self, episode: int) -> bool:
        """Return whether a planning phase follows real episode `episode`, counted from 1."""
        return episode % self.every == 0

    @abstractmethod
    def plan(self) -> Planned:
        """Plan once with the world model as it is now."""

    def distrust(self) -> None:  # noqa: B027 - most planners keep nothing
        """Drop what came from a model that is no longer trusted."""

    def settings(self) -> dict[str, Any]:
        """Return which settings it chose itself, and `why`; none for most planners."""
        return {}

    def state_dict(self) -> dict[str, Any]:
        """Return what a resumed run needs between two planning phases, apart from agent, model and storages.

        A planner that keeps something from phase to phase, as a generator, overrides this and `load_state_dict`.
        """
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # noqa: B027 - most planners keep nothing
        """Restore what `state_dict` returned."""


class Imagination(Transform):
    """Write-side transform of a replay buffer: start states go in, imagined transitions are stored.

    `buffer.append_transform(Imagination(env.with_system(world_model), policy, horizon))`, then
    `buffer.extend(starts)` with a batch of `state` stores up to `len(starts) * horizon` transitions. Each start
    gets a fresh reference. The end of an imagined rollout is truncated, never terminated, and a rollout is
    cut before the first transition that is not finite or that ends beyond the limit.

    Attributes:
        diverged: How many of the newest rollouts had no finite transition at all.

    Args:
        env: Imagined environment.
        policy: Policy that acts in it, reading `observation` and writing `action`.
        horizon: Length of a rollout [control periods].
        limit: Largest absolute value of each state, `(n_x,)`; any if None.
    """

    def __init__(
        self,
        env: ControlEnv,
        policy: TensorDictModuleBase,
        horizon: int,
        limit: Tensor | None = None,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        # Held outside nn.Module's registry: the buffer must not own, save or move the environment and policy.
        self.__dict__.update(env=env, policy=policy)
        self.horizon = horizon
        self.limit = limit
        self.diverged = 0

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.imagine(tensordict["state"])

    @torch.no_grad()
    def imagine(self, states: Tensor) -> TensorDict:
        """Roll the policy out in the model from given states.

        Args:
            states: Start states, `(*batch, n_x)`, on the device where it happens.

        Returns:
            Imagined transitions with `LEARN_KEYS`, flat, at most `batch * horizon` of them.
        """
        start = self.env.start_from(states.reshape(-1, states.shape[-1]))
        rollout = self.env.rollout(
            self.horizon, self.policy, auto_reset=False, tensordict=start, break_when_any_done=False
        )
        following = rollout["next"]
        parts = [following[key] for key in ("state", "observation", "reward")]
        sound = torch.cat(parts, -1).isfinite().all(-1)
        self.diverged = len(sound) - int(sound[:, 0].sum())
        if self.limit is not None:
            sound &= (parts[0].abs() <= self.limit.to(parts[0])).all(-1)
        kept = sound.int().cummin(-1).values.bool()
        last = kept & ~pad(kept[:, 1:], (0, 1))
        following["truncated"] = following["done"] = last.unsqueeze(-1)
        # Each column would look for itself which rows of a mask are kept.
        return rollout.select(*LEARN_KEYS).reshape(-1)[kept.flatten().nonzero().squeeze(-1)]


class ImaginedReplay(Planner):
    """Branch imagined rollouts from real states and store them beside the real transitions.

    Args:
        env: Imagined environment, `real.with_system(world_model)`.
        agent: Agent whose exploring policy acts in it.
        replay: Both storages; the `Imagination` transform is appended to the model's.
        rollouts: Imagined rollouts per planning phase (paper: 400 or 800); 0 plans nothing, and leaves plain TD3.
        horizon: Length of a rollout [control periods].
        every: Episodes between two planning phases (paper: N).
        generations: Planning phases whose transitions are kept; all, within the storage, if None.
        state_bound: Multiple of the largest value of each state on the plant beyond which the model is not believed: a
            rollout is cut there.
        seed: Seed of the choice of start states.

    Raises:
        ValueError: A number is out of range, or the rollouts do not fit into memory.
    """

    # Departure: the paper adds imagined transitions to one buffer for good; here those of the newest `generations`
    # of the model are kept, since the models that made the others are gone.

    @checked
    def __init__(
        self,
        env: ControlEnv,
        agent: TD3,
        replay: DynaReplay,
        rollouts: Count = 400,
        horizon: Positive = 100,
        every: Positive = 1,
        generations: Positive | None = 5,
        state_bound: Bound = 1.5,
        seed: int = 0,
    ) -> None:
        super().__init__(every)
        self.agent, self.env, self.replay, self.rollouts, self.generations = agent, env, replay, rollouts, generations
        self.state_bound = state_bound
        self.made: list[int] = []
        self.generator = torch.Generator().manual_seed(seed)
        check_memory(
            4.0 * rollouts * horizon * (2 * env.task.n_o + (2 + env.substeps) * env.system.signature.n_x),
            f"{setting('planning.rollouts')}={rollouts} of {setting('planning.horizon')}={horizon} periods",
        )
        self.imagination = Imagination(env, agent.explore_imagined, horizon)
        replay.model.append_transform(self.imagination)

    def plan(self) -> Planned:
        """Imagine `rollouts` rollouts with the model and policy as they are now.

        Raises:
            Diverged: No rollout has a single finite transition.
        """
        if not self.rollouts:
            return Planned()
        report_progress("planning", note=f"{self.rollouts} imagined rollouts")
        if self.generations is not None:
            self.replay.keep_imagined(sum(self.made[max(0, len(self.made) + 1 - self.generations) :]))
        real = self.replay.real_in_order()
        rows = len(real) - 1 - torch.randint(len(real), (self.rollouts,), generator=self.generator)
        self.imagination.limit = self.state_bound * real["next", "state"].abs().amax(0)
        starts = TensorDict({"state": real["state"][rows]}, [self.rollouts]).to(self.replay.device)
        self.made.append(len(self.replay.model.extend(starts)))
        if self.imagination.diverged == self.rollouts:
            self.agent.check()  # its weights may be the reason
            raise Diverged(
                f"planning by imagined replay: all {self.rollouts} rollouts, from real states, diverged in their first "
                "control period, so nothing is learned from the model; excite longer or with less noise, check the "
                "reward, or close the gate (gate.close_above)"
            )
        return Planned(imagined=self.made[-1])

    def distrust(self) -> None:
        """Empty the model storage."""
        self.replay.keep_imagined(0)

    def state_dict(self) -> dict[str, Any]:
        """Return how much each phase imagined, and the generator; the limit is set anew by each phase."""
        return {"made": list(self.made), "generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.made = list(state["made"])
        self.generator.set_state(state["generator"])
