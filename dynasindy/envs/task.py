"""What is wanted of a system: observation, reward, references and initial states of an episode."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import Any, Protocol, Self

import torch
from torch import Tensor

from dynasindy.systems import Signature


class Sampled(Protocol):
    """What a policy has to know of where it acts; a `ControlEnv` is one, and so is a controller out of a file."""

    @property
    def task(self) -> Task:
        """What is wanted."""

    @property
    def dt(self) -> float:
        """Control period [s]."""


class Task(ABC):
    """What a `ControlEnv` asks of a task; pure functions of tensors, so real and imagined steps share them.

    As it is here it has no references; a task that draws any overrides `params_shape`, `sample` and `reference`.

    Args:
        signature: Names and ranges of the system's states and inputs.
        max_steps: Control periods per episode.

    Raises:
        ValueError: max_steps is not positive.
    """

    n_o: int
    """Length of the observation."""
    n_r: int = 0
    """Number of tracked outputs."""
    output_names: tuple[str, ...] = ()
    """Names of the tracked states."""
    own: bool = False
    """Whether the goal is what the plant itself pays; `earned` then is what is believed of that."""
    starts: Tensor | None = None
    """States in which the plant begins episodes, `(n, n_x)`, where it says so; a task may begin its own there."""
    input_limits: Tensor
    """Least and largest inputs, `(2, n_u)`: those of the actuators, or what a log has tried of what its equations bend
    in."""

    def __init__(self, signature: Signature, max_steps: int) -> None:
        if max_steps < 1:
            raise ValueError(f"max_steps must be at least 1 control period, got {max_steps}; the paper has 400")
        self.signature = signature
        self.max_steps = max_steps
        self.input_limits = torch.tensor(signature.input_limits or ((-1.0, 1.0),) * signature.n_u).mT

    def with_starts(self, starts: Tensor) -> Self:
        """Return the same task, told that the plant begins episodes at one of some states `(n, n_x)`."""
        other = copy.copy(self)
        other.starts = starts
        return other

    @property
    def learns(self) -> bool:
        """Whether real data tell what it earns, so that the tasks of two runs differ."""
        learns = type(self).learn is not Task.learn or type(self).state_dict is not Task.state_dict
        return self.own or learns

    @property
    def limited(self) -> bool:
        """Whether inputs have narrower limits than -1 and 1."""
        low, high = self.input_limits
        return bool((low > -1).any()) or bool((high < 1).any())

    def limit(self, action: Tensor) -> Tensor:
        """Return actions `(*batch, n_u)` kept within the limits of the inputs."""
        low, high = self.input_limits.to(action)
        return action.clamp(low, high)

    @property
    def linear(self) -> bool:
        """Whether the observations are linear in the states, with slopes that are the same at all times."""
        return False

    @property
    def start_ends(self) -> Tensor:
        """Ends of the states in which episodes begin, `(2, n_x)`; zero where nothing says where."""
        if self.starts is None:
            return torch.zeros(2, self.signature.n_x)
        return torch.stack([self.starts.amin(0), self.starts.amax(0)])

    @property
    def unit(self) -> float:
        """Reward that counts as one where models are judged."""
        return 1.0

    @property
    def params_shape(self) -> torch.Size:
        """Shape of one episode's parameters."""
        return torch.Size((0,))

    def sample(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw the parameters of new episodes, `(*batch, *params_shape)`."""
        return torch.zeros(*batch, *self.params_shape)

    @abstractmethod
    def initial_state(self, batch: torch.Size, generator: torch.Generator) -> Tensor:
        """Draw initial states, `(*batch, n_x)`."""

    def reference(self, params: Tensor, t: Tensor) -> Tensor:
        """Return the reference, `(*batch, n_r)`, at times `t` `(*batch, 1)` [s]."""
        return torch.zeros_like(t.expand(*t.shape[:-1], self.n_r))

    @abstractmethod
    def observation(self, x: Tensor, params: Tensor, t: Tensor) -> Tensor:
        """Return what the agent sees, `(*batch, n_o)`, of states `(*batch, n_x)` at times `t` [s]."""

    @abstractmethod
    def reward(self, x: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return the reward of a control period, `(*batch,)`, from the states at its ends, inputs apart."""

    def effort(self, u: Tensor) -> Tensor | None:
        """Return what the actions of a control period `(*batch, n_u)` cost, `(*batch,)`; None for nothing."""
        return None

    def earned(self, x: Tensor, u: Tensor, x_next: Tensor, params: Tensor, t_next: Tensor, at_stop: Tensor) -> Tensor:
        """Return what a control period earns, its reward less its effort, `(*batch,)`."""
        reward = self.reward(x, x_next, params, t_next, at_stop)
        effort = self.effort(u)
        # Most tasks ask nothing for inputs, and a single environment feels three operations more.
        return reward if effort is None else reward - effort.to(x)

    def learn(self, x: Tensor, u: Tensor, x_next: Tensor, paid: Tensor) -> None:  # noqa: B027 - most rewards are known
        """Learn from what real periods have paid, `(N,)`, of states and inputs `(N, n)`."""

    def summary(self) -> str:
        """Return in one line what was learnt; nothing for most tasks."""
        return ""

    def state_dict(self) -> dict[str, Any]:
        """Return what was learnt."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # noqa: B027 - most tasks learn nothing
        """Restore what `state_dict` returned."""
