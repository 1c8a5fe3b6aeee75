"""Twin delayed deep deterministic policy gradient (TD3), on TorchRL's loss module and target updater.

Source: Fujimoto, van Hoof, Meger, "Addressing Function Approximation Error in Actor-Critic Methods", 2018
(Algorithm 1 and its equations), with the hyperparameters of the paper's table.

| Name                     | Symbol     | Unit   | Where                                             |
| ------------------------ | ---------- | ------ | ------------------------------------------------- |
| `gamma`                  | gamma      | -      | target y = r + gamma min_i Q'_i                   |
| `tau`                    | tau        | -      | theta' <- tau theta + (1 - tau) theta'            |
| `policy_delay`           | d          | update | the actor learns every d-th critic update         |
| `target_update_interval` | -          | update | "Target Update Frequency", apart from d           |
| `policy_noise`           | sigma~     | -      | smoothing noise on the target action              |
| `noise_clip`             | c          | -      | bound of the smoothing noise                      |
| `exploration_noise`      | sigma      | -      | noise on real actions, decaying by `noise_decay`  |
"""

import copy
import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import ValueOperator
from torchrl.objectives import SoftUpdate

from dynasindy.agents.loss import GradientSteps, MachineSteps, TD3Loss
from dynasindy.agents.networks import MLP, actor
from dynasindy.limits import Positive
from dynasindy.safe_io import checked_class
from dynasindy.systems import Diverged
from dynasindy.systems.compiler import c_text, find_library

CHECK_EVERY = 100
"""Updates between two looks at the losses on a device that works apart from the CPU, which each look would halt."""


@checked_class
@dataclass(frozen=True, config={"strict": True, "allow_inf_nan": False, "extra": "forbid"})
class Hyperparameters:
    """Everything that can be set about the agent; the defaults are the paper's, then TD3's.

    Attributes:
        hidden: widths of the hidden layers of actor and critics.
        actor_lr: learning rate of the actor [1/update].
        critic_lr: learning rate of the critics [1/update].
        gamma: discount factor per control step [-].
        tau: target smooth factor [-].
        policy_delay: critic updates per actor update.
        target_update_interval: critic updates per target update.
        policy_noise: standard deviation of the target smoothing noise [-].
        noise_clip: bound of the target smoothing noise [-].
        exploration_noise: standard deviation of the exploration noise at first [-].
        noise_decay: share of the exploration noise lost per real control step [-].
        noise_min: lower bound of the exploration noise [-].
        critics: number of critics, of which the target takes the smallest.
        policy_average: share of the actor that enters the deployed average per actor update;
            0 deploys the actor itself.
        machine_code: learn by machine code on one core of the CPU, if there is a C compiler.

    Raises:
        ValueError: a value lies outside its range.
    """

    hidden: Annotated[Sequence[Positive], Field(min_length=1)] = (400, 300)
    actor_lr: Annotated[float, Field(gt=0)] = 1e-4
    critic_lr: Annotated[float, Field(gt=0)] = 1e-4
    gamma: Annotated[float, Field(gt=0, le=1)] = 0.995
    tau: Annotated[float, Field(gt=0, le=1)] = 0.005
    policy_delay: Positive = 2
    target_update_interval: Positive = 10
    policy_noise: Annotated[float, Field(ge=0)] = 0.2
    noise_clip: Annotated[float, Field(ge=0)] = 0.5
    exploration_noise: Annotated[float, Field(ge=0)] = 0.15
    noise_decay: Annotated[float, Field(ge=0, lt=1)] = 1e-3
    noise_min: Annotated[float, Field(ge=0)] = 0.0
    critics: Annotated[int, Field(ge=2, le=100)] = 2  # the upper limit is arbitrary
    policy_average: Annotated[float, Field(ge=0, lt=1)] = 0.0
    machine_code: bool = True


_QUIET = (ExplorationType.DETERMINISTIC, ExplorationType.MEAN, ExplorationType.MODE)


class DecayingGaussian(TensorDictModuleBase):
    """Add Gaussian noise to `action` and clip it to [-1, 1].

    Each call is one control step: afterwards `sigma <- max(minimum, sigma (1 - decay))`, the rule of the
    toolbox behind the paper's "Noise 0.15, Noise Decay Rate 1e-3". Nothing is added inside
    `set_exploration_type(ExplorationType.DETERMINISTIC)`.

    Args:
        sigma: standard deviation at first [-].
        decay: share of `sigma` lost per step [-].
        minimum: lower bound of `sigma` [-].
        seed: seed of the noise's own generator.

    Raises:
        ValueError: `sigma` is less than `minimum`.
    """

    in_keys: ClassVar[list[str]] = ["action"]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(self, sigma: float = 0.15, decay: float = 1e-3, minimum: float = 0.0, seed: int = 0) -> None:
        if sigma < minimum:
            raise ValueError(f"agent.noise_min is {minimum}, above agent.exploration_noise, {sigma}; lower it")
        super().__init__()
        self.sigma, self.decay, self.minimum = float(sigma), decay, minimum
        # In the CPU's memory, so that a seed draws the same noise for every device.
        self.generator = torch.Generator().manual_seed(seed)

    def perturb(self, action: Tensor) -> Tensor:
        """Return `action (*batch, n_u)` plus noise, within [-1, 1]; itself inside a deterministic exploration type."""
        if exploration_type() in _QUIET:
            return action
        noise = torch.randn(action.shape, generator=self.generator, dtype=action.dtype).to(action.device)
        return (action + self.sigma * noise).clamp(-1.0, 1.0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Perturb `action` in place and decay the noise."""
        tensordict.set("action", self.perturb(tensordict.get("action")))
        if exploration_type() not in _QUIET:
            self.sigma = max(self.minimum, self.sigma * (1.0 - self.decay))
        return tensordict

    def frozen(self) -> TensorDictModule:
        """Return the same noise without its decay, which counts steps of the real plant, for imagined steps.

        Sigma and generator stay with this module, which is no child of the one returned.
        """
        return TensorDictModule(self.perturb, in_keys=["action"], out_keys=["action"])

    def get_extra_state(self) -> dict[str, Any]:
        """Return what `state_dict` keeps: the present sigma and the generator."""
        return {"sigma": self.sigma, "generator": self.generator.get_state()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `get_extra_state` returned."""
        self.sigma = state["sigma"]
        self.generator.set_state(state["generator"])


class TD3:
    """Agent: a policy, its noise, and the update that improves it.

    Attributes:
        policy: `observation` to `action`, deterministic.
        explore: `policy` plus decaying noise, for the real plant; each call is one control step.
        explore_imagined: `policy` plus the present noise, for imagined rollouts, which do not count as steps.
        deployed: the policy to evaluate and to save: `policy`, or its running average.
        loss: the TorchRL loss module with all parameters and targets.
        settings: the hyperparameters.
        updates: number of updates so far.

    Args:
        n_obs: width of `observation`.
        n_u: width of `action`.
        seed: seed of the initial weights and of both noises.
        device: device of all networks; random numbers are drawn on the CPU.
        **settings: fields of `Hyperparameters`.

    Raises:
        ValueError: a setting does not exist, or lies outside its range.
    """

    def __init__(
        self,
        n_obs: int,
        n_u: int,
        seed: int = 0,
        device: torch.device | str = "cpu",
        **settings: Annotated[Any, Hyperparameters],
    ) -> None:
        self.settings = s = Hyperparameters(**settings)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.policy = actor(n_obs, n_u, s.hidden).to(device)
            networks = [MLP(n_obs + n_u, 1, s.hidden).to(device) for _ in range(s.critics)]
        critics = [ValueOperator(network, in_keys=["observation", "action"]) for network in networks]
        generator = torch.Generator().manual_seed(seed + 1)
        self.loss = TD3Loss(
            self.policy,
            critics,
            gamma=s.gamma,
            policy_noise=s.policy_noise,
            noise_clip=s.noise_clip,
            generator=generator,
        )
        self.noise = DecayingGaussian(s.exploration_noise, s.noise_decay, s.noise_min, seed + 2)
        self.explore = TensorDictSequential(self.policy, self.noise)
        self.explore_imagined = TensorDictSequential(self.policy, self.noise.frozen())
        self.deployed = copy.deepcopy(self.policy).requires_grad_(False) if s.policy_average else self.policy
        self.target_updater = SoftUpdate(self.loss, tau=s.tau)
        following = self.target_updater._targets, self.target_updater._sources
        self._targets, self._sources = ([p.detach() for p in side.values(True, True)] for side in following)
        self.actor_optimizer = self._optimizer(self.loss.actor_network_params, s.actor_lr)
        self.critic_optimizer = self._optimizer(self.loss.qvalue_network_params, s.critic_lr)
        self._device = device
        self.updates = 0
        self.actor_loss = torch.zeros((), device=device)
        self._made: GradientSteps | None = None
        self._read: list[object] = []

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one step of TD3 on a batch of transitions (Fujimoto 2018, Algorithm 1).

        Args:
            batch: `observation`, `action` and `next` transitions `(batch,)`, as `DynaReplay.sample` returns.

        Returns:
            Scalars on the agent's device: `critic_loss`, `q_value`, and the latest `actor_loss`.

        Raises:
            Diverged: a loss is not finite; no weight of the network that it is of has moved by it on the CPU.
            ValueError: a tensor of the batch has another shape or kind than the networks take.
        """
        s = self.settings
        self.updates += 1

        critic_loss, value = self._steps.critics(batch, self._require_finite)

        if self.updates % s.policy_delay == 0:
            self.actor_loss = self._steps.actor(batch, self._require_finite)
            if s.policy_average:
                averaged, latest = list(self.deployed.parameters()), list(self.policy.parameters())
                torch._foreach_lerp_(averaged, [p.detach() for p in latest], s.policy_average)

        if self.updates % s.target_update_interval == 0:
            torch._foreach_lerp_(self._targets, self._sources, s.tau)  # what its step does, in a twentieth of the time
        return {"critic_loss": critic_loss, "q_value": value, "actor_loss": self.actor_loss}

    def check(self) -> None:
        """Check all weights, as at the end of a phase or before the agent is saved.

        Raises:
            Diverged: a weight of the actor, the critics, a target or the deployed policy is not finite.
        """
        for name, weight in (*self.loss.state_dict().items(), *self.deployed.state_dict().items()):
            if not bool(weight.isfinite().all()):
                raise self._diverged(f"weights of {name} are not finite")

    def state_dict(self) -> dict[str, Any]:
        """Return everything that a resumed run needs to equal an uninterrupted one."""
        return {
            **{name: getattr(self, name).state_dict() for name in self._parts},
            "deployed": self.deployed.state_dict(),
            "generator": self.loss.generator.get_state(),
            "updates": self.updates,
            "actor_loss": self.actor_loss,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for name in self._parts:
            getattr(self, name).load_state_dict(state[name])
        self.deployed.load_state_dict(state["deployed"])
        self.loss.generator.set_state(state["generator"])
        self.updates, self.actor_loss = state["updates"], state["actor_loss"].to(self._device)

    _parts = ("loss", "noise", "target_updater", "actor_optimizer", "critic_optimizer")

    def _optimizer(self, parameters: nn.Module, lr: float) -> Adam:
        return Adam(list(parameters.parameters()), lr=lr, fused=True)

    @property
    def _steps(self) -> GradientSteps:
        optimizers = self.critic_optimizer, self.actor_optimizer
        # Where tensors have been replaced, other lists and dictionaries hold them.
        now = [self.loss.actor_layers, self.loss.critic_layers, *(each.state for each in optimizers)]
        if self._made is None or any(one is not other for one, other in zip(now, self._read, strict=True)):
            code, weight = None, self.loss.actor_layers[0].weight
            if self.settings.machine_code and weight.is_cpu and weight.dtype == torch.float32:
                code = find_library(c_text("agents", "perceptron.c", "td3.c"), "TD3 learns")
            parts, self._read = (self.loss, *optimizers), now
            self._made = GradientSteps(*parts) if code is None else MachineSteps(code, *parts)
        return self._made

    def _require_finite(self, loss: Tensor, what: str) -> None:
        # A loss that is not finite stays so: weights that it has moved are NaN, and so is what they give.
        if (loss.is_cpu or self.updates % CHECK_EVERY == 0) and not math.isfinite(loss.item()):
            raise self._diverged(f"{what} is {loss.item()}")

    def _diverged(self, what: str) -> Diverged:
        s = self.settings
        return Diverged(
            f"policy learning: {what} at update {self.updates} (critic_lr={s.critic_lr}, actor_lr={s.actor_lr}, "
            f"gamma={s.gamma}); lower agent.critic_lr and agent.actor_lr, or make the rewards of the task smaller"
        )
