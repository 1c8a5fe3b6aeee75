"""A law that brings a plant home from afar: ways to its rest, and a regulator along each of them.

| name     | symbol   | equation                                                                               |
| -------- | -------- | -------------------------------------------------------------------------------------- |
| points   | x_i, u_i | of ways to the rest of their reference, counted from there; the rest itself is one     |
| value    | P_i      | Riccati's difference equation back along the way, from that of the rest's regulator    |
| gain     | K_i      | the same                                                                               |
| nearest  | i        | least of 30 ((x - x_i) / range)^2 + ln(1 + (x - x_i)' P_i (x - x_i))                   |
| law      | u        | u_i - K_i (x - x_i), within the limits of inputs                                       |

Value alone is no distance: along a way that runs away without control P_i grows by orders of magnitude.

A swing-up has no gradient that leads there: a hanging pole that leans a little is a local optimum of every policy. So
ways are found by a cross-entropy search: whole input signals are drawn, `POPULATION` for each start, and drawn anew
around the best of them (Rubinstein 1999).

| name      | symbol | equation                                                                              |
| --------- | ------ | ------------------------------------------------------------------------------------- |
| signal    | u_k    | straight lines through knots `KNOT` periods apart, within the limits of inputs         |
| objective | J      | -min_k ln v_k, v_k the regulator's value within the plant's limits: it need only catch |
| redrawn   | m, s   | mean and deviation of the best `ELITE` of the knots, s no less than `LEAST`            |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.planning.regulator import Regulator
from dynasindy.planning.rollout import Network, Rows, Window, imagine, sensitivities
from dynasindy.progress import track
from dynasindy.systems import simulate
from dynasindy.systems.equilibria import Equilibria

POPULATION, ELITE, ROUNDS = 1024, 0.1, 30
"""Signals per start, the share of them around which is drawn anew, and how often."""
KNOT = 4
"""Control periods between two knots of a signal."""
LEAST, LARGEST = 0.03, 1.5
"""Least deviation of the knots, and their largest size."""
LEAST_VALUE = 1e-6
"""Value of the regulator that is as good as none."""
STARTS = 24
"""Starts from which ways are searched."""
LENGTHS = (20, 40, 60, 80, 120, 160)
"""Lengths of the ways that are tried, the shorter first [control periods]."""
WATCHED, STILL, NEAR = 100, 20, 0.05
"""A plant is caught if the regulator has it within 5 % of its ranges in the last 20 of 100 control periods."""
INPUT_NOISE = 0.2
"""Standard deviation of the errors of inputs that a way is to bear."""
TRIED = 5
"""Points of a way at which the regulator is tried, the nearest to the rest first."""
WEIGHTS = 10.0, 1.0
"""Weights of outputs and states of the regulator at rest."""
NEARNESS = 30.0
"""Weight of the distance in ranges against that of the value."""
CHUNK = 8_000_000
"""Numbers of the distances between some observations and all points that are computed at once."""
AROUND = 0.1
"""Distance from the ways at which imagined episodes begin [ranges of the states]."""


class TrajectoryLibrary:
    """The law, read from observations.

    Args:
        regulator: Regulator of the rest, which knows the rest of each reference.
        points: States of the ways, counted from the rest, `(n, n_x)`.
        inputs: Likewise, `(n, n_u)`.
        gains: `(n, n_u, n_x)`.
        values: `(n, n_x, n_x)`.
    """

    def __init__(self, regulator: Regulator, points: Tensor, inputs: Tensor, gains: Tensor, values: Tensor) -> None:
        self.regulator, self.points, self.inputs, self.gains, self.values = regulator, points, inputs, gains, values
        self.scale = torch.tensor(regulator.task.signature.x_scale)

    @classmethod
    def of(cls, env: ControlEnv, rests: Equilibria, rng: torch.Generator) -> tuple[TrajectoryLibrary | None, int]:
        """Return the law of a model, and the control periods that were imagined for it.

        There is none where no regulator holds the model, or no way leads to where one does.

        Args:
            env: Imagined environment.
            rests: Equilibria of its model.
            rng: Source of starts and signals.
        """
        regulator = Regulator.of(env, rests, *WEIGHTS)
        if regulator is None:
            return None, 0
        rows = Rows.draw(env, STARTS, rng)
        caught, imagined = _find_caught_trajectories(env, regulator, rows, rng)
        reference = env.task.reference(rows.params, rows.t).float()
        parts = {i: _along(env, regulator, way, reference[i]) for i, way in caught.items()}
        # As few ways as bring all starts home, those that do so though inputs err: between many a policy has to change,
        # and its inputs are never quite those that it imitates.
        law, most, periods = None, (0, 0), max([len(part[1]) for part in parts.values()], default=0)
        chosen: list[int] = []
        while most[0] < len(rows.x) and (left := parts.keys() - {*chosen}):
            laws = {i: cls._along_ways(regulator, [parts[k] for k in (*chosen, i)]) for i in left}
            home = {i: each._count_arrivals(env, rows, periods, rng) for i, each in laws.items()}
            if home[best := max(home, key=home.__getitem__)][0] <= most[0]:
                break
            law, most, chosen = laws[best], home[best], [*chosen, best]
        return law, imagined

    @classmethod
    def _along_ways(cls, regulator: Regulator, parts: Sequence[tuple[Tensor, ...]]) -> TrajectoryLibrary:
        """Return the law of what `_along` returned of some ways."""
        return cls(regulator, *(torch.cat(part) for part in zip(*parts, strict=True)))

    def _count_arrivals(self, env: ControlEnv, rows: Rows, periods: int, rng: torch.Generator) -> tuple[int, int]:
        """Return how many rows the law brings to rest, and how many where its inputs err for so many periods."""
        erring = iter(range(periods))

        def _noisy(observation: Tensor) -> Tensor:
            u = self(observation)
            errs = next(erring, None) is not None
            return self.regulator.task.limit(u + INPUT_NOISE * torch.randn(u.shape, generator=rng)) if errs else u

        laws: tuple[Network, ...] = self, _noisy
        exact, rough = (_imagine_to_rest(env, law, self.regulator, rows, periods + WATCHED)[2].sum() for law in laws)
        return int(exact), int(rough)

    def __call__(self, observation: Tensor) -> Tensor:
        """Return inputs `(*batch, n_u)` for observations `(*batch, n_o)`."""
        rows = observation.reshape(-1, observation.shape[-1])
        some = max(1, CHUNK // (len(self.points) * len(self.scale)))
        return torch.cat([self._act(part) for part in rows.split(some)]).reshape(*observation.shape[:-1], -1)

    def _act(self, observation: Tensor) -> Tensor:
        x, reference = self.regulator.task.seen(observation)
        x_e, u_e = self.regulator.rest(reference)
        away = (x - x_e).unsqueeze(1) - self.points
        value = torch.einsum("nmi,mij,nmj->nm", away, self.values, away).clamp_min(0.0)
        nearest = (NEARNESS * (away / self.scale).square().sum(-1) + torch.log1p(value)).argmin(1)
        away = away[torch.arange(len(x)), nearest]
        u = u_e + self.inputs[nearest] - torch.einsum("nij,nj->ni", self.gains[nearest], away)
        return self.regulator.task.limit(u)

    def near(self, reference: Tensor, rng: torch.Generator) -> Tensor:
        """Return states around the ways to the rests of references `(n, n_r)`, `(n, n_x)`."""
        pick = torch.randint(len(self.points), (len(reference),), generator=rng)
        x = self.regulator.rest(reference)[0] + self.points[pick]
        return x + AROUND * self.scale * torch.randn(x.shape, generator=rng)


class _Trajectory(NamedTuple):
    """A way from one start to the rest: states `(T + 1, n_x)` and inputs `(T, n_u)`."""

    states: Tensor
    inputs: Tensor


def _find_caught_trajectories(
    env: ControlEnv, regulator: Regulator, rows: Rows, rng: torch.Generator
) -> tuple[dict[int, _Trajectory], int]:
    """Return ways to the rest, by the number of their start, and what was imagined."""
    found, imagined = _catch(env, regulator, rows), 0
    reference = env.task.reference(rows.params, rows.t).float()
    for periods in (length for length in LENGTHS if length <= env.task.max_steps):
        left = [i for i in range(len(rows.x)) if i not in found]
        if not left:
            break
        ways = _search(env, regulator, rows.x[left], reference[left], periods, rng)
        imagined += len(left) * POPULATION * ROUNDS * periods
        rank = _log_values(regulator, ways.states, reference[left]).argsort(0)
        for k in rank[:TRIED]:
            here = Rows.start(ways.states[k, torch.arange(len(left))], rows.params[left], rows.held.shape[1])
            for j, end in _catch(env, regulator, here).items():
                states, inputs = ways.states[: k[j], j], ways.inputs[: k[j], j]
                found.setdefault(left[j], _Trajectory(torch.cat([states, end.states]), torch.cat([inputs, end.inputs])))
    return found, imagined


def _catch(env: ControlEnv, regulator: Regulator, rows: Rows) -> dict[int, _Trajectory]:
    """Return the ways on which the regulator brings the model to rest, by the place of the row where they begin.

    They belong to the law: a state on them is nearer to the end of what was searched than to the rest.
    """
    whole, reference, rests = _imagine_to_rest(env, regulator, regulator, rows, WATCHED)
    away = (~regulator.home(whole.states, reference, NEAR)).int().flip(0)
    lengths = torch.where(away.any(0), len(away) - away.argmax(0), 0).tolist()
    return {
        i: _Trajectory(whole.states[: lengths[i] + 1, i], whole.applied[: lengths[i], i])
        for i in rests.nonzero().flatten().tolist()
    }


def at_rest(env: ControlEnv, law: Network, regulator: Regulator, rows: Rows, periods: int) -> Tensor:
    """Return which imagined episodes rest at their reference in the end, or are on their way there, bool `(rows,)`.

    An episode may be too short for a slow plant. It is on its way where the regulator's value falls in each third of
    its end, and in all as the square of a motion that takes twice the time of the regulator's slowest one.

    Args:
        env: Imagined environment.
        law: What acts, observations to inputs.
        regulator: Regulator of the model, which knows the rest of each reference.
        rows: Where the episodes begin.
        periods: Their length [control periods].
    """
    whole, reference, rests = _imagine_to_rest(env, law, regulator, rows, periods)
    value = regulator.value(whole.states[-STILL:], reference)
    thirds = value[torch.linspace(0, len(value) - 1, 4).round().long()]
    falls = (thirds.diff(dim=0) < 0).all(0) & (value[-1] < math.exp(-len(value) / regulator.slowest) * value[0])
    return rests | (whole.alive[-1] & falls)


@torch.no_grad()
def _imagine_to_rest(
    env: ControlEnv, law: Network, regulator: Regulator, rows: Rows, periods: int
) -> tuple[Window, Tensor, Tensor]:
    """Return imagined episodes, their references, and which of them rest there in the end."""
    whole = imagine(env, law, replace(rows, kept=False), periods)
    reference = env.task.reference(rows.params, torch.full_like(rows.t, periods * env.dt)).float()
    return whole, reference, regulator.home(whole.states[-STILL:], reference, NEAR).all(0) & whole.alive[-1]


def _along(
    env: ControlEnv, regulator: Regulator, way: _Trajectory, reference: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return points, inputs, gains and values of the rest and of a way, all counted from the rest."""
    x_e, u_e = regulator.rest(reference)
    gain, value = regulator.gain, regulator.cost
    gains, values = [gain], [value]
    if len(way.inputs):
        a, b = sensitivities(env, way.states[:-1], way.inputs)
    for k in range(len(way.inputs) - 1, -1, -1):
        gain = torch.linalg.solve(torch.eye(len(gain)) + b[k].mT @ value @ b[k], b[k].mT @ value @ a[k])
        value = regulator.squares + a[k].mT @ value @ (a[k] - b[k] @ gain)
        value = 0.5 * (value + value.mT)
        gains.append(gain)
        values.append(value)
    x = torch.cat([x_e[None], way.states[:-1].flip(0)]) - x_e
    u = torch.cat([u_e[None], way.inputs.flip(0)]) - u_e
    return x, u, torch.stack(gains), torch.stack(values)


@torch.no_grad()
def _search(
    env: ControlEnv, regulator: Regulator, x: Tensor, reference: Tensor, periods: int, rng: torch.Generator
) -> _Trajectory:
    """Return the ways of so many periods from starts `(n, n_x)` that come nearest to rest, with n behind time."""
    starts, repeated = x.repeat_interleave(POPULATION, 0), reference.repeat_interleave(POPULATION, 0)

    def _nearest(drawn: Tensor) -> Tensor:
        states = _roll(env, starts, signal(drawn, periods, env.task.limit))
        return -_log_values(regulator, states, repeated).amin(0)

    rounds = track("search for ways from afar", range(ROUNDS), ROUNDS, "rounds")
    knots = torch.zeros(len(x), max(2, periods // KNOT), env.system.signature.n_u)
    inputs = signal(cross_entropy(_nearest, knots, POPULATION, rounds, LARGEST, rng), periods, env.task.limit)
    return _Trajectory(_roll(env, x, inputs), inputs)


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
def _roll(env: ControlEnv, x: Tensor, inputs: Tensor) -> Tensor:
    """Return the states `(T + 1, n, n_x)` from starts `(n, n_x)` under inputs `(T, n, n_u)`."""
    samples, _ = simulate(env.system, x, inputs, env.dt, env.substeps, env.stops)
    return torch.cat([x.unsqueeze(0), samples[..., -1, :]])


def _log_values(regulator: Regulator, states: Tensor, reference: Tensor) -> Tensor:
    """Return the logarithm of the regulator's value along ways, `(T + 1, n)`, infinite once the limits are left."""
    low, high = regulator.task.bounds.to(states)
    value = regulator.value(states, reference)
    inside = ((states >= low) & (states <= high)).all(-1) & value.isfinite()  # what runs away has no value
    return value.clamp_min(LEAST_VALUE).log().where(inside.int().cummin(0).values.bool(), torch.inf)
