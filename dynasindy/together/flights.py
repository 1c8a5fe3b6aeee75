"""Rollouts of several runs as one batch: real episodes, imagined rollouts and evaluations, with a policy for each run.

A flight has as many rows in each run. What depends on the run is the policy, its noise, where each row begins and what
it tracks, and, in a model, the coefficients; plant, task and all settings are those of every run.

| name    | shape       | meaning                                  |
| ------- | ----------- | ---------------------------------------- |
| R       |             | runs                                     |
| n       |             | rows of a flight in a run                |
| T       |             | control periods                          |
| states  | `(R, n, n_x)` | as they are now                        |
| records | `(T, R, n, ...)` | of each control period              |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict, TypeGuard

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from dynasindy.agents import MLP, Exploring
from dynasindy.envs import ControlEnv
from dynasindy.systems import System
from dynasindy.systems.integrators import sampled, stepped
from dynasindy.systems.plain import plain
from dynasindy.systems.steps import steps_of
from dynasindy.together.alike import alike
from dynasindy.together.captured import captured, compiled
from dynasindy.together.company import Company, Work, here
from dynasindy.together.stacks import Stack, through
from dynasindy.world_models import SindyModel

EPISODE = "real episode"
"""Name of the flights on the plant from which a run learns."""
Policy = Callable[[TensorDictBase], TensorDictBase]


def fly(
    env: ControlEnv, policy: Policy, start: Callable[[], TensorDictBase], steps: int, what: str, home: bool = True
) -> TensorDict | None:
    """Roll a policy out as part of the company that this run goes in.

    Args:
        env: The environment.
        policy: What acts: a perceptron that reads `observation`, with noise or without.
        start: Begins the episodes, as `env.start_from` does, `(n,)`.
        steps: Control periods; an episode that is over goes on.
        what: What the flight is, in a word: flights of one name differ from run to run by what is said above alone.
        home: Whether the rollout is wanted in the CPU's memory, or stays where it was made.

    Returns:
        The rollout `(n, T)` with the keys of `env.rollout`; None if this run goes by itself, or there is no such way to
        fly it.
    """
    company, acting = here(), _acting(policy)
    if company is None or acting is None or not _flies(env):
        return None
    (network, noise), begun, drawn = acting, start(), None
    if noise is not None:
        shape = torch.Size((*begun.batch_size, env.system.signature.n_u))
        drawn = noise.noise.ahead(steps, shape, noise.decays)
    found = company.ask(Flight(env, network, drawn, begun, steps, what, home))
    assert isinstance(found, TensorDict)
    return found


def replay(
    env: ControlEnv, x: Tensor, params: Tensor, begun: Tensor, u: Tensor, what: str
) -> tuple[Tensor, Tensor] | None:
    """Move an environment by given actions, as part of the company that this run goes in.

    Args:
        env: The environment, around a model.
        x: Where its rows begin, `(n, n_x)`.
        params: What they track, `(n, *params_shape)`.
        begun: Control periods since the start of the episode there, `(n,)`.
        u: Actions, `(T, n, n_u)`.
        what: What the replay is, in a word.

    Returns:
        States at the ends of the periods, `(T, n, n_x)`, and what each period earns, `(T, n)`, in the CPU's memory;
        None if this run goes by itself, or models of this kind are not moved together.
    """
    company = here()
    if company is None or not _flies(env) or not _stacks(env.system):
        return None
    x, u = x.to(env.float_type), u.to(env.float_type)
    # The code of all functions serves all runs, and is through before a device has begun thousands of small operations.
    if math.isinf(env.left_beyond) and plain(x, u) and (code := env.system.compiled(x, u[0], whole=True)) is not None:
        moved = code.flight(x, u, env.dt, env.substeps, env.stops)
        # A function that this run's equations lack may be infinite where they are not.
        moved = moved if bool(moved[0].isfinite().all()) else env.follow(x, u)
        return env.judged(x, u, moved, params.to(x), begun)
    start = TensorDict({"state": x, "task_params": params, "step_count": begun.unsqueeze(-1)}, [len(x)])
    start["observation"] = torch.zeros(len(x), env.task.n_o)  # nobody looks
    found = company.ask(Flight(env, None, u, start, len(u), what))
    following = found["next"]
    return following["state"].transpose(0, 1), following["reward"].squeeze(-1).transpose(0, 1)


def _acting(policy: Policy) -> tuple[MLP, Exploring | None] | None:
    """Return the perceptron of a policy and its noise; None if it is something else."""
    noise = policy if isinstance(policy, Exploring) else None
    plain = policy if noise is None else noise.policy
    if not isinstance(plain, TensorDictModule) or type(plain) is not TensorDictModule:
        return None
    if (plain.in_keys, plain.out_keys) != (["observation"], ["action"]):
        return None
    return (plain.module, noise) if isinstance(plain.module, MLP) else None


@dataclass(eq=False)
class Flight(Work):
    """A rollout that a run needs.

    Attributes:
        env: The environment.
        network: The policy; None for given actions.
        noise: What is added to each action, `(T, n, n_u)`; None for nothing. Without a policy, the actions.
        start: What `env.start_from` returned, `(n,)`.
        steps: Control periods.
        what: What the flight is, in a word.
        home: Whether the rollout is wanted in the CPU's memory.
    """

    env: ControlEnv
    network: MLP | None
    noise: Tensor | None
    start: TensorDictBase
    steps: int
    what: str
    home: bool = True

    @cached_property
    def kind(self) -> Hashable:
        """Name, sizes, plant, task and pace; of a model whose coefficients may differ, its functions."""
        env, network, system = self.env, self.network, self.env.system
        moved = (*(f.key for f in system.library.features), system.step) if _stacks(system) else alike(system)
        sizes = None if network is None else tuple(tuple(layer.weight.shape) for layer in network.layers())
        pace = env.dt, env.substeps, env.stops, env.left_beyond, env.float_type
        shapes = self.steps, tuple(self.start.batch_size), sizes, self.noise is None
        return self.what, self.home, moved, alike(env.task), pace, shapes

    @property
    def waits(self) -> bool:
        """Whether it is a real episode, which all runs begin at the same time."""
        return self.what == EPISODE

    def done(self, all_of_it: Sequence[Flight], company: Company) -> list[TensorDict]:
        """Fly, all runs at once; return the rollout of each, `(n, T)`."""
        place = ("flights", len(all_of_it), self.kind)
        return company.room(place, lambda: Pilot(self, len(all_of_it), company.device)).fly(all_of_it)


class _Kinds(TypedDict):
    dtype: torch.dtype
    device: torch.device


class Pilot:
    """Room for flights of one kind.

    Args:
        like: One of them.
        runs: How many runs fly together.
        device: Where they fly.
    """

    def __init__(self, like: Flight, runs: int, device: torch.device) -> None:
        self.env, self.steps, self.device, self.network = like.env, like.steps, device, like.network
        signature, task, dtype = like.env.system.signature, like.env.task, like.env.float_type
        self.rows = tuple(like.start.batch_size)
        n, kinds = like.start.numel(), _Kinds(dtype=dtype, device=device)
        self.system = (
            Coefficients(like.env.system, runs, dtype, device) if _stacks(like.env.system) else like.env.system
        )
        self.x = torch.zeros(runs, n, signature.n_x, **kinds)
        self.params = torch.zeros(runs, n, *task.params_shape, **kinds)
        self.count = torch.zeros(runs, n, 1, dtype=torch.int64, device=device)
        self.seen = torch.zeros(runs, n, task.n_o, device=device)
        self.policies = None if like.network is None else Stack(like.network.layers(), runs, device)
        self.home = None if self.policies is None else self.policies.twin(torch.device("cpu"))
        shape = (like.steps, runs, n)
        self.noise = None if like.noise is None else torch.zeros(*shape, signature.n_u, device=device)
        self.place = torch.zeros(1, dtype=torch.int64, device=device)
        self.actions = torch.zeros(*shape, signature.n_u, device=device)
        self.samples = torch.zeros(*shape, like.env.substeps, signature.n_x, **kinds)
        self.touched = torch.zeros(*shape, dtype=torch.bool, device=device)
        self.observed = torch.zeros(*shape, task.n_o, device=device)
        self._advance = _advancing(self.system, like.env)
        self.period: Callable[[], None] | None = None

    @torch.no_grad()
    def fly(self, flights: Sequence[Flight]) -> list[TensorDict]:
        """Fly and return the rollout of each run, `(n, T)`."""
        if self.period is None:
            self.period = captured(compiled(self._period, self.device), self.device, self.place.zero_)
        for r, flight in enumerate(flights):
            self._board(r, flight)
        if self.policies is not None and self.home is not None:
            self.policies.flat.copy_(self.home.flat)
        self.place.zero_()
        began = self.x.clone(), self.seen.clone(), self.count.clone()
        for _ in range(self.steps):
            self.period()
        return self._landed(*began, home=flights[0].home)

    def _board(self, r: int, flight: Flight) -> None:
        for key, room in (("state", self.x), ("task_params", self.params), ("step_count", self.count)):
            room[r].copy_(flight.start[key].reshape(room[r].shape))
        self.seen[r].copy_(flight.start["observation"].reshape(self.seen[r].shape))
        if self.home is not None and flight.network is not None:
            theirs = [part.detach() for layer in flight.network.layers() for part in layer if part is not None]
            mine = self.home.of(r, r + 1)
            torch._foreach_copy_(mine, [part.view_as(room) for part, room in zip(theirs, mine, strict=True)])
        if self.noise is not None and flight.noise is not None:
            self.noise[:, r].copy_(flight.noise.reshape(self.noise[:, r].shape))
        if isinstance(self.system, Coefficients):
            self.system.put(r, flight.env.system)

    def _period(self) -> None:
        """Move all rows by one control period."""
        env = self.env
        u = None
        if self.policies is not None and self.network is not None:
            u = through(self.policies.layers(), self.seen, self.network.squash)
        if self.noise is not None:
            added = self.noise.index_select(0, self.place).squeeze(0)
            u = added if u is None else (u + added).clamp(-1.0, 1.0)
        assert u is not None
        samples, touched = self._advance(self.x, u.to(self.x.dtype))
        if math.isfinite(env.left_beyond):
            samples = env._left(self.x, samples)
        self.count.add_(1)
        x = samples[..., -1, :]
        seen = env.task.observation(x, self.params, self.count.to(x.dtype) * env.dt).float()
        for records, record in (
            (self.actions, u),
            (self.samples, samples),
            (self.touched, touched),
            (self.observed, seen),
        ):
            records.index_copy_(0, self.place, record.unsqueeze(0))
        self.x.copy_(x)
        self.seen.copy_(seen)
        self.place.add_(1)

    def _landed(self, x: Tensor, seen: Tensor, count: Tensor, home: bool) -> list[TensorDict]:
        """Return the rollouts, given where they began, in the CPU's memory if they are wanted at home."""
        env, following = self.env, self.samples[..., -1, :]
        before = torch.cat([x.unsqueeze(0), following[:-1]])
        counts = count + torch.arange(self.steps + 1, device=self.device).view(-1, *[1] * count.dim())
        params = self.params.expand(self.steps, *self.params.shape)
        t = counts.to(x.dtype) * env.dt
        reward = env.task.earned(before, self.actions, following, params, t[1:], self.touched)
        truncated = counts >= env.task.max_steps
        references = env.task.reference(self.params.expand(self.steps + 1, *self.params.shape), t)
        held = x.unsqueeze(-2).expand(*x.shape[:-1], env.substeps, x.shape[-1])
        ends = {"done": truncated, "truncated": truncated, "terminated": torch.zeros_like(truncated)}
        columns = {
            "observation": torch.cat([seen.unsqueeze(0), self.observed]),
            "state": torch.cat([x.unsqueeze(0), following]),
            "reference": references,
            "step_count": counts,
            "samples": torch.cat([held.unsqueeze(0), self.samples]),
            "at_stop": torch.nn.functional.pad(self.touched.unsqueeze(-1), (0, 0) * self.touched.dim() + (1, 0)),
            **{key: torch.cat([torch.zeros_like(ends[key][:1]), ends[key][1:]]) for key in ends},
        }
        root = {key: column[:-1] for key, column in columns.items()} | {"task_params": params, "action": self.actions}
        after = {key: column[1:] for key, column in columns.items()} | {"task_params": params}
        after["reward"] = reward.float().unsqueeze(-1)
        place = torch.device("cpu") if home else self.device
        batch, shown = [*self.rows, self.steps], []
        for records in (root, after):
            found = {key: value.permute(1, 2, 0, *range(3, value.dim())) for key, value in records.items()}
            # Of one row, or one period, a view of this room would do, of which the next flight makes another one.
            copies = {key: value.clone(memory_format=torch.contiguous_format) for key, value in found.items()}
            shown.append({key: value.to(place, non_blocking=True) for key, value in copies.items()})
        if home and self.device.type == "cuda":
            torch.cuda.current_stream(self.device).synchronize()

        def _mine(r: int, records: dict[str, Tensor]) -> dict[str, Tensor]:
            return {key: value[r].reshape(*batch, *value.shape[3:]) for key, value in records.items()}

        return [
            TensorDict({**_mine(r, shown[0]), "next": TensorDict(_mine(r, shown[1]), batch)}, batch)
            for r in range(len(x))
        ]


class Coefficients(System):
    """The models of several runs, dx/dt = Xi' Theta(x, u) with the functions of one and the coefficients of each.

    Args:
        like: One of the models.
        runs: How many there are.
        dtype: Floating type of the states.
        device: Where they lie.
    """

    def __init__(self, like: SindyModel, runs: int, dtype: torch.dtype, device: torch.device) -> None:
        super().__init__(like.signature, like.stops)
        self.library = like.library
        self.stacked = torch.zeros(runs, *like.coefficients.shape, dtype=dtype, device=device)
        self.used = torch.zeros_like(self.stacked)  # 1 where a run's equation has a function

    def put(self, r: int, model: System) -> None:
        """Take the coefficients of a run as they are now."""
        assert isinstance(model, SindyModel)
        self.stacked[r].copy_(model.coefficients)
        self.used[r].copy_(self.stacked[r] != 0)

    @property
    def step(self) -> float | None:
        """Step of the difference equation that it is [s]; None of a differential equation."""
        return self.library.step

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt of states `(R, n, n_x)` under inputs `(R, n, n_u)`.

        An infinite function spoils the equations that have it, as in a run alone, where no other is computed.
        """
        theta = self.library(x, u)
        wrong = ~theta.isfinite()
        spoilt = torch.bmm(wrong.to(theta.dtype), self.used) > 0
        return torch.bmm(theta.masked_fill(wrong, 0.0), self.stacked).masked_fill(spoilt, torch.nan)


def _flies(env: ControlEnv) -> bool:
    """Return whether an environment is this code's own, with a task that is the same in all runs."""
    return type(env) is ControlEnv and not env.task.learns


def _stacks(system: System) -> TypeGuard[SindyModel]:
    """Return whether models of several runs differ by their coefficients alone."""
    return isinstance(system, SindyModel) and type(system) is SindyModel and not system.library.shapes


def _advancing(system: System, env: ControlEnv) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Return what advances states by a control period, as `integrate` does, without a look at what they are."""
    stops, (h, count, difference) = env.stops, steps_of(system.step, env.dt, env.substeps)

    def _substep(x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        x = stepped(system, x, u, h, difference)
        return (x, torch.zeros_like(x[..., 0], dtype=torch.bool)) if stops is None else stops.apply(x)

    def _advance(x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        samples, touches = [], []
        for _ in range(count):
            x, touched = _substep(x, u)
            samples.append(x)
            touches.append(touched)
        return sampled(torch.stack(samples, -2), system.step, env.substeps), torch.stack(touches).any(0)

    return _advance
