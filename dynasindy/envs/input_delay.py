"""An environment whose inputs act some time after they were commanded, of which nobody is told."""

from __future__ import annotations

from collections import deque
from typing import TypedDict, Unpack

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from dynasindy.envs.control_env import ControlEnv
from dynasindy.systems import System, integrate
from dynasindy.tasks import Task


class _Common(TypedDict, total=False):
    """Settings that are passed on, by name; see `ControlEnv`."""

    batch_size: tuple[int, ...]
    dtype: torch.dtype
    seed: int


class DelayedEnv(ControlEnv):
    """An environment whose inputs are late; until the first one arrives they are zero.

    In a sample within which the input changes, its mean acts, as a model with a delay is fitted. The delay lies behind
    all that a policy or an observer sees, as that of a plant does.

    Args:
        system: Vector field; its signature names states and inputs.
        task: What is wanted.
        dt: Control period [s].
        substeps: Runge-Kutta steps and logged samples per control period.
        delay: Time between a command and its effect [s].
        **common: Batch, floating type of states and seed, see `ControlEnv`.

    Raises:
        ValueError: The delay is negative.
    """

    def __init__(
        self,
        system: System,
        task: Task,
        dt: float = 0.05,
        substeps: int = 1,
        delay: float = 0.0,
        **common: Unpack[_Common],
    ) -> None:
        if not delay >= 0:
            raise ValueError(f"an input delay is {delay} s; allowed is 0 or more")
        super().__init__(system, task, dt, substeps, **common)
        self.delay = delay
        self.whole = int(delay / dt + 1e-6)
        self.part = max(0.0, delay / dt - self.whole)
        self.past: deque[Tensor] = deque(maxlen=self.whole + 2)

    @classmethod
    def around(cls, env: ControlEnv, delay: float) -> DelayedEnv:
        """Return an environment whose inputs are late, with the generator of the one without the delay.

        Args:
            env: Environment without the delay.
            delay: Time between a command and its effect [s].

        Raises:
            ValueError: The delay is negative.
        """
        batch = tuple(env.batch_size)
        late = cls(env.system, env.task, env.dt, env.substeps, delay, batch_size=batch, dtype=env.float_type)
        late.rng, late.stops, late.left_beyond = env.rng, env.stops, env.left_beyond
        return late

    def with_system(self, system: System, dtype: torch.dtype | None = None, seed: int = 0) -> DelayedEnv:
        """Return this environment around another system, in the same flight."""
        late = DelayedEnv.around(super().with_system(system, dtype, seed), self.delay)
        late.past = self.past
        return late

    def with_model(self, model: System, dtype: torch.dtype | None = None, seed: int = 0) -> ControlEnv:
        """Return an environment around a model, whose inputs act at once."""
        return super().with_system(model, dtype, seed)

    def with_task(self, task: Task, seed: int = 0) -> DelayedEnv:
        """Return this environment with another task for the same system."""
        return DelayedEnv.around(super().with_task(task, seed), self.delay)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        commanded = tensordict["action"]
        if not self.past or bool((tensordict["step_count"] == 0).all()):
            self.past.extend([torch.zeros_like(commanded)] * (self.whole + 2))
        self.past.append(commanded)
        return super()._step(tensordict)

    def advance(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Advance states by one control period, under the commands that arrive in it."""
        before, now = (self.past[k].to(x.dtype) for k in (0, 1))
        if self.system.step is not None:
            return self._stepped(x, before, now)
        samples, touched = [], []
        for k in range(self.substeps):
            old = min(1.0, max(0.0, self.part * self.substeps - k))  # part of this sample before the input changes
            end, hit = integrate(self.system, x, (1 - old) * now + old * before, self.log_dt, 1, self.stops)
            x = end[..., -1, :]
            samples.append(x)
            touched.append(hit)
        return torch.stack(samples, -2), torch.stack(touched).any(0)

    def _stepped(self, x: Tensor, before: Tensor, now: Tensor) -> tuple[Tensor, Tensor]:
        """Advance a difference equation, whose input changes between two of its steps."""
        first, touched = self.part * self.dt if self.part > 1e-6 else 0.0, torch.zeros_like(x[..., 0], dtype=torch.bool)
        if first:
            end, touched = integrate(self.system, x, before, first, 1, self.stops)
            x = end[..., -1, :]
        samples, hit = integrate(self.system, x, now, self.dt - first, self.substeps, self.stops)
        return samples, touched | hit
