"""Ways to a rest from afar, found in the model: a cross-entropy search over input signals.

A swing-up has no gradient that leads there: a hanging pole that leans a little is a local optimum of every policy. So
whole input signals are drawn, `POPULATION` for each start, and drawn anew around the best of them (Rubinstein 1999).

| name      | symbol | equation                                                                              |
| --------- | ------ | ------------------------------------------------------------------------------------- |
| signal    | u_k    | straight lines through knots `KNOT` periods apart, within the limits of inputs         |
| objective | J      | sum_k w_k reward_k, w_k proportional to k^2: arriving counts, the way there hardly     |
| redrawn   | m, s   | mean and deviation of the best `ELITE` of the knots, s no less than `LEAST`            |
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.progress import track
from dynasindy.systems import integrate
from dynasindy.tasks import Tracking

POPULATION, ELITE, ROUNDS = 1024, 0.1, 30
"""Signals per start, the share of them around which is drawn anew, and how often."""
KNOT = 4
"""Control periods between two knots of a signal."""
LEAST, LARGEST = 0.03, 1.5
"""Least deviation of the knots, and their largest size."""
FAR = 20.0
"""Ranges of a state beyond which a signal counts as none."""
OUTSIDE = 1e3
"""Cost of each control period outside of the limits of the plant, beyond the highest within them."""


@dataclass(frozen=True)
class Trajectory:
    """One start's best signal, and where it leads.

    Attributes:
        states: `(T + 1, n_x)`.
        inputs: `(T, n_u)`.
    """

    states: Tensor
    inputs: Tensor


@torch.no_grad()
def search(env: ControlEnv, x: Tensor, params: Tensor, periods: int, rng: torch.Generator) -> list[Trajectory]:
    """Return the best way that was found from each start.

    Args:
        env: Imagined environment, of which the model, the task's reward and its bounds are used.
        x: Starts, `(n, n_x)`.
        params: Their task parameters, `(n, *params_shape)`.
        periods: Length T of the ways [control periods].
        rng: Source of the signals.
    """
    n, n_u, knots = len(x), env.system.signature.n_u, max(2, periods // KNOT)
    starts, repeated = x.repeat_interleave(POPULATION, 0), params.repeat_interleave(POPULATION, 0)

    def _earned(drawn: Tensor) -> Tensor:
        return _objective(env, roll(env, starts, signal(drawn, periods, env.task.limit)), repeated)

    rounds = track("search for ways from afar", range(ROUNDS), ROUNDS, "rounds")
    found = cross_entropy(_earned, torch.zeros(n, knots, n_u), POPULATION, rounds, LARGEST, rng)
    inputs = signal(found, periods, env.task.limit)
    states = roll(env, x, inputs)
    return [Trajectory(states[:, i], inputs[:, i]) for i in range(n)]


@torch.no_grad()
def cross_entropy(
    earned: Callable[[Tensor], Tensor],
    first: Tensor,
    population: int,
    rounds: Iterable[object],
    largest: float,
    rng: torch.Generator,
) -> Tensor:
    """Return the best knots of each start that were drawn, `(n, n_knots, n_u)`.

    They are drawn from normal distributions, which are fitted anew to the best share of them (Rubinstein 1999).

    Args:
        earned: What knots `(n population, n_knots, n_u)` earn, `(n population,)`.
        first: Knots that are among the first drawn, and their mean, `(n, n_knots, n_u)`.
        population: Draws per start.
        rounds: How often is drawn: as many items.
        largest: Largest size of a knot.
        rng: Source of the draws.
    """
    n, each = len(first), torch.arange(len(first))
    best, most = first, torch.full((n,), -torch.inf)
    mean, deviation = first.unsqueeze(1), torch.ones_like(first).unsqueeze(1)
    for _ in rounds:
        drawn = mean + deviation * torch.randn(n, population, *first.shape[1:], generator=rng)
        drawn[:, 0] = best
        drawn = drawn.clamp(-largest, largest)
        found = earned(drawn.flatten(0, 1)).reshape(n, population)
        top = found.topk(round(ELITE * population), 1).indices
        elite = drawn[each.unsqueeze(-1), top]
        mean, deviation = elite.mean(1, keepdim=True), elite.std(1, keepdim=True).clamp_min(LEAST)
        better = found[each, top[:, 0]] > most
        most = torch.where(better, found[each, top[:, 0]], most)
        best = torch.where(better[:, None, None], drawn[each, top[:, 0]], best)
    return best


def signal(knots: Tensor, periods: int, limit: Callable[[Tensor], Tensor]) -> Tensor:
    """Return the straight lines through knots `(n, n_knots, n_u)`, within the limits of inputs, `(periods, n, n_u)`."""
    lines = torch.nn.functional.interpolate(knots.mT, size=periods, mode="linear", align_corners=True)
    return limit(lines.permute(2, 0, 1))


@torch.no_grad()
def roll(env: ControlEnv, x: Tensor, inputs: Tensor) -> Tensor:
    """Return the states `(T + 1, n, n_x)` from starts `(n, n_x)` under inputs `(T, n, n_u)`."""
    states = [x]
    for u in inputs:
        states.append(integrate(env.system, states[-1], u, env.dt, env.substeps, env.stops)[0][..., -1, :])
    return torch.stack(states)


def _objective(env: ControlEnv, states: Tensor, params: Tensor) -> Tensor:
    """Return what ways earn, their ends above all, `(n,)`; outside of the plant's limits they pay."""
    periods, task = len(states) - 1, env.task
    assert isinstance(task, Tracking)
    times = (env.dt * torch.arange(1, periods + 1, dtype=states.dtype)).reshape(-1, 1, 1)
    free = torch.zeros(states[1:].shape[:-1], dtype=torch.bool)
    reward = task.reward(states[:-1], states[1:], params.expand(periods, *params.shape), times, free)
    low, high = task.bounds.to(states)
    scale = torch.tensor(task.signature.x_scale)
    outside = ~((states[1:] >= low) & (states[1:] <= high)).all(-1)
    lost = (~(states[1:].abs() <= FAR * scale + states[0].abs()).all(-1)).int().cummax(0).values.bool()
    sound = ~(outside | lost)
    # Whatever is paid within the limits, leaving them costs more, and running away more still, to the end.
    worst = reward[sound].amin().clamp_max(0.0) if bool(sound.any()) else reward.new_zeros(())
    reward = torch.where(outside, worst - OUTSIDE, reward)
    reward = torch.where(lost, 2 * worst - FAR * OUTSIDE, reward)
    weights = torch.arange(1, periods + 1, dtype=states.dtype).square()
    return ((weights / weights.sum()).unsqueeze(-1) * reward).sum(0)
