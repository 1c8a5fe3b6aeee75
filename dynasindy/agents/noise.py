"""Exploration noise whose standard deviation decays with every control step."""

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type

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
        ValueError: a value lies outside its range.
    """

    in_keys: ClassVar[list[str]] = ["action"]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(
        self,
        sigma: float = 0.15,
        decay: float = 1e-3,
        minimum: float = 0.0,
        seed: int = 0,
    ) -> None:
        if not (sigma >= minimum >= 0 and 0 <= decay < 1):
            raise ValueError(
                f"Exploration noise has sigma={sigma}, decay={decay}, minimum={minimum}; "
                "give agent.exploration_noise >= noise_min >= 0 and 0 <= noise_decay < 1."
            )
        super().__init__()
        self.sigma, self.decay, self.minimum = float(sigma), decay, minimum
        # In the CPU's memory, so that a seed draws the same noise for every device.
        self.generator = torch.Generator().manual_seed(seed)

    def sample(self, action: Tensor) -> Tensor:
        """Return `action (*batch, n_u)` plus noise, within [-1, 1]."""
        noise = torch.randn(action.shape, generator=self.generator, dtype=action.dtype).to(action.device)
        return (action + self.sigma * noise).clamp(-1.0, 1.0)

    def perturb(self, action: Tensor) -> Tensor:
        """Return `sample(action)`, or `action` itself inside a deterministic exploration type."""
        return action if exploration_type() in _QUIET else self.sample(action)

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

    def get_extra_state(self) -> dict[str, object]:
        """Return what `state_dict` keeps: the present sigma and the generator."""
        return {"sigma": self.sigma, "generator": self.generator.get_state()}

    def set_extra_state(self, state: dict[str, object]) -> None:
        """Restore what `get_extra_state` returned."""
        assert isinstance(state["sigma"], float)
        assert isinstance(state["generator"], Tensor)
        self.sigma = state["sigma"]
        self.generator.set_state(state["generator"])
