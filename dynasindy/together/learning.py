"""Policy learning of several runs as one batch: the updates of TD3 with a leading dimension of runs.

The arithmetic is that of `dynasindy.agents.TD3.update` (Fujimoto 2018, Algorithm 1), and so are the random numbers:
each run draws its batches and its smoothing noise from its own generators in the order in which it would draw them
alone. While a GPU is busy with some updates, the CPU draws those that follow.

| name     | shape            | meaning                                          |
| -------- | ---------------- | ------------------------------------------------ |
| R        |                  | runs                                             |
| C        |                  | critics of a run                                 |
| B        |                  | transitions of a batch                           |
| networks | `(numbers,)`     | weights, see `dynasindy.together.stacks`         |
| batches  | `(U, R, B, ...)` | of U updates in a row                            |
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import torch
from torch import Tensor
from torch.optim import Adam

from dynasindy.agents import TD3
from dynasindy.agents.networks import Layer
from dynasindy.agents.noise import drawn
from dynasindy.agents.steps import kept_by, products_in
from dynasindy.data import DynaReplay
from dynasindy.systems import Diverged
from dynasindy.together.captured import captured, compiled
from dynasindy.together.company import Company, Work, here
from dynasindy.together.stacks import Stack, through
from dynasindy.told import counted, tell

CHUNK = 50
"""Updates whose batches lie on the device at a time."""
_WEIGHTS = ("actors", "critics", "target_actors", "target_critics", "averages")
"""Attributes of a `Learner` that hold networks."""


def learn(agent: TD3, replay: DynaReplay, updates: int) -> None:
    """Take so many steps of TD3 on batches from the storages.

    Args:
        agent: Agent, improved in place.
        replay: Where the batches are drawn.
        updates: How many.

    Raises:
        Diverged: A loss is not finite.
    """
    company = here()
    if company is not None and updates:
        company.ask(Learning(agent, replay, updates))  # which checks all weights, too
        return
    for _ in counted("policy learning", range(updates), updates, "updates"):
        agent.update(replay.sample())
    agent.check()


@dataclass(eq=False)
class Learning(Work):
    """Policy learning that a run needs done.

    Attributes:
        agent: Agent, improved in place.
        replay: Where its batches are drawn.
        updates: How many.
    """

    agent: TD3
    replay: DynaReplay
    updates: int

    @property
    def kind(self) -> Hashable:
        """Settings, sizes and the number of updates, those before among them."""
        settings = tuple((name, str(value)) for name, value in vars(self.agent.settings).items())
        return settings, self.agent.widths, self.replay.batch_size, self.updates, self.agent.updates

    def done(self, all_of_it: Sequence[Learning], company: Company) -> list[Exception | None]:
        """Learn, all runs at once; return for each what its learning ended in, None for nothing."""
        place = ("learner", len(all_of_it), self.kind[:-2])  # type: ignore[index]
        sizes = len(all_of_it), self.replay.batch_size
        with products_in(self.agent.settings.matmul_precision):
            return company.room(place, lambda: Learner(self.agent, *sizes, company.device)).learn(all_of_it)


class Learner:
    """Agents side by side.

    Args:
        like: Agent whose sizes and settings all of them have.
        runs: How many there are.
        rows: Transitions of a batch.
        device: Where they learn.
    """

    def __init__(self, like: TD3, runs: int, rows: int, device: torch.device) -> None:
        self.runs, self.rows, self.device, self.settings = runs, rows, device, like.settings
        self.count = like.settings.critics
        n_obs, n_u = like.widths
        self.actors = Stack(like.loss.actor_layers, runs, device)
        self.critics = Stack(like.loss.critic_layers, runs * self.count, device)
        self.target_actors, self.target_critics = self.actors.twin(), self.critics.twin()
        self.averages = self.actors.twin()
        self.optimizers = [
            self._adam(self.critics, like.settings.critic_lr),
            self._adam(self.actors, like.settings.actor_lr),
        ]
        self.kept = self._kept()
        self.home = [stack.twin(torch.device("cpu")) for stack in self.kept]
        widths = {"observation": n_obs, "action": n_u, "next": n_obs, "reward": 1, "ended": 1, "noise": n_u}
        self.batches = {name: torch.zeros(CHUNK, runs, rows, width, device=device) for name, width in widths.items()}
        self.place = torch.zeros(1, dtype=torch.int64, device=device)
        self.losses = torch.zeros(2, CHUNK, runs, device=device)
        self.given: list[tuple[TD3, int, tuple[int, ...]]] = []
        self.steps: dict[tuple[bool, bool], Callable[[], None]] = {}
        # A GPU takes factors of bfloat16 where it may, which it multiplies twice as fast and carries at half the cost.
        low = device.type == "cuda" and like.settings.matmul_precision == "medium"
        self.factors = torch.bfloat16 if low else None
        self._of_critics = compiled(self._critic_losses, device)
        self._of_actors = compiled(self._actor_losses, device)

    def learn(self, all_of_it: Sequence[Learning]) -> list[Exception | None]:
        """Take the updates of all runs, and return what each ended in, None for nothing."""
        agents, first = [work.agent for work in all_of_it], all_of_it[0]
        kinds = [self._kind(first.agent.updates + k + 1) for k in range(first.updates)]
        for kind in sorted(set(kinds)):
            if kind not in self.steps:
                self.given = []
                # What a step changes while it is captured is read from the agents afterwards.
                self.steps[kind] = captured(lambda kind=kind: self._update(*kind), self.device, self.place.zero_)  # type: ignore[misc]
        now = _state_of(agents)
        if self.given != now:
            self._read(agents)
        losses: list[Tensor] = []
        remaining = iter(kinds)
        while chunk := list(islice(remaining, CHUNK)):
            tell("policy learning", sum(len(each) for each in losses), first.updates, "updates")
            self._draw(all_of_it, len(chunk))
            self.place.zero_()
            for kind in chunk:
                self.steps[kind]()
            losses.append(self.losses[:, : len(chunk)].clone().movedim(1, 0))
        sound = torch.stack([stack.sound(self.runs) for stack in self.kept[: len(_WEIGHTS)]]).all(0)
        self._give(agents)
        ends = self._ends(agents, torch.cat(losses).cpu(), kinds, sound.tolist())
        self.given = _state_of(agents)
        return ends

    def _kind(self, number: int) -> tuple[bool, bool]:
        """Return whether the actor and the targets move in an update, counted from 1."""
        s = self.settings
        return number % s.policy_delay == 0, number % s.target_update_interval == 0

    def _update(self, actor: bool, targets: bool) -> None:
        """Take one update of all runs."""
        s = self.settings
        networks = self.critics.flat, self.target_critics.flat, self.target_actors.flat
        self._descend(0, self._of_critics(*networks, self.batches, self.place), self.critics)
        if actor:
            pair = self.actors.flat, self.critics.flat
            self._descend(1, self._of_actors(*pair, self.batches, self.place), self.actors)
            if s.policy_average:
                self.averages.flat.lerp_(self.actors.flat.detach(), s.policy_average)
        if targets:
            self.target_actors.flat.lerp_(self.actors.flat.detach(), s.tau)
            self.target_critics.flat.lerp_(self.critics.flat.detach(), s.tau)
        for optimizer in self.optimizers if s.lr_decay else ():
            optimizer.param_groups[0]["lr"].mul_(1.0 - s.lr_decay)
        self.place.add_(1)

    def _critic_losses(
        self, critics: Tensor, target_critics: Tensor, target_actors: Tensor, batches: dict[str, Tensor], place: Tensor
    ) -> Tensor:
        """Return sum_i mean (Q_i(s, a) - y)^2 of each run, `(R,)`, y = r + gamma min_i Q'_i(s', pi'(s') + noise)."""
        s = self.settings
        batch = _batch(batches, place)
        with torch.no_grad():
            noise = (batch["noise"] * s.policy_noise).clamp(-s.noise_clip, s.noise_clip)
            following = through(self.actors.layers(target_actors), batch["next"], True, self.factors)
            action = (following + noise).clamp(-1.0, 1.0)
            value = self._values(target_critics, batch["next"], action).amin(1)
            value = torch.where(batch["ended"].squeeze(-1) > 0, 0.0, value)
            target = value * s.gamma + batch["reward"].squeeze(-1)
        value = self._values(critics, batch["observation"], batch["action"])
        return (value - target.unsqueeze(1)).square().mean(-1).sum(-1)

    def _actor_losses(self, actors: Tensor, critics: Tensor, batches: dict[str, Tensor], place: Tensor) -> Tensor:
        """Return -mean Q_1(s, pi(s)) of each run, `(R,)`."""
        seen = _batch(batches, place)["observation"]
        action = through(self.actors.layers(actors), seen, True, self.factors)
        first = [
            Layer(*(None if part is None else part.unflatten(0, (self.runs, -1))[:, 0] for part in layer))  # type: ignore[arg-type]
            for layer in self.critics.layers(critics.detach())
        ]
        return -through(first, torch.cat([seen, action], -1), False, self.factors).mean((-2, -1))

    def _values(self, critics: Tensor, observation: Tensor, action: Tensor) -> Tensor:
        """Return what each critic says, `(R, C, B)`."""
        seen = torch.cat([observation, action], -1).repeat_interleave(self.count, 0)
        found = through(self.critics.layers(critics), seen, False, self.factors)
        return found.view(self.runs, self.count, self.rows)

    def _descend(self, which: int, losses: Tensor, stack: Stack) -> None:
        """Take a step of Adam down the losses of all runs, none of which depends on another run's weights."""
        self.losses[which].index_copy_(0, self.place, losses.detach().unsqueeze(0))
        (gradient,) = torch.autograd.grad(losses.sum(), stack.flat)
        if bound := self.settings.max_grad_norm:
            parts = [part for layer in stack.layers(gradient) for part in layer if part is not None]
            squares = [part.reshape(self.runs, -1).square().sum(-1) for part in parts]
            factor = (bound / (torch.stack(squares).sum(0).sqrt() + 1e-6)).clamp_max(1.0)
            for part in parts:
                part.view(self.runs, -1).mul_(factor.unsqueeze(-1))
        stack.flat.grad = gradient
        self.optimizers[which].step()

    def _draw(self, all_of_it: Sequence[Learning], updates: int) -> None:
        """Put the batches of so many updates on the device."""
        for r, work in enumerate(all_of_it):
            replay, generator = work.replay, work.agent.loss.generator
            noise = self._fresh((updates, *self.batches["noise"].shape[2:]), torch.float32)
            drawn(noise, generator)
            self.batches["noise"][:updates, r].copy_(noise, non_blocking=True)
            begin = 0
            for buffer, index in replay.draws(updates, self._fresh):
                places = index.flatten().to(replay.device, non_blocking=True)
                end = begin + index.shape[-1]
                observation, action, following, reward, _, terminated, _ = replay.columns(buffer)
                columns = (observation, action, following, reward, terminated)
                for name, column in zip(("observation", "action", "next", "reward", "ended"), columns, strict=True):
                    found = column.index_select(0, places).view(updates, index.shape[-1], -1)
                    self.batches[name][:updates, r, begin:end].copy_(found)
                begin = end

    def _fresh(self, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
        """Return room in the CPU's memory, from which a GPU reads while the CPU goes on."""
        return torch.empty(shape, dtype=dtype, pin_memory=self.device.type == "cuda")

    def _adam(self, stack: Stack, lr: float) -> Adam:
        gpu = self.device.type == "cuda"
        rate = torch.tensor(lr, device=self.device) if gpu or self.settings.lr_decay else lr
        stack.flat.requires_grad_()
        optimizer = Adam([stack.flat], lr=rate, fused=True, capturable=gpu)
        optimizer.state[stack.flat] = {
            "step": torch.zeros((), device=self.device),
            "exp_avg": torch.zeros_like(stack.flat, requires_grad=False),
            "exp_avg_sq": torch.zeros_like(stack.flat, requires_grad=False),
        }
        return optimizer

    def _kept(self) -> list[Stack]:
        """Return all that the agents keep from one call to the next: weights, targets, averages and Adam's moments."""
        found = [getattr(self, name) for name in _WEIGHTS]
        for optimizer, stack in zip(self.optimizers, (self.critics, self.actors), strict=True):
            for name in ("exp_avg", "exp_avg_sq"):
                moments = copy.copy(stack)
                moments.flat = optimizer.state[stack.flat][name]
                found.append(moments)
        return found

    @torch.no_grad()
    def _read(self, agents: Sequence[TD3]) -> None:
        """Read weights, targets and moments of all agents; steps and rates are the same in all."""
        for r, agent in enumerate(agents):
            mine, theirs = map(list, zip(*self._pairs(agent, r), strict=True))
            torch._foreach_copy_(mine, theirs)
        for stack, home in zip(self.kept, self.home, strict=True):
            stack.flat.copy_(home.flat)
        for optimizer, other in self._optimizers(agents[0]):
            (step, *_) = (state["step"] for state in other.state.values())
            for state in optimizer.state.values():
                state["step"].copy_(step)
            group, rate = optimizer.param_groups[0], other.param_groups[0]["lr"]
            group["lr"].fill_(rate) if isinstance(group["lr"], Tensor) else group.update(lr=rate)

    @torch.no_grad()
    def _give(self, agents: Sequence[TD3]) -> None:
        """Give weights, targets and moments back to all agents."""
        for stack, home in zip(self.kept, self.home, strict=True):
            home.flat.copy_(stack.flat, non_blocking=True)
        if self.device.type == "cuda":
            torch.cuda.current_stream(self.device).synchronize()
        steps, rates = self._steps(), [float(each.param_groups[0]["lr"]) for each in self.optimizers]
        for r, agent in enumerate(agents):
            mine, theirs = map(list, zip(*self._pairs(agent, r), strict=True))
            torch._foreach_copy_(theirs, mine)
            for (_, other), rate, count in zip(self._optimizers(agent), rates, steps, strict=True):
                for state in other.state.values():
                    state["step"].copy_(count)
                other.param_groups[0]["lr"] = rate

    def _steps(self) -> list[Tensor]:
        """Return how many steps each optimiser has taken."""
        return [state["step"].cpu() for optimizer in self.optimizers for state in optimizer.state.values()]

    def _optimizers(self, agent: TD3) -> Iterator[tuple[Adam, Adam]]:
        """Return the optimisers of critics and actor, here and there."""
        return zip(self.optimizers, (agent.critic_optimizer, agent.actor_optimizer), strict=True)

    def _pairs(self, agent: TD3, r: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield where a tensor of a run lies in the memory at home, and there."""
        loss, c = agent.loss, self.count
        averages = agent.deployed.module.layers() if self.settings.policy_average else []
        single, several = (r, r + 1), (r * c, (r + 1) * c)
        actors, critics, target_actors, target_critics, average, *moments = self.home
        for stack, theirs, part in (
            (actors, loss.actor_layers, single),
            (critics, loss.critic_layers, several),
            (target_actors, loss.target_actor_layers, single),
            (target_critics, loss.target_critic_layers, several),
            *([(average, averages, single)] if averages else []),
        ):
            for mine, there in zip(stack.of(*part), _flat(theirs), strict=True):
                yield mine, there.detach().view_as(mine)
        for (first, second), layers, there, part in (
            (moments[:2], loss.critic_layers, agent.critic_optimizer, several),
            (moments[2:], loss.actor_layers, agent.actor_optimizer, single),
        ):
            states = kept_by(there, _flat(layers))
            for name, stack in (("exp_avg", first), ("exp_avg_sq", second)):
                for mine, state in zip(stack.of(*part), states, strict=True):
                    yield mine, state[name].view_as(mine)

    def _ends(
        self, agents: Sequence[TD3], losses: Tensor, kinds: Sequence[tuple[bool, bool]], weights: Sequence[bool]
    ) -> list[Exception | None]:
        """Return what the learning of each run ended in.

        Args:
            agents: The agents.
            losses: Of critics and actors, `(U, 2, R)`.
            kinds: Which updates the actors took part in.
            weights: Whether the weights of each run are finite.
        """
        ends: list[Exception | None] = []
        moved = torch.tensor([actor for actor, _ in kinds])
        for r, agent in enumerate(agents):
            before, agent.updates = agent.updates, agent.updates + len(losses)
            sound = losses[:, 0, r].isfinite() & (losses[:, 1, r].isfinite() | ~moved)
            if moved.any():
                agent.actor_loss = losses[moved, 1, r][-1].clone()
            if bool(sound.all()):
                ends.append(None if weights[r] else _checked(agent))
                continue
            first = int((~sound).int().argmax())
            agent.updates = before + first + 1
            of_critics, of_actor = (float(loss) for loss in losses[first, :, r])
            critics_fail = not math.isfinite(of_critics)
            told = f"the critics' loss is {of_critics}" if critics_fail else f"the actor's loss is {of_actor}"
            ends.append(agent.diverged(told))
        return ends


def _checked(agent: TD3) -> Exception | None:
    """Return what the check of an agent ends in, None for nothing."""
    try:
        agent.check()
    except Diverged as error:
        return error
    return None


def _batch(batches: dict[str, Tensor], place: Tensor) -> dict[str, Tensor]:
    """Return the batches of one update, `(R, B, ...)`."""
    return {name: column.index_select(0, place).squeeze(0) for name, column in batches.items()}


def _flat(layers: Sequence[Layer]) -> list[Any]:
    """Return the tensors of layers in a row."""
    return [part for layer in layers for part in layer if part is not None]


def _state_of(agents: Sequence[TD3]) -> list[tuple[TD3, int, tuple[int, ...]]]:
    """Return what tells whether agents are as they were left; what learns by machine code counts its updates."""
    found = []
    for agent in agents:
        layers = (*agent.loss.actor_layers, *agent.loss.critic_layers)
        found.append((agent, agent.updates, tuple(weight._version for weight in _flat(layers))))
    return found
