"""Imagining: a TorchRL transform that turns real start states into imagined transitions."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import Transform

from dynasindy.data.replay import LEARN_KEYS
from dynasindy.envs import ControlEnv


class Near:
    """Tell which states and actions lie near real ones.

    Args:
        states: Real states, `(n, n_x)`.
        actions: The actions taken there, `(n, n_u)`.
        distance: Largest Euclidean distance to the nearest, each column divided by its largest absolute value.

    Raises:
        ValueError: `distance` is not positive.
    """

    def __init__(self, states: Tensor, actions: Tensor, distance: float) -> None:
        if not distance > 0:
            raise ValueError(f"distance must be positive, got {distance}; mend planning.distance, or give null")
        self.real = torch.cat([states.float(), actions.float()], -1)
        self.scale = self.real.abs().amax(0).clamp_min(1e-9)
        self.distance = distance

    def __call__(self, states: Tensor, actions: Tensor) -> Tensor:
        """Return which of `states` `(*batch, n_x)` and `actions` `(*batch, n_u)` are near, `(*batch,)` bool."""
        points = torch.cat([states.float(), actions.float()], -1) / self.scale
        apart = torch.cdist(points.flatten(0, -2), self.real / self.scale).amin(-1)
        return (apart <= self.distance).reshape(points.shape[:-1])


class Imagination(Transform):
    """Write-side transform of a replay buffer: start states go in, imagined transitions are stored.

    `buffer.append_transform(Imagination(env.with_system(world_model), policy, horizon))`, then
    `buffer.extend(starts)` with a batch of `state` stores up to `len(starts) * horizon` transitions. Each start
    gets a fresh reference. The end of an imagined rollout is truncated, never terminated, and a rollout is
    cut before the first state that is not finite or lies outside `limit`, and before the first step that does
    not begin `near` real data.

    Args:
        env: Imagined environment.
        policy: Policy that acts in it, reading `observation` and writing `action`.
        horizon: Length of a rollout [control periods].
        limit: Largest absolute value of each state, `(n_x,)`; no limit if omitted.
        near: What counts as near the data; everything if omitted.

    Raises:
        ValueError: The horizon is not positive.
    """

    def __init__(
        self,
        env: ControlEnv,
        policy: TensorDictModuleBase,
        horizon: int,
        limit: Tensor | None = None,
        near: Near | None = None,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        if horizon < 1:
            raise ValueError(f"horizon must be at least 1 control period, got {horizon}; mend planning.horizon")
        # Held outside nn.Module's registry: the buffer must not own, save or move the environment and policy.
        self.__dict__.update(env=env, policy=policy)
        self.horizon = horizon
        self.limit = limit
        self.near = near

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.imagine(tensordict["state"])

    @torch.no_grad()
    def imagine(self, states: Tensor) -> TensorDict:
        """Roll the policy out in the model from given states.

        Args:
            states: Start states, `(*batch, n_x)`.

        Returns:
            Imagined transitions with `LEARN_KEYS`, flat, at most `batch * horizon` of them.
        """
        starts = self.env.start_from(states.reshape(-1, states.shape[-1]))
        rollout = self.env.rollout(
            self.horizon, self.policy, auto_reset=False, tensordict=starts, break_when_any_done=False
        )
        known = None if self.near is None else self.near(rollout["state"], rollout["action"])
        kept, last = _kept(rollout["next"], self.limit, known)
        rollout["next", "truncated"] = rollout["next", "done"] = last.unsqueeze(-1)
        return rollout.select(*LEARN_KEYS)[kept]


def _kept(following: TensorDictBase, limit: Tensor | None, known: Tensor | None) -> tuple[Tensor, Tensor]:
    """Return which steps precede the cut and which of them is the last of its rollout, `(batch, horizon)` bool."""
    states = following["state"]
    sound = torch.cat([states, following["observation"], following["reward"]], -1).isfinite().all(-1)
    if limit is not None:
        sound = sound & (states.abs() <= limit.to(states)).all(-1)
    if known is not None:
        sound = sound & known
    kept = sound.long().cumprod(-1).bool()
    after = torch.cat([kept[:, 1:], torch.zeros_like(kept[:, :1])], -1)
    return kept, kept & ~after
