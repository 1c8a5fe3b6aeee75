"""The one environment: a system plus a task, sampled every control period."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Annotated, Any, Literal

import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import _make_compatible_policy

from dynasindy.envs import Task, Tracking
from dynasindy.envs.task import TrackingMachine
from dynasindy.limits import Positive, check_memory
from dynasindy.safe_io import checked
from dynasindy.systems import System, integrate
from dynasindy.systems.checks import rates_at_start, require_plant
from dynasindy.systems.integrators import plain
from dynasindy.systems.steps import split_delay, steps_of, time_step_of

FARTHEST = 1e4
"""Ranges of a state beyond which nothing is told of a plant: squares and exponents of such numbers soon overflow."""


class ControlEnv(EnvBase):
    """A batched, stateless TorchRL environment around a vector field.

    The plant and a fitted model differ by the system alone: `env.with_system(world_model)` is the imagined
    environment, with the same task, reward, references, stops and specs.

    Root keys: `observation` (what the agent reads), `state` (what SINDy reads), `reference`, `task_params`,
    `step_count`; after a step also `samples` (the states after each sub-step, the last of which is `state`)
    and `at_stop`. Episodes are truncated after `task.max_steps` periods and never terminated.

    Args:
        system: Vector field of the plant or of a model.
        task: What is wanted of it.
        dt: Control period [s] (paper: 0.05).
        substeps: Runge-Kutta steps, and logged samples, per control period.
        batch_size: Default batch; a caller's tensordict may have any other.
        dtype: Floating type of states, samples and references, or its name; observation, action and reward are
            float32, the type of policies, so that a plant may move in float64 while agents stay fast.
        seed: Seed of the environment's own generator.
        delay: Time between a command and its effect [s], of which nobody is told; until the first one arrives inputs
            are zero. In a sample within which the input changes, its mean acts, as a model with a delay is fitted.

    Raises:
        ValueError: An episode does not fit into memory, or the system does not give one rate of change per state.
    """

    batch_locked = False
    left_beyond = math.inf
    """Ranges of a state at whose end an episode is over and stays; a model is asked about where it runs away."""
    pushes: Tensor | None = None
    """Changes of the states by the end of each control period that the system does not explain, `(T, n_x)`. They
    repeat, and each row of a batch begins at another one."""

    @checked
    def __init__(
        self,
        system: System,
        task: Task,
        dt: Annotated[float, Field(gt=0, le=1e5)] = 0.05,  # seconds; a plant is hardly controlled once a day
        substeps: Positive = 5,
        *,
        batch_size: tuple[int, ...] = (),
        dtype: torch.dtype | Literal["float32", "float64"] = torch.float32,
        seed: int = 0,
        delay: Annotated[float, Field(ge=0)] = 0.0,
    ) -> None:
        dtype = getattr(torch, dtype) if isinstance(dtype, str) else dtype
        check_memory(
            2.0 * dtype.itemsize * task.max_steps * substeps * system.signature.n_x,
            f"an episode of {task.max_steps:.4g} periods (task.max_steps) with {substeps} samples each (env.substeps)",
        )
        super().__init__(batch_size=torch.Size(batch_size))
        self.system, self.task = system, task
        self._compiled_task: tuple[Task, torch.dtype, TrackingMachine | None] | None = None
        self.stops, self.delay, self.past = system.stops, delay, deque[Tensor]()
        self.dt, self.substeps, self.float_type = dt, substeps, dtype
        self._make_specs()
        self._set_seed(seed)
        self._require_rates()

    @property
    def log_dt(self) -> float:
        """Time between the logged samples [s]."""
        return self.dt / self.substeps

    def with_system(self, system: System, dtype: torch.dtype | None = None, seed: int = 0) -> ControlEnv:
        """Return this environment around another system; task, stops and specs stay.

        Args:
            system: Vector field with the same signature.
            dtype: Floating type of its states; that of this environment if omitted.
            seed: Seed of the new environment's generator.

        Raises:
            ValueError: The numbers of states or inputs differ.
        """
        mine, other = self.system.signature, system.signature
        if (mine.n_x, mine.n_u) != (other.n_x, other.n_u):
            raise ValueError(
                f"the system has {other.n_x} states and {other.n_u} inputs, the environment {mine.n_x} and "
                f"{mine.n_u}; fit the model on data of this plant"
            )
        env = self._around(system, self.task, dtype or self.float_type, seed, batch_size=tuple(self.batch_size))
        env.left_beyond, env.past = self.left_beyond, self.past  # the same flight goes on
        return env

    def with_task(self, task: Task, seed: int = 0) -> ControlEnv:
        """Return this environment with another task for the same system."""
        return self._around(self.system, task, self.float_type, seed)

    def _around(self, system: System, task: Task, dtype: torch.dtype, seed: int, **more: Any) -> ControlEnv:
        env = ControlEnv(system, task, self.dt, self.substeps, dtype=dtype, seed=seed, delay=self.delay, **more)
        env.stops = self.stops  # the beam's, not the model's: a model knows nothing of them
        env.pushes = self.pushes
        return env

    def advance(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Advance states by one control period; differentiable.

        Args:
            x: States, `(*batch, n_x)`.
            u: Inputs, `(*batch, n_u)`, in [-1, 1].

        Returns:
            Samples after each sub-step, `(*batch, substeps, n_x)`, and whether a stop was touched, `(*batch,)`. Where
            inputs are late, the commands that arrive in the period act in place of `u`.
        """
        if not self.delay:
            return integrate(self.system, x, u, self.dt, self.substeps, self.stops)
        # The input changes within a sample, or between two steps.
        before, now = (self.past[k].to(x.dtype) for k in (0, 1))
        first = split_delay(self.delay, self.dt)[1]
        if self.system.step is None:
            old = [min(1.0, max(0.0, first / self.log_dt - k)) for k in range(self.substeps)]
            pieces = [(self.log_dt, 1, (1 - share) * now + share * before) for share in old]
        else:
            pieces = [(first, 1, before)] * bool(first) + [(self.dt - first, self.substeps, now)]
        samples, touched = [], []
        for seconds, count, u in pieces:
            moved, hit = integrate(self.system, x, u, seconds, count, self.stops)
            x = moved[..., -1, :]
            samples.append(moved)
            touched.append(hit)
        return torch.cat(samples, -2)[..., -self.substeps :, :], torch.stack(touched).any(0)

    def check_plant(self) -> None:
        """Refuse a plant that is none, and warn where its rates of change are not finite; of a model the gate tells.

        Raises:
            ValueError: They are not finite where episodes begin, a row of a batch depends on another, a plant that
                moves in steps has another control period or samples within it, or episodes begin outside of the bounds.
        """
        self._require_start_within()
        if (step := time_step_of(self.system)) is not None:
            steps_of(step, self.dt, 1, f"the plant {type(self.system).__name__}")
            if self.substeps > 1:
                raise ValueError(
                    f"env.substeps={self.substeps}: the plant moves in steps and has no samples within them; give 1"
                )
        bounds = self.task.bounds if isinstance(self.task, Tracking) else None
        require_plant(self.system, self._begins, bounds)

    def rollout(
        self,
        max_steps: int,
        policy: Callable[[TensorDictBase], TensorDictBase] | None = None,
        callback: Callable[[EnvBase, TensorDictBase], object] | None = None,
        *,
        auto_reset: bool = True,
        tensordict: TensorDictBase | None = None,
        break_when_any_done: bool = True,
        **options: Any,
    ) -> TensorDictBase:
        """Roll a policy out as `EnvBase.rollout` does, with its arguments, several times as fast.

        Other options of TorchRL's go its own way.

        Returns:
            Control periods `(*batch, T)`.
        """
        given = {"auto_reset": auto_reset, "tensordict": tensordict, "break_when_any_done": break_when_any_done}
        begins = None if tensordict is None or auto_reset else tensordict.get("samples", None)
        other = not auto_reset and (begins is None or begins.shape[-2] != self.substeps)  # of another environment
        if options or max_steps < 1 or other:
            return super().rollout(max_steps, policy, callback, **given, **options)
        now = self.reset(tensordict) if auto_reset else self.maybe_reset(tensordict)
        if policy is None:
            policy = self.rand_action
        else:
            policy = _make_compatible_policy(policy, self.observation_spec, env=self, fast_wrap=True)
        begun, ended = list[dict[str, Any]](), list[dict[str, Any]]()
        while True:
            acted = policy(now)
            if acted is not now:
                now.update(acted)
            row = dict(now.items())
            after = dict(self._step(now).items())
            ended.append({**row.pop("next", {}), **after})
            begun.append(row)
            over = bool(after["done"].any())
            if len(begun) == max_steps or (over and break_when_any_done):
                shape, names = (*now.batch_size, len(begun)), [*[None] * now.batch_dims, "time"]
                first, last = (  # stacked along time first, so that each period is copied as one block
                    {key: torch.stack([each[key] for each in periods]).movedim(0, now.batch_dims) for key in periods[0]}
                    for periods in (begun, ended)
                )
                return TensorDict({**first, "next": TensorDict(last, shape)}, shape, names=names)
            going_on = {key: value for key, value in after.items() if key != "reward"}
            now = TensorDict({**row, **going_on}, now.batch_size, device=self.device)
            if over:
                now = self.maybe_reset(now)
            if callback is not None:
                callback(self, now)

    def start_from(self, states: Tensor) -> TensorDict:
        """Begin episodes at given states, with fresh references.

        Args:
            states: Initial states, `(*batch, n_x)`; the episodes happen on their device.

        Returns:
            What `reset` returns, batch `(*batch,)`; pass it to `rollout(..., auto_reset=False)`.
        """
        batch, device = states.shape[:-1], states.device
        states = states.to(self.float_type)
        params = self.task.sample(batch, self.rng).to(states)
        steps = torch.zeros(*batch, 1, dtype=torch.int64, device=device)
        out = self._observed(states, params, steps)
        out["samples"] = states.unsqueeze(-2).expand(*batch, self.substeps, states.shape[-1]).clone()
        for key in ("at_stop", "done", "terminated", "truncated"):
            out[key] = torch.zeros(*batch, 1, dtype=torch.bool, device=device)
        return TensorDict(out, batch_size=batch, device=self.device)

    def _observed(
        self, x: Tensor, params: Tensor, steps: Tensor, period: tuple[Tensor, Tensor, Tensor] | None = None
    ) -> dict[str, Tensor]:
        """Return what is shown of states, and what a period earned: states at its start, inputs and touched stops."""
        shown = {"state": x, "task_params": params, "step_count": steps}
        if x.is_cpu and plain(x, params, steps, *(period or ())):  # else derivatives are asked of it
            if self._compiled_task is None or self._compiled_task[:2] != (self.task, x.dtype):
                self._compiled_task = self.task, x.dtype, TrackingMachine.of(self.task, self.dt, x.dtype)
            if (code := self._compiled_task[2]) is not None:
                before, _, touched = period or (None, None, None)
                return shown | code.judge(before, x, params, steps, touched)
        t = steps.to(x.dtype) * self.dt
        shown["observation"] = self.task.observation(x, params, t).float()
        shown["reference"] = self.task.reference(params, t)
        if period is not None:
            before, u, touched = period
            shown["reward"] = self.task.earned(before, u, x, params, t, touched).float().unsqueeze(-1)
        return shown

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        batch = self.batch_size if tensordict is None else tensordict.batch_size
        begun = self.task.initial_state(batch, self.rng)
        # Where episodes of a batch are over, those that begin anew lie beside the others.
        leaves = () if tensordict is None else tensordict.values(include_nested=True, leaves_only=True)
        return self.start_from(begun.to(next((leaf.device for leaf in leaves), begun.device)))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        x = tensordict["state"]
        if self.delay:
            self._command(tensordict["action"], bool((tensordict["step_count"] == 0).all()))
        samples, touched = self._within(x, tensordict["action"].to(x.dtype))
        if self.pushes is not None:
            first = (torch.arange(len(x)) * len(self.pushes)).div(len(x), rounding_mode="floor")
            samples = samples.clone()
            samples[..., -1, :] += self.pushes[(first + tensordict["step_count"].squeeze(-1)) % len(self.pushes)]
        return self._moved(tensordict, samples, touched)

    def _command(self, u: Tensor, begins: bool) -> None:
        """Send inputs `(*batch, n_u)` on their way, before which zeros are where episodes begin."""
        count = split_delay(self.delay, self.dt)[0] + 2
        if begins or len(self.past) != count:
            self.past.clear()
            self.past.extend([torch.zeros_like(u)] * count)
        self.past.append(u)
        self.past.popleft()

    def _within(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Advance states as `advance` does; an episode is over and stays where its first states leave their ranges."""
        samples, touched = self.advance(x, u)
        if math.isinf(self.left_beyond):
            return samples, touched
        # Those states stay at the end of their ranges, the others where the period began.
        ends = self.left_beyond * x.new_tensor(self.system.signature.x_scale)
        beyond = samples.abs() > ends
        first = samples.gather(-2, beyond.int().argmax(-2, keepdim=True)).squeeze(-2)
        there = torch.where(beyond.any(-2), first.clamp(-ends, ends), x)
        was = (x.abs() >= ends).any(-1, keepdim=True)
        over = was | beyond.any(-2).any(-1, keepdim=True)
        return torch.where(over.unsqueeze(-2), torch.where(was, x, there).unsqueeze(-2), samples), touched

    def _moved(self, tensordict: TensorDictBase, samples: Tensor, touched: Tensor) -> TensorDict:
        """Return what a step shows, of samples `(*batch, substeps, n_x)` and touched stops, `(*batch,)`."""
        x, u, params = (tensordict[key] for key in ("state", "action", "task_params"))
        steps = tensordict["step_count"] + 1
        out = self._observed(samples[..., -1, :], params, steps, (x, u, touched))
        out["samples"], out["at_stop"] = samples, touched.unsqueeze(-1)
        out["truncated"] = steps >= self.task.max_steps
        out["done"] = out["truncated"].clone()
        out["terminated"] = torch.zeros_like(out["done"])
        return TensorDict(out, batch_size=tensordict.batch_size, device=self.device)

    @torch.no_grad()
    def _require_rates(self) -> None:
        rates_at_start(self.system, self._begins)

    def _require_start_within(self) -> None:
        if isinstance(self.task, Tracking):
            self.system.signature.require_start_within(self.task.start_ends, self.task.bounds, group="task")

    def _begins(self, batch: torch.Size) -> Tensor:
        """Return states in which episodes begin, `(*batch, n_x)`, the same ones each time."""
        return self.task.initial_state(batch, torch.Generator().manual_seed(0)).to(self.float_type)

    def _set_seed(self, seed: int | None) -> None:
        self.rng = torch.Generator().manual_seed(0 if seed is None else seed)

    def _make_specs(self) -> None:
        batch, dtype, signature = self.batch_size, self.float_type, self.system.signature

        def _unbounded(*shape: int, dtype: torch.dtype = dtype) -> Unbounded:
            return Unbounded(shape=(*batch, *shape), dtype=dtype)

        carried = {
            "state": _unbounded(signature.n_x),
            "task_params": _unbounded(*self.task.params_shape),
            "step_count": _unbounded(1, dtype=torch.int64),
        }
        self.state_spec = Composite(carried, shape=batch)
        self.observation_spec = Composite(
            {key: spec.clone() for key, spec in carried.items()}
            | {
                "observation": _unbounded(self.task.n_o, dtype=torch.float32),
                "reference": _unbounded(self.task.n_r),
                "samples": _unbounded(self.substeps, signature.n_x),
                "at_stop": Binary(n=1, shape=(*batch, 1), dtype=torch.bool),
            },
            shape=batch,
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(*batch, signature.n_u), dtype=torch.float32)
        self.reward_spec = _unbounded(1, dtype=torch.float32)
        done = {key: Binary(n=1, shape=(*batch, 1), dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(done, shape=batch)
