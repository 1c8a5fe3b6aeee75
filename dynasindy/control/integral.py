"""Integral action around a trained policy: what the plant has and the model has not leaves no steady error."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.envs import Sampled, Tracking, references


class IntegralAction:
    """A policy that is shown its error plus the error's integral.

    The policy holds any target, so that shifting what it sees by `integral` moves the output until the error is
    zero; no training is needed. What is no steady error is not integrated, so that nothing winds up: no error beyond
    `band`, as after a step or in a gust, and of an error that changes at `rate` half of it.

    Args:
        policy: Reads `observation`, writes `action`.
        env: Where it acts, with a `Tracking` task.
        gain: Integral gain [1/s].
        band: Largest error that is integrated [target ranges].
        limit: Largest integral [target ranges].
        rate: Rate of change of an error at which half of it is integrated [target ranges per second].

    Raises:
        TypeError: The task tracks no reference.
        ValueError: A number is not positive.
    """

    def __init__(
        self,
        policy: Callable[[TensorDictBase], TensorDictBase],
        env: Sampled,
        gain: float = 0.7,
        band: float = 0.06,
        limit: float = 0.3,
        rate: float = 0.1,
    ) -> None:
        if not isinstance(env.task, Tracking):
            raise TypeError(f"task {type(env.task).__name__} has no error to integrate; use a tracking task")
        if not all(number > 0 for number in (gain, band, limit, rate)):
            raise ValueError(
                f"integral action needs gain, band, limit and rate > 0, not {gain}, {band}, {limit}, {rate}"
            )
        self.policy, self.task, self.dt = policy, env.task, env.dt
        self.gain, self.band, self.limit, self.rate = gain, band, limit, rate
        self.integral: Tensor | None = None

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action for the shifted error and advance the integral; step 0 begins at zero."""
        task, x, params = self.task, tensordict["state"], tensordict["task_params"]
        steps = tensordict["step_count"]
        t = steps.to(x.dtype) * self.dt
        box = task.boxes().to(x)
        error = task.error(x, params, t) / box
        if self.integral is None or self.integral.shape != error.shape:
            self.integral = torch.zeros_like(error)
        self.integral = self.integral.masked_fill(steps == 0, 0.0)
        seen = tensordict.copy()
        observation, columns = tensordict["observation"], task.error_columns
        shift = (self.integral / task.error_scale).to(observation)
        beside = columns.start, observation.shape[-1] - columns.stop
        seen["observation"] = observation + torch.nn.functional.pad(shift, beside)
        moving = torch.zeros_like(error)  # an output without a rate tells nothing of its motion
        if task.rates:
            slower = references.rate(params, t)[..., task.rated] - x[..., task.rates]
            moving[..., task.rated] = slower / box[..., task.rated] / self.rate
        steady = (error.abs() < self.band) / (1 + moving.square())
        self.integral = (self.integral + self.gain * self.dt * steady * error).clamp(-self.limit, self.limit)
        return tensordict.set("action", self.policy(seen)["action"])
