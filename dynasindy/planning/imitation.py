"""The policy to begin with on a plant that has to be held: a law of the model that a network learns to imitate.

The laws are linear-quadratic regulators, and, where none of them brings every episode home, ways to the rest from afar
(`dynasindy.planning.paths`). A network imitates where the law leads, then where the network itself leads (DAgger, Ross
et al. 2011).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor, nn

from dynasindy.envs import ControlEnv
from dynasindy.planning.paths import NEAR, STILL, WEIGHTS, Paths
from dynasindy.planning.regulator import Regulator, Weights
from dynasindy.planning.rests import Rests
from dynasindy.planning.window import Network, Rows, imagine
from dynasindy.progress import track
from dynasindy.tasks import Tracking

LADDER = (0.003, 0.03, 0.3, 3.0, 30.0, 300.0)
"""Weights of the tracked states that are tried; a plant of many poles is caught by gentle laws alone."""
REGULATED, FROM_AFAR = (3, 600), (6, 1500)
"""Rounds of imitation and updates in each, of a regulator and of ways from afar, which bend more."""
BATCH = 512
"""Observations of an update."""
ROWS, PERIODS = 96, 150
"""Imagined episodes and their length in a round of imitation."""


class Law(Protocol):
    """What can be imitated."""

    def __call__(self, observation: Tensor) -> Tensor:
        """Return inputs `(*batch, n_u)` for observations `(*batch, n_o)`."""

    def near(self, reference: Tensor, rng: torch.Generator) -> Tensor:
        """Return states `(n, n_x)` for references `(n, n_r)` about which the law has something to say."""


@dataclass(frozen=True)
class Begun:
    """How a policy begins.

    Attributes:
        score: What it earns in the model.
        afar: Whether it imitates ways from afar.
        imagined: Control periods that the search for ways has imagined.
        updates: Gradient updates of the imitation.
    """

    score: float
    afar: bool = False
    imagined: int = 0
    updates: int = 0


def hold(
    network: nn.Module, env: ControlEnv, rests: Rests, score: Callable[[Network], float], rng: torch.Generator
) -> Begun:
    """Let a policy begin as the best of some laws, if that earns more than the policy as it is.

    Args:
        network: Policy, observations to inputs; trained in place.
        env: Imagined environment.
        rests: Rests of its model.
        score: What a policy earns in the model.
        rng: Source of starts, references and batches.
    """
    # Departure: the paper's policy begins with random weights; on a plant that runs away ours begins as a law of the
    # model.
    best, before = score(network), copy.deepcopy(network.state_dict())
    regulators = [Regulator.of(env, rests, replace(Weights(), outputs=weight)) for weight in LADDER]
    earned: dict[float, Law] = {score(law): law for law in regulators if law is not None}
    afar, imagined = False, 0
    if earned and not arrives(earned[max(earned)], env, rests, rng):
        paths, imagined = Paths.of(env, rests, rng)
        if paths is not None and (scored := score(paths)) > max(earned):
            afar, earned[scored] = True, paths
    if not earned or max(earned) <= best:
        return Begun(best, imagined=imagined)
    lessons = FROM_AFAR if afar else REGULATED
    imitate(network, earned[max(earned)], env, rng, lessons)
    if (imitated := score(network)) > best:
        return Begun(imitated, afar, imagined, math.prod(lessons))
    network.load_state_dict(before)
    return Begun(best, False, imagined, math.prod(lessons))


@torch.no_grad()
def arrives(pilot: Network, env: ControlEnv, rests: Rests, rng: torch.Generator) -> bool:
    """Return whether a policy brings every imagined episode to rest; of a moving reference nothing is asked.

    Args:
        pilot: Policy, observations to inputs.
        env: Imagined environment.
        rests: Rests of its model.
        rng: Source of starts and references.
    """
    task, batch = env.task, torch.Size((ROWS,))
    assert isinstance(task, Tracking)
    params, end = task.sample(batch, rng), torch.full((ROWS, 1), task.max_steps * env.dt)
    reference = task.reference(params, end).float()
    regulator = Regulator.of(env, rests, WEIGHTS)
    if regulator is None or not torch.allclose(reference, task.reference(params, 0 * end).float()):
        return True
    x = task.initial_state(batch, rng).float()
    rows = Rows(x, torch.zeros(ROWS, env.system.signature.n_u), params, torch.zeros(ROWS, 1))
    rows.reach = _reach(task, x)
    whole = imagine(env, env.system, pilot, rows, task.max_steps)
    return bool((regulator.home(whole.states[-STILL:], reference, NEAR) & whole.alive[-1]).all())


def imitate(
    network: nn.Module, law: Law, env: ControlEnv, rng: torch.Generator, lessons: tuple[int, int] = REGULATED
) -> None:
    """Train a policy to act as a law does, where the law leads and then where the policy itself leads.

    Args:
        network: Policy, observations to inputs; trained in place.
        law: What to imitate.
        env: Imagined environment.
        rng: Source of starts, references and batches.
        lessons: How often episodes are imagined, and the updates after each time.
    """
    (rounds, steps), seen, told = lessons, [], []
    for k in track("imitation of a regulator", range(rounds), rounds, "rounds"):
        pilot: Network = network if k else _trembling(law, env.task.limit, rng)
        seen.append(_visited(pilot, law, env, rng))
        told.append(law(seen[-1]))
        lesson(network, torch.cat(seen), torch.cat(told), steps, rng)


def lesson(network: nn.Module, observations: Tensor, wanted: Tensor, steps: int, rng: torch.Generator) -> None:
    """Train a policy to give inputs `(n, n_u)` for observations `(n, n_o)`, by least squares.

    Args:
        network: Policy; trained in place.
        observations: What it sees.
        wanted: What it is to do.
        steps: Gradient updates.
        rng: Source of the batches.
    """
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3, betas=(0.9, 0.99), fused=True)
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = 3e-3 * (1 - step / steps) ** 2 + 1e-5
        pick = torch.randint(len(observations), (BATCH,), generator=rng)
        loss = (network(observations[pick]) - wanted[pick]).square().mean()
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()


@torch.no_grad()
def _visited(pilot: Network, law: Law, env: ControlEnv, rng: torch.Generator) -> Tensor:
    """Return observations along imagined episodes, half of them begun around rests, `(n, n_o)`."""
    task, batch = env.task, torch.Size((ROWS,))
    assert isinstance(task, Tracking)
    params, zero = task.sample(batch, rng), torch.zeros(ROWS, 1)
    other = task.reference(task.sample(batch, rng), zero)
    x = task.initial_state(batch, rng).float()
    x[::2] = law.near(other, rng)[::2]
    rows = Rows(x, torch.zeros(ROWS, env.system.signature.n_u), params, zero)
    rows.reach = _reach(task, x)
    whole = imagine(env, env.system, pilot, rows, min(PERIODS, task.max_steps))
    alive = whole.alive[:-1]
    observed = task.observation(whole.states[:-1], params.expand(len(alive), *params.shape), whole.times[:-1])
    return observed[alive].float()


def _reach(task: Tracking, x: Tensor) -> Tensor:
    """Return magnitudes of the states beyond which an episode from starts `(n, n_x)` has run away, `(n_x,)`."""
    return torch.maximum(20.0 * torch.tensor(task.signature.x_scale), 4 * x.abs().amax(0))


def _trembling(law: Law, limit: Callable[[Tensor], Tensor], rng: torch.Generator) -> Network:
    """Return the law with noise on its inputs, which shows more of the plant."""

    def _act(observation: Tensor) -> Tensor:
        u = law(observation)
        return limit(u + 0.1 * torch.randn(u.shape, generator=rng))

    return _act
