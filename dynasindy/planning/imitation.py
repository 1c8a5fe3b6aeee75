"""The policy to begin with on a plant that has to be held: a law of the model that a network learns to imitate.

The laws are linear-quadratic regulators, and, where none of them brings every episode home, ways to the rest from afar
(`dynasindy.planning.trajectory_library`). A network imitates where the law leads, then where the network itself leads
(DAgger, Ross et al. 2011).

It imitates what the gradient cannot find, too: signals on top of the policy that earn more in the model.
Where two ways lead to the same end, one swing more or less, a policy changes from one to the other at a border in the
space of states. No gradient moves that border, as it follows each way alone. So signals are searched that lead over it,
by cross-entropy as there; once a signal is over, the policy acts alone.

| name      | symbol | equation                                                                                  |
| --------- | ------ | ----------------------------------------------------------------------------------------- |
| input     | u_k    | limit(pi(o_k) + s_k), s_k = 0 after `ACTING` of the way                                    |
| signal    | s_k    | straight lines through knots `KNOT` periods apart, none at first: the policy as it is      |
| objective | J      | what the way earns in the model                                                            |
| imitated  |        | least squares of pi(o_k) to u_k along the best way from each start                         |
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from dynasindy.envs import ControlEnv, Tracking
from dynasindy.planning.regulator import Regulator
from dynasindy.planning.rollout import Network, Rows, Window, imagine
from dynasindy.planning.trajectory_library import WEIGHTS, TrajectoryLibrary, at_rest, cross_entropy, signal
from dynasindy.progress import track
from dynasindy.systems.equilibria import Equilibria

if TYPE_CHECKING:
    from dynasindy.planning.gradient_planning import GradientPlanning

LADDER = (0.003, 0.03, 0.3, 3.0, 30.0, 300.0)
"""Weights of the tracked states that are tried; a plant of many poles is caught by gentle laws alone."""
REGULATED, FROM_AFAR = (3, 600), (6, 1500)
"""Rounds of imitation and updates in each, of a regulator and of ways from afar, which bend more."""
BATCH = 512
"""Observations of an update."""
ROWS, PERIODS = 96, 150
"""Imagined episodes and their length in a round of imitation."""


Law = Regulator | TrajectoryLibrary
"""What can be imitated."""


@dataclass(frozen=True)
class Imitation:
    """What came of a part of a planning phase, an imitation or a descent.

    Attributes:
        score: What the policy earns in the model.
        imagined: Control periods that were imagined for it.
        updates: Gradient updates of it.
        afar: Whether it imitates ways from afar.
    """

    score: float
    imagined: int = 0
    updates: int = 0
    afar: bool = False


def hold(planner: GradientPlanning, rests: Equilibria, keep: bool | None = None) -> Imitation:
    """Let a policy begin as the best of some laws, if that earns more than the policy as it is.

    Args:
        planner: Its policy is trained in place. The inputs of the episodes by which it is tested are in time from now
            on if ways from afar are taken, or if no regulator bears that they are late.
        rests: Equilibria of its model.
        keep: Whether a policy that holds the plant is left as it is. If omitted, delays are taken to be borne, and no
            ways from afar are searched for where no regulator brings every episode home.
    """
    # Departure: the paper's policy begins with random weights; on a plant that runs away ours begins as a law of the
    # model.
    network, env, rows, score, rng = planner.network, planner.env, planner.held_out, planner.test, planner.rng
    laws, search = _regulators(env, rests), keep is not None
    if search and rows.late is not None and not _bears_delay(laws, env, rows):
        rows.late = None  # a plant that runs away within a period or two is held by inputs in time alone
    if keep and _arrives(network, env, rests, rng):
        return Imitation(score(network))  # it is given up for a better one only
    best, before = score(network), copy.deepcopy(network.state_dict())
    earned: dict[float, Law] = {score(law): law for law in laws}
    afar, imagined, late = False, 0, rows.late
    if search and earned and not _arrives(earned[max(earned)], env, rests, rng):
        paths, imagined = TrajectoryLibrary.of(env, rests, rng)
        rows.late = None  # a way is timed for inputs that act at once
        if paths is not None and (scored := score(paths)) > max(map(score, laws)):
            afar, best, earned = True, score(network), {scored: paths}
        else:
            rows.late = late
    if not earned or max(earned) <= best:
        return Imitation(best, imagined)
    lessons = FROM_AFAR if afar else REGULATED
    _imitate(network, earned[max(earned)], env, rng, lessons)
    kept = (imitated := score(network)) > best
    if not kept:
        network.load_state_dict(before)
    return Imitation(max(imitated, best), imagined, math.prod(lessons), afar and kept)


def _regulators(env: ControlEnv, rests: Equilibria) -> list[Regulator]:
    found = [Regulator.of(env, rests, weight) for weight in LADDER]
    return [law for law in found if law is not None]


def _bears_delay(laws: list[Regulator], env: ControlEnv, rows: Rows) -> bool:
    """Return whether a law brings episodes home whose inputs are late, or none those whose inputs are in time."""

    def _held(law: Regulator, rows: Rows) -> bool:
        return bool(at_rest(env, law, law, rows, env.task.max_steps).all())

    in_time = replace(rows, late=None)
    return any(_held(law, rows) for law in laws) or not any(_held(law, in_time) for law in laws)


def _arrives(pilot: Network, env: ControlEnv, rests: Equilibria, rng: torch.Generator) -> bool:
    """Return whether a policy brings every imagined episode to rest; of a moving reference nothing is asked."""
    task, batch = env.task, torch.Size((ROWS,))
    params, begin = task.sample(batch, rng), torch.zeros(ROWS, 1)
    regulator = Regulator.of(env, rests, *WEIGHTS)
    assert isinstance(task, Tracking)
    first, last = (task.reference(params, t).float() for t in (begin, begin + task.max_steps * env.dt))
    if regulator is None or not torch.allclose(last, first):
        return True
    rows = _rows(env, task.initial_state(batch, rng), params)
    return bool(at_rest(env, pilot, regulator, rows, task.max_steps).all())


def _imitate(
    network: nn.Module, law: Law, env: ControlEnv, rng: torch.Generator, lessons: tuple[int, int] = REGULATED
) -> None:
    """Train a policy to act as a law does, where the law leads and then where the policy itself leads."""
    (rounds, steps), seen, told, task, batch = lessons, [], [], env.task, torch.Size((ROWS,))
    assert isinstance(task, Tracking)

    def _trembling(observation: Tensor) -> Tensor:  # the noise shows more of the plant
        u = law(observation)
        return env.task.limit(u + 0.1 * torch.randn(u.shape, generator=rng))

    for k in track("imitation of a regulator", range(rounds), rounds, "rounds"):
        # Imagined episodes, half of them begun around rests.
        params, other = task.sample(batch, rng), task.reference(task.sample(batch, rng), torch.zeros(ROWS, 1))
        x = task.initial_state(batch, rng).float()
        x[::2] = law.near(other, rng)[::2]
        pilot = network if k else _trembling
        whole = imagine(env, pilot, _rows(env, x, params), min(PERIODS, task.max_steps))
        with torch.no_grad():
            seen.append(whole.observations(task)[whole.alive[:-1]].float())
        told.append(law(seen[-1]))
        _lesson(network, torch.cat(seen), torch.cat(told), steps, rng)


def _lesson(network: nn.Module, observations: Tensor, wanted: Tensor, steps: int, rng: torch.Generator) -> None:
    """Train a policy to give inputs `(n, n_u)` for observations `(n, n_o)`, by least squares."""
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3, betas=(0.9, 0.99), fused=True)
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = 3e-3 * (1 - step / steps) ** 2 + 1e-5
        pick = torch.randint(len(observations), (BATCH,), generator=rng)
        loss = (network(observations[pick]) - wanted[pick]).square().mean()
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()


def _rows(env: ControlEnv, x: Tensor, params: Tensor) -> Rows:
    """Return episodes from starts `(n, n_x)` that are over where they have run away."""
    signature, rows = env.system.signature, Rows.start(x, params, env.system.signature.n_u)
    rows.reach = torch.maximum(20.0 * torch.tensor(signature.x_scale), 4 * rows.x.abs().amax(0))
    return rows


STARTS, POPULATION, DRAWS = 128, 64, 8
"""Starts of a round, signals for each, and how often they are drawn."""
ACTING, KNOT, MOST = 0.6, 6, 2.0
"""Share of a way on which a signal acts, control periods between its knots, and their largest size; with 2 it decides
the input, whatever the policy says."""
PATIENCE, UPDATES = 3, 3000
"""Rounds in a row without a better policy after which it is given up, and updates of the imitation in a round."""
GAINED = 0.1
"""Share of the largest gain of a round from which a way is imitated in the later rounds, too: it leads over a border,
about which few ways tell."""


def improve(planner: GradientPlanning) -> Imitation:
    """Improve a planner's policy by ways that earn more than its own; it is left as the best that it was."""
    network, env, rng, periods = planner.network, planner.env, planner.rng, planner.pace.window
    best, weights, imagined, updates, failures = planner.test(), copy.deepcopy(network.state_dict()), 0, 0, 0
    kept: list[tuple[Tensor, Tensor]] = []
    for _ in range(planner.searches):
        if failures >= PATIENCE:
            break
        begun = _starts(network, env, planner.held_out, rng, periods)
        earned = imagined_rewards(env, imagine(env, network, begun, periods))
        way = _better(network, env, begun, rng, periods, least := float(earned.amin()))
        # The way to the starts, that of the policy, those of all signals, and the best one once more.
        imagined += STARTS * periods * (POPULATION * DRAWS + 3)
        more = imagined_rewards(env, way, least).sum(0) - earned.sum(0)
        alive, gained = way.alive[1:], more > GAINED * more.amax()
        if not bool(alive.any()):
            break
        seen = way.observations(env.task).float()
        observations, wanted = zip(*kept, (seen[alive], way.actions[alive]), strict=True)
        _lesson(network, torch.cat(observations), torch.cat(wanted), UPDATES, rng)
        kept.append((seen[alive & gained], way.actions[alive & gained]))
        updates += UPDATES
        now = planner.test()
        failures = 0 if now > best else failures + 1
        if now > best:
            best, weights = now, copy.deepcopy(network.state_dict())
    network.load_state_dict(weights)
    return Imitation(best, imagined, updates)


@torch.no_grad()
def _starts(network: Network, env: ControlEnv, rows: Rows, rng: torch.Generator, periods: int) -> Rows:
    """Return where ways begin: half of them where episodes do, the others at a moment of an episode of the policy."""
    # A way is timed for inputs that act at once, as those of the model do.
    begun = replace(Rows.draw(env, STARTS, rng), reach=rows.reach, strength=rows.strength)
    flown = imagine(env, network, begun, periods)
    moment = torch.randint(periods + 1, (STARTS,), generator=rng)
    moment[::2] = 0
    each = torch.arange(STARTS)
    return replace(begun, x=flown.states[moment, each], t=flown.times.expand(-1, STARTS, 1)[moment, each])


@torch.no_grad()
def _better(
    network: Network, env: ControlEnv, begun: Rows, rng: torch.Generator, periods: int, least: float = math.inf
) -> Window:
    """Return the best way found from each start, the policy's among them; for `least` see `imagined_rewards`."""
    n, n_u = begun.held.shape
    acting = max(1, round(ACTING * periods))
    many = replace(
        begun,
        **{name: getattr(begun, name).repeat_interleave(POPULATION, 0) for name in ("x", "held", "params", "t")},
    )

    def _earned(drawn: Tensor) -> Tensor:
        flown = imagine(env, _on_top(network, drawn, acting, env.task.limit), many, periods)
        return imagined_rewards(env, flown, least).sum(0)

    nothing = torch.zeros(n, max(2, acting // KNOT), n_u)  # the policy itself is among the ways
    best = cross_entropy(_earned, nothing, POPULATION, range(DRAWS), MOST, rng)
    return imagine(env, _on_top(network, best, acting, env.task.limit), begun, periods)


def _on_top(network: Network, knots: Tensor, acting: int, limit: Callable[[Tensor], Tensor]) -> Network:
    """Return a policy with a signal on top for `acting` periods, knots `(rows, n_knots, n_u)`, for a single flight."""
    added = iter(signal(knots, acting, lambda u: u))

    def _act(observation: Tensor) -> Tensor:
        u, more = network(observation), next(added, None)
        return u if more is None else limit(u + more)

    return _act


def imagined_rewards(env: ControlEnv, window: Window, least: float = math.inf) -> Tensor:
    """Return what each period of a window earns, `(T, rows)`; those after divergence earn as little as the worst.

    Where all diverge at once that is minus infinity.

    Args:
        env: Imagined environment.
        window: What was imagined.
        least: What has earned least in a window that this one is compared with; none if omitted.
    """
    reward, alive = window.rewards(env.task), window.alive[1:]
    worst = min(least, float(reward[alive].amin())) if bool(alive.any()) else least
    return reward.where(alive, worst if math.isfinite(worst) else -math.inf)
