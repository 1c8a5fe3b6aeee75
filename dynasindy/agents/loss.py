"""TD3's losses on plain tensors, and steps of Adam down them: by torch, and as machine code on the CPU.

At the sizes that control needs, a good half of an update is what torch does around its products. `c/td3.c`, with the
networks of `c/perceptron.c`, does the same arithmetic on the same tensors without it: weights, targets, the moments of
Adam and the smoothing noise are torch's and stay where they are. A step equals that of `GradientSteps` up to rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torch.optim import Adam
from torchrl.objectives import TD3Loss as TorchRLTD3Loss
from torchrl.objectives import ValueEstimators

from dynasindy.agents.networks import LINE, Layer, NetworkPointers, Pointers, line_of, network_pointers, pointers_to


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
        first = [Layer(*(tensor.detach()[0] for tensor in layer)) for layer in self.critic_layers]
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


class MachineSteps(GradientSteps):
    """Steps of Adam down the two losses of TD3, as machine code; tensors are read where they lay when it was made."""

    def __init__(self, code: ctypes.CDLL, loss: TD3Loss, critics: Adam, actor: Adam) -> None:
        super().__init__(loss, critics, actor)
        self._code = code
        self._code.room.restype = ctypes.c_long
        learning = loss.actor_layers, loss.critic_layers
        gradients = [[Layer(*map(torch.zeros_like, layer)) for layer in layers] for layers in learning]
        targets = loss.target_actor_layers, loss.target_critic_layers
        networks = [*learning, *targets, *gradients]
        first, last = loss.actor_layers[0].weight, loss.critic_layers[-1].bias
        self.n_obs, self.n_u = first.shape[-1], loss.actor_layers[-1].bias.shape[-1]
        sizes = self.n_obs, self.n_u, last.shape[0]
        self._agent = _Agent(
            *sizes, loss.discount, loss.policy_noise, loss.noise_clip, *map(network_pointers, networks)
        )
        self._actor_weights = _weights(actor, loss.actor_layers, gradients[0])
        self._critic_weights = _weights(critics, loss.critic_layers, gradients[1])
        moments = [state[name] for each in (critics, actor) for state in each.state.values() for name in state]
        self._held = networks, moments  # what the code points to is kept alive
        self._room = torch.empty(0)

    def critics(self, batch: TensorDictBase, check: Check) -> tuple[Tensor, Tensor]:
        """Take a step of the critics, see `GradientSteps`."""
        following = batch.get("next")
        seen, acted = self._tensor(batch, "observation", self.n_obs), self._tensor(batch, "action", self.n_u)
        then, reward = self._tensor(following, "observation", self.n_obs), self._tensor(following, "reward", 1)
        ended = self._tensor(following, "terminated", 1, torch.bool)
        noise = torch.empty_like(acted).normal_(0.0, 1.0, generator=self.loss.generator)
        loss, value = ctypes.c_double(), ctypes.c_double()
        given = _Batch(len(seen), *(tensor.data_ptr() for tensor in (seen, acted, then, reward, noise, ended)))
        found = ctypes.byref(loss), ctypes.byref(value)
        self._code.learn_values(ctypes.byref(self._agent), ctypes.byref(given), self._place(len(seen)), *found)
        error = torch.tensor(loss.value)
        check(error, "the critics' loss")
        self._step(self._critic_weights, self.optimizers[0])
        return error, torch.tensor(value.value)

    def actor(self, batch: TensorDictBase, check: Check) -> Tensor:
        """Take a step of the actor, see `GradientSteps`."""
        seen, loss = self._tensor(batch, "observation", self.n_obs), ctypes.c_double()
        given = _Batch(len(seen), seen.data_ptr())
        room = self._place(len(seen))
        self._code.learn_policy(ctypes.byref(self._agent), ctypes.byref(given), room, ctypes.byref(loss))
        error = torch.tensor(loss.value)
        check(error, "the actor's loss")
        self._step(self._actor_weights, self.optimizers[1])
        return error

    def _step(self, weights: _Weights, optimizer: Adam) -> None:
        group = optimizer.param_groups[0]
        numbers = group["lr"], *group["betas"], group["eps"]
        self._code.descend(ctypes.byref(weights), *map(ctypes.c_double, numbers))

    def _tensor(self, batch: TensorDictBase, key: str, width: int, dtype: torch.dtype = torch.float32) -> Tensor:
        # The code reads as many numbers as it is told, whatever is there.
        tensor: Tensor = batch.get(key)
        whole = len(tensor) and tensor.shape == (batch.batch_size[0], width)
        if not whole or tensor.dtype != dtype or not tensor.is_cpu:
            raise ValueError(
                f"A batch of TD3 holds '{key}' as {tuple(tensor.shape)}, {tensor.dtype}, on {tensor.device}; give "
                f"{(batch.batch_size[0], width)}, one row at least, {dtype}, on the CPU."
            )
        return tensor.contiguous()

    def _place(self, rows: int) -> ctypes.c_void_p:
        needed = self._code.room(ctypes.byref(self._agent), ctypes.c_long(rows)) + LINE // 4
        if len(self._room) < needed:
            self._room = torch.zeros(needed)
        return line_of(self._room)


class _Agent(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int) for name in ("n_obs", "n_u", "critics")),
        *((name, ctypes.c_float) for name in ("gamma", "sigma", "clip")),
        *((name, NetworkPointers) for name in ("actor", "critic", "target_actor", "target_critic")),
        *((name, NetworkPointers) for name in ("actor_gradient", "critic_gradient")),
    )


class _Batch(ctypes.Structure):
    _fields_ = (
        ("rows", ctypes.c_long),
        *((name, ctypes.c_void_p) for name in ("observation", "action", "next_observation", "reward")),
        *((name, ctypes.c_void_p) for name in ("noise", "terminated")),
    )


class _Weights(ctypes.Structure):
    _fields_ = (
        ("tensors", ctypes.c_int),
        ("sizes", ctypes.POINTER(ctypes.c_long)),
        *((name, Pointers) for name in ("weight", "gradient", "mean", "square", "steps")),
    )


def _weights(optimizer: Adam, layers: Sequence[Layer], gradients: Sequence[Layer]) -> _Weights:
    """Return what a step of Adam reads and writes; what it has not made yet is made as it would."""
    flat, slopes = (list(chain.from_iterable(each)) for each in (layers, gradients))
    owners = {parameter.data_ptr(): parameter for parameter in optimizer.param_groups[0]["params"]}
    states = [optimizer.state[owners[tensor.data_ptr()]] for tensor in flat]
    for tensor, state in zip(flat, states, strict=True):
        if not state:
            state["step"] = torch.zeros((), dtype=torch.float32)
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(tensor), torch.zeros_like(tensor)
    moments = ([state[name] for state in states] for name in ("exp_avg", "exp_avg_sq", "step"))
    sizes = (ctypes.c_long * len(flat))(*(tensor.numel() for tensor in flat))
    return _Weights(len(flat), sizes, *map(pointers_to, (flat, slopes, *moments)))
