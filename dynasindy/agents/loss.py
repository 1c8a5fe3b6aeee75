"""TorchRL's TD3 loss on plain tensors: the same values and gradients in less time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torch.optim import Adam
from torchrl.objectives import TD3Loss as TorchRLTD3Loss
from torchrl.objectives import ValueEstimators


class TD3Loss(TorchRLTD3Loss):
    """TorchRL's TD3 loss for networks that are an `MLP`.

    Parameters, targets, keys and `state_dict` are the parent's. Three things make it faster: the critics are
    one batched product per layer, without vmap; the actor loss evaluates the first critic only, the one it
    uses; and tensors stay outside of TensorDicts on the way. The smoothing noise has its own generator.

    Args:
        policy: the actor, a module around an `MLP`.
        critics: the critics, `ValueOperator`s around `MLP`s of one shape.
        gamma: discount factor per control step [-].
        policy_noise: standard deviation of the target smoothing noise [-].
        noise_clip: bound of the target smoothing noise [-].
        generator: source of the target smoothing noise.
    """

    def __init__(
        self,
        policy: TensorDictModule,
        critics: list[TensorDictModule],
        *,
        gamma: float,
        policy_noise: float,
        noise_clip: float,
        generator: torch.Generator,
    ) -> None:
        super().__init__(
            policy,
            critics,
            bounds=(-1.0, 1.0),
            num_qvalue_nets=len(critics),
            policy_noise=policy_noise,
            noise_clip=noise_clip,
            loss_function="l2",
        )
        self.make_value_estimator(ValueEstimators.TD0, gamma=gamma)
        self.discount, self.generator = gamma, generator
        self._list_layers()

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critics' loss, sum_i mean (Q_i(s, a) - y)^2, and its parts (Fujimoto 2018, Algorithm 1).

        Args:
            tensordict: transitions `(batch,)`.
        """
        target = self.target_value(tensordict.get("next"))
        inputs = tensordict.get("observation"), tensordict.get("action")
        value = self.critic.functional(self.critic_layers, *inputs).squeeze(-1)
        td_error = (value - target).square()
        parts = {"td_error": td_error, "pred_value": value, "target_value": target}
        return td_error.mean(-1).sum(), {name: part.detach() for name, part in parts.items()}

    @torch.no_grad()
    def target_value(self, following: TensorDictBase) -> Tensor:
        """Return y = r + gamma min_i Q'_i(s', pi'(s') + clip(noise)) as `(batch,)` (Fujimoto 2018, eq. 14).

        Args:
            following: the `next` part of transitions `(batch,)`.
        """
        observation = following.get("observation")
        action = self.actor.functional(self.target_actor_layers, observation)
        noise = torch.empty_like(action, device="cpu").normal_(0.0, 1.0, generator=self.generator).to(action.device)
        noise = noise.mul_(self.policy_noise).clamp_(-self.noise_clip, self.noise_clip)
        action = action.add_(noise).clamp_(-1.0, 1.0)
        value = self.critic.functional(self.target_critic_layers, observation, action).amin(0)
        # A truncated episode goes on beyond its last row, so only `terminated` stops the bootstrap.
        value = value.masked_fill_(following.get("terminated"), 0.0)
        return value.mul_(self.discount).add_(following.get("reward")).squeeze(-1)

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the actor's loss, -mean Q_1(s, pi(s)), and Q_1 (Fujimoto 2018, Algorithm 1).

        Args:
            tensordict: transitions `(batch,)`.
        """
        observation = tensordict.get("observation")
        action = self.actor.functional(self.actor_layers, observation)
        first = [layer.first() for layer in self.critic_layers]
        value = self.critic.functional(first, observation, action).squeeze(-1)
        return -value.mean(), {"state_action_value_actor": value.detach()}

    def _list_layers(self) -> None:
        """List the tensors behind the TensorDicts of parameters, which a call would otherwise look up."""
        self.__dict__["actor"] = actor = self.actor_network.module
        self.__dict__["critic"] = critic = self.qvalue_network.module
        # Taken as children: read as attributes they would warn before a target updater exists.
        children = [(name, child) for name, child in self.named_children() if name.endswith("_params")]
        parameters = {name: child.get("module") for name, child in children}
        self.actor_layers = actor.layers(parameters["actor_network_params"])
        self.critic_layers = critic.layers(parameters["qvalue_network_params"])
        self.target_actor_layers = actor.layers(parameters["target_actor_network_params"])
        self.target_critic_layers = critic.layers(parameters["target_qvalue_network_params"])

    def _apply(self, fn: Callable[..., Any], *args: Any) -> TD3Loss:
        moved = super()._apply(fn, *args)
        self._list_layers()  # moving to a device or a dtype replaces tensors
        return moved


Check = Callable[[Tensor, str], None]
"""Takes a loss and its name before any weight moves by it; raises if it is not finite."""


class GradientSteps:
    """Steps of Adam down the two losses of TD3.

    Args:
        loss: the loss module.
        critics: the optimiser of the critics.
        actor: the optimiser of the actor.
    """

    def __init__(self, loss: TD3Loss, critics: Adam, actor: Adam) -> None:
        self.loss, self.optimizers = loss, (critics, actor)

    def critics(self, batch: TensorDictBase, check: Check) -> tuple[Tensor, Tensor]:
        """Take a step of the critics; return their loss and their mean value.

        Args:
            batch: transitions `(batch,)`.
            check: told of the loss before the step.
        """
        loss, parts = self.loss.value_loss(batch)
        check(loss, "the critics' loss")
        self._descend(loss, self.optimizers[0])
        return loss.detach(), parts["pred_value"].mean()

    def actor(self, batch: TensorDictBase, check: Check) -> Tensor:
        """Take a step of the actor; return its loss.

        Args:
            batch: transitions `(batch,)`.
            check: told of the loss before the step.
        """
        loss, _ = self.loss.actor_loss(batch)
        check(loss, "the actor's loss")
        self._descend(loss, self.optimizers[1])
        return loss.detach()

    def _descend(self, loss: Tensor, optimizer: Adam) -> None:
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
