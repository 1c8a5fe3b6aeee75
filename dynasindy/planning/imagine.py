"""Imagining: a TorchRL transform that turns real start states into imagined transitions."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import Transform

from dynasindy.data.replay import LEARN_KEYS
from dynasindy.envs import ControlEnv


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

    Raises:
        ValueError: The horizon is not positive.
    """

    def __init__(
        self,
        env: ControlEnv,
        policy: TensorDictModuleBase,
        horizon: int,
        limit: Tensor | None = None,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        if horizon < 1:
            raise ValueError(f"horizon must be at least 1 control period, got {horizon}; mend planning.horizon")
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
        finite = _finite(rollout)
        self.diverged = len(finite) - int(finite[:, 0].sum())
        if self.limit is not None:
            states = rollout["next", "state"]
            finite = finite & (states.abs() <= self.limit.to(states)).all(-1)
        kept, last = _kept(finite)
        rollout["next", "truncated"] = rollout["next", "done"] = last.unsqueeze(-1)
        rows, kept = rollout.select(*LEARN_KEYS).reshape(-1), kept.flatten()
        # Nearly always all are kept; and each column would look for itself which ones are.
        return rows if bool(kept.all()) else rows[kept.nonzero().squeeze(-1)]


def _finite(rollout: TensorDictBase) -> Tensor:
    """Return which transitions are finite, `(batch, horizon)` bool."""
    following = rollout["next"]
    parts = [following[key] for key in ("state", "observation", "reward")]
    # A sum is a pass over the numbers; of numbers that are finite it may be too large for one.
    if math.isfinite(sum(part.sum() for part in parts)):
        return torch.ones(rollout.batch_size, dtype=torch.bool, device=parts[0].device)
    return torch.cat(parts, -1).isfinite().all(-1)


def _kept(sound: Tensor) -> tuple[Tensor, Tensor]:
    """Return which steps precede the cut and which of them is the last of its rollout, `(batch, horizon)` bool."""
    if bool(sound.all()):
        last = torch.zeros_like(sound)
        last[:, -1] = True
        return sound, last
    kept = sound.long().cumprod(-1).bool()
    after = torch.cat([kept[:, 1:], torch.zeros_like(kept[:, :1])], -1)
    return kept, kept & ~after
