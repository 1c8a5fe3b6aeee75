"""What the gradient cannot find: signals on top of the policy that earn more in the model, which it then imitates.

Where two ways lead to the same end, one swing more or less, a policy changes from one to the other at a border in the
space of states. No gradient moves that border, as it follows each way alone. So signals are searched that lead over it,
by cross-entropy as in `dynasindy.planning.search`; once a signal is over, the policy acts alone.

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

import torch
from torch import Tensor, nn

from dynasindy.envs import ControlEnv
from dynasindy.planning.imitation import lesson
from dynasindy.planning.search import cross_entropy
from dynasindy.planning.window import Network, Rows, Window, imagine

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


@dataclass(frozen=True)
class Improved:
    """What came of it.

    Attributes:
        score: What the policy earns in the model.
        imagined: Control periods that were imagined.
        updates: Gradient updates of the imitation.
    """

    score: float
    imagined: int
    updates: int


def improve(
    network: nn.Module,
    env: ControlEnv,
    rows: Rows,
    score: Callable[[], float],
    rng: torch.Generator,
    periods: int,
    rounds: int,
) -> Improved:
    """Improve a policy by ways that earn more than its own; it is left as the best that it was.

    Args:
        network: Policy, observations to inputs; trained in place.
        env: Imagined environment.
        rows: Tells how far its states may go; not changed.
        score: What the policy earns in the model.
        rng: Source of starts, signals and batches.
        periods: Length of a way [control periods].
        rounds: Most rounds of search and imitation.
    """
    best, weights, imagined, updates, failures = score(), copy.deepcopy(network.state_dict()), 0, 0, 0
    kept: list[tuple[Tensor, Tensor]] = []
    for _ in range(rounds):
        if failures >= PATIENCE:
            break
        begun, floor = starts(network, env, rows, rng, periods), Floor()
        flown = imagine(env, env.system, network, begun, periods)
        rewards(env, begun, flown, floor)
        way = better(network, env, begun, rng, periods, floor)
        # The way to the starts, that of the policy, those of all signals, and the best one once more.
        imagined += STARTS * periods * (POPULATION * DRAWS + 3)
        more = rewards(env, begun, way, floor).sum(0) - rewards(env, begun, flown, floor).sum(0)
        alive, gained = way.alive[1:], more > GAINED * more.amax()
        if not bool(alive.any()):
            break
        seen = env.task.observation(
            way.states[:-1], begun.params.expand(periods, *begun.params.shape), way.times[:-1]
        ).float()
        observations, wanted = zip(*kept, (seen[alive], way.actions[alive]), strict=True)
        lesson(network, torch.cat(observations), torch.cat(wanted), UPDATES, rng)
        kept.append((seen[alive & gained], way.actions[alive & gained]))
        updates += UPDATES
        now = score()
        failures = 0 if now > best else failures + 1
        if now > best:
            best, weights = now, copy.deepcopy(network.state_dict())
    network.load_state_dict(weights)
    return Improved(best, imagined, updates)


class Floor:
    """The least that any period has earned in what was imagined so far; what has diverged earns no more than that."""

    def __init__(self) -> None:
        self.least = math.inf

    def under(self, reward: Tensor, alive: Tensor) -> Tensor:
        """Return rewards `(T, rows)` with those that are not alive replaced; minus infinity if none ever was."""
        if bool(alive.any()):
            self.least = min(self.least, float(reward[alive].amin()))
        return reward.where(alive, self.least if math.isfinite(self.least) else -math.inf)


@torch.no_grad()
def starts(network: Network, env: ControlEnv, rows: Rows, rng: torch.Generator, periods: int) -> Rows:
    """Return where ways begin: half of them where episodes do, the others at a moment of an episode of the policy."""
    task, batch = env.task, torch.Size((STARTS,))
    nothing, zero = torch.zeros(STARTS, env.system.signature.n_u), torch.zeros(STARTS, 1)
    x, params = task.initial_state(batch, rng).float(), task.sample(batch, rng)
    # A way is timed for inputs that act at once, as those of the model do.
    begun = replace(rows, x=x, held=nothing, params=params, t=zero, kept=False, late=None)
    flown = imagine(env, env.system, network, begun, periods)
    moment = torch.randint(periods + 1, (STARTS,), generator=rng)
    moment[::2] = 0
    each = torch.arange(STARTS)
    return replace(begun, x=flown.states[moment, each], t=flown.times.expand(-1, STARTS, 1)[moment, each])


@torch.no_grad()
def better(
    network: Network, env: ControlEnv, begun: Rows, rng: torch.Generator, periods: int, floor: Floor | None = None
) -> Window:
    """Return the best way from each start that was found; it earns no less than that of the policy.

    Args:
        network: Policy.
        env: Imagined environment.
        begun: The starts.
        rng: Source of the signals.
        periods: Length of a way [control periods].
        floor: What has earned least so far, so that a crash is worth the same in every draw.
    """
    n, n_u = begun.held.shape
    floor = floor or Floor()
    acting = max(1, round(ACTING * periods))
    many = replace(
        begun,
        **{name: getattr(begun, name).repeat_interleave(POPULATION, 0) for name in ("x", "held", "params", "t")},
    )

    def _earned(drawn: Tensor) -> Tensor:
        flown = imagine(env, env.system, OnTop(network, drawn, acting, env.task.limit), many, periods)
        return rewards(env, many, flown, floor).sum(0)

    nothing = torch.zeros(n, max(2, acting // KNOT), n_u)  # the policy itself is among the ways
    best = cross_entropy(_earned, nothing, POPULATION, range(DRAWS), MOST, rng)
    return imagine(env, env.system, OnTop(network, best, acting, env.task.limit), begun, periods)


class OnTop:
    """A policy with a signal on top of it, one for each row, for a single flight.

    Args:
        network: Policy.
        knots: Knots of the signals, `(rows, n_knots, n_u)`.
        acting: Control periods on which the signals act.
        limit: Keeps inputs within their limits.
    """

    def __init__(self, network: Network, knots: Tensor, acting: int, limit: Callable[[Tensor], Tensor]) -> None:
        lines = torch.nn.functional.interpolate(knots.mT, size=acting, mode="linear", align_corners=True)
        self.network, self.signal, self.limit, self.k = network, lines.permute(2, 0, 1), limit, 0

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the inputs `(rows, n_u)` of the next control period."""
        u, k = self.network(observation), self.k
        self.k += 1
        return self.limit(u + self.signal[k]) if k < len(self.signal) else u


def rewards(env: ControlEnv, rows: Rows, window: Window, floor: Floor | None = None) -> Tensor:
    """Return what each period of a window earns, `(T, rows)`; those after divergence earn as little as the worst.

    Args:
        env: Imagined environment.
        rows: Where the window began.
        window: What was imagined.
        floor: What has earned least in windows that this one is compared with; none if omitted.
    """
    free = torch.zeros(window.actions.shape[:-1], dtype=torch.bool)
    params = rows.params.expand(len(free), *rows.params.shape)
    x, x_next, alive = window.states[:-1], window.states[1:], window.alive[1:]
    reward = env.task.earned(x, window.actions, x_next, params, window.times[1:], free)
    return (floor or Floor()).under(reward, alive)
