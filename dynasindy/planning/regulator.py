"""A linear-quadratic regulator of the model, as the policy to begin with on a plant that has to be held.

| name     | symbol   | equation                                                                        |
| -------- | -------- | ------------------------------------------------------------------------------- |
| rest     | x_e, u_e | f(x_e, u_e) = 0 with the tracked states at r; cubic polynomials of r fitted to rests |
| gain     | K        | least sum of (x - x_e)' Q (x - x_e) + (u - u_e)' R (u - u_e), discrete Riccati equation |
| law      | u        | u_e(r) - K (x - x_e(r)), clipped to [-1, 1]                                     |
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor, nn

from dynasindy.agents.classical.linearise import zero_order_hold
from dynasindy.envs import ControlEnv
from dynasindy.planning.rests import Rests
from dynasindy.planning.window import Network, Rows, imagine
from dynasindy.tasks import Tracking

DEGREE = 3
"""Degree of the polynomials through the rests."""
LADDER = (0.3, 3.0, 30.0, 300.0)
"""Weights of the tracked states that are tried."""
ROUNDS, STEPS, BATCH = 3, 600, 512
"""Rounds of imitation, and the updates and the batch of each."""
ROWS, PERIODS = 96, 150
"""Imagined episodes and their length in a round of imitation."""
AROUND = 0.3
"""Distance from a rest at which every second imagined episode begins [ranges of the states]."""


@dataclass(frozen=True)
class Weights:
    """Weights of the quadratic cost.

    Attributes:
        outputs: Of each squared tracking error, in boxes of targets.
        states: Of each squared state, in its range.
        inputs: Of each squared input.
    """

    outputs: float = 100.0
    states: float = 0.1
    inputs: float = 1.0


class Regulator:
    """The law, read from observations.

    Attributes:
        slowest: Time constant of the slowest mode of the regulated linear model [control periods].

    Args:
        task: What the observations are of.
        gain: K, `(n_u, n_x)`.
        rests: Coefficients of x_e and u_e as polynomials of the targets, `(n_terms, n_x + n_u)`.
        box: Middle and half range of the targets, `(2, n_r)`.
        slowest: Time constant [control periods].
    """

    def __init__(self, task: Tracking, gain: Tensor, rests: Tensor, box: Tensor, slowest: float) -> None:
        self.task, self.gain, self.rests, self.box = task, gain.float(), rests.float(), box.float()
        self.slowest = slowest

    @classmethod
    def of(cls, env: ControlEnv, rests: Rests, weights: Weights) -> Regulator | None:
        """Return the regulator of the model at the middle of its rests; None without one, or where none holds it."""
        if not len(rests):
            return None
        task, k, moved = env.task, rests.middle(), rests.moved
        assert isinstance(task, Tracking)
        scale = torch.tensor(task.signature.x_scale, dtype=torch.float64)
        low, high = rests.targets.amin(0), rests.targets.amax(0)
        half = 0.5 * (high - low)
        q = weights.states / scale.square()
        q[task.outputs] = weights.outputs / task.boxes().double().square()
        a, b = zero_order_hold(rests.a[k][moved][:, moved], rests.b[k][moved], env.dt)
        found = riccati(a, b, q[moved], weights.inputs)
        if found is None:
            return None
        gain = torch.zeros(b.shape[1], len(scale), dtype=torch.float64)
        gain[:, moved] = found[0]
        box = torch.stack([0.5 * (low + high), torch.where(half > 1e-9 * scale[task.outputs], half, 1.0)])
        terms = _terms((rests.targets - box[0]) / box[1])
        through = torch.linalg.lstsq(terms, torch.cat([rests.x, rests.u], -1), driver="gelsd").solution
        return cls(task, gain, through, box, found[1])

    def __call__(self, observation: Tensor) -> Tensor:
        """Return inputs `(*batch, n_u)` for observations `(*batch, n_o)`."""
        x, reference = self.task.seen(observation)
        r = ((reference - self.box[0]) / self.box[1]).clamp(-1.2, 1.2)
        x_e, u_e = (_terms(r) @ self.rests).split([x.shape[-1], self.gain.shape[0]], -1)
        return (u_e - (x - x_e) @ self.gain.mT).clamp(-1.0, 1.0)

    def near(self, reference: Tensor, rng: torch.Generator) -> Tensor:
        """Return states around the rests of references `(n, n_r)`, `(n, n_x)`."""
        r = ((reference - self.box[0]) / self.box[1]).clamp(-1.2, 1.2)
        scale = torch.tensor(self.task.signature.x_scale)
        x_e = (_terms(r) @ self.rests)[..., : len(scale)]
        return x_e + AROUND * scale * torch.randn(x_e.shape, generator=rng)


def hold(
    network: nn.Module, env: ControlEnv, rests: Rests, score: Callable[[Network], float], rng: torch.Generator
) -> float:
    """Let a policy begin as the best of some regulators, if that earns more than the policy as it is.

    Args:
        network: Policy, observations to inputs; trained in place.
        env: Imagined environment.
        rests: Rests of its model.
        score: What a policy earns in the model.
        rng: Source of starts, references and batches.

    Returns:
        What the policy earns in the end.
    """
    best, before = score(network), copy.deepcopy(network.state_dict())
    tried = [Regulator.of(env, rests, replace(Weights(), outputs=weight)) for weight in LADDER]
    earned = {score(law): law for law in tried if law is not None}
    if earned and max(earned) > best:
        imitate(network, earned[max(earned)], env, rng)
        if (imitated := score(network)) > best:
            return imitated
        network.load_state_dict(before)
    return best


def imitate(network: nn.Module, law: Regulator, env: ControlEnv, rng: torch.Generator) -> None:
    """Train a policy to act as a law does, where the law leads and then where the policy itself leads.

    Args:
        network: Policy, observations to inputs; trained in place.
        law: What to imitate.
        env: Imagined environment.
        rng: Source of starts, references and batches.
    """
    seen: list[Tensor] = []
    for k in range(ROUNDS):
        pilot: Network = network if k else _trembling(law, rng)
        seen.append(_visited(pilot, law, env, rng))
        observations = torch.cat(seen)
        wanted = law(observations)
        optimizer = torch.optim.Adam(network.parameters(), lr=3e-3, betas=(0.9, 0.99), fused=True)
        for step in range(STEPS):
            optimizer.param_groups[0]["lr"] = 3e-3 * (1 - step / STEPS) ** 2 + 1e-5
            pick = torch.randint(len(observations), (BATCH,), generator=rng)
            loss = (network(observations[pick]) - wanted[pick]).square().mean()
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            optimizer.step()


@torch.no_grad()
def _visited(pilot: Network, law: Regulator, env: ControlEnv, rng: torch.Generator) -> Tensor:
    """Return observations along imagined episodes, half of them begun around rests, `(n, n_o)`."""
    task, batch = env.task, torch.Size((ROWS,))
    assert isinstance(task, Tracking)
    params, zero = task.sample(batch, rng), torch.zeros(ROWS, 1)
    other = task.reference(task.sample(batch, rng), zero)
    x = task.initial_state(batch, rng).float()
    x[::2] = law.near(other, rng)[::2]
    rows = Rows(x, torch.zeros(ROWS, law.gain.shape[0]), params, zero)
    reach = torch.tensor(task.signature.x_scale) * 20.0
    rows.reach = torch.maximum(reach, 4 * x.abs().amax(0))
    whole = imagine(env, env.system, pilot, rows, min(PERIODS, task.max_steps), False, rng)
    alive = whole.alive[:-1]
    observed = task.observation(whole.seen, params.expand(len(alive), *params.shape), whole.times[:-1])
    return observed[alive].float()


def _trembling(law: Regulator, rng: torch.Generator) -> Network:
    """Return the law with noise on its inputs, which shows more of the plant."""

    def _act(observation: Tensor) -> Tensor:
        u = law(observation)
        return (u + 0.1 * torch.randn(u.shape, generator=rng)).clamp(-1.0, 1.0)

    return _act


def riccati(a: Tensor, b: Tensor, q: Tensor, r: float) -> tuple[Tensor, float] | None:
    """Return gain and slowest time constant [periods] of the least quadratic cost, or None where there is none.

    Args:
        a: Of x[k+1] = a x[k] + b u[k], `(n_x, n_x)`.
        b: `(n_x, n_u)`.
        q: Weight of each squared state, `(n_x,)`.
        r: Weight of each squared input.
    """
    f, g, cost = a.numpy(), b.numpy(), r * np.eye(b.shape[1])
    try:
        p = solve_discrete_are(f, g, np.diag(q.numpy()), cost)
    except (np.linalg.LinAlgError, ValueError):
        return None
    gain = np.linalg.solve(cost + g.T @ p @ g, g.T @ p @ f)
    radius = float(np.abs(np.linalg.eigvals(f - g @ gain)).max())
    if not radius < 1 - 1e-6:
        return None
    return torch.as_tensor(gain), -1.0 / float(np.log(max(radius, 1e-3)))


def _terms(r: Tensor) -> Tensor:
    """Return all monomials of targets `(*batch, n_r)` up to the degree, `(*batch, n_terms)`."""
    products: Sequence[Tensor] = [
        r[..., list(places)].prod(-1)
        for degree in range(DEGREE + 1)
        for places in combinations_with_replacement(range(r.shape[-1]), degree)
    ]
    return torch.stack(list(products), -1)
