"""Offset-free control: a constant push that the observer has estimated is counteracted, and leaves no steady error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.envs import Sampled
from dynasindy.systems import System

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Reads `observation`, writes `action`."""
NUDGE = 1e-4
"""Step of the central differences [ranges of the states, and of the inputs]."""
STEPS, DAMPING = 2, 1e-4
"""Gauss-Newton steps per control period, and how much they are damped."""


def correction(system: System, x: Tensor, u: Tensor, push: Tensor, outputs: Sequence[int], guess: Tensor) -> Tensor:
    """Return the part of state and input that counteracts a push and leaves the outputs where they are.

    Without it, the plant without the push would move as the plant with the push does:
    f(x - dx, u - du) = f(x, u) + push, C dx = 0. Linearised this is 0 = A dx + B du + push. It is solved by damped
    Gauss-Newton steps from the solution of the control period before, as thrusts that go with the square of a speed
    have no slope at rest.

    Args:
        system: Model of the plant.
        x: States, `(*batch, n_x)`.
        u: Inputs, `(*batch, n_u)`.
        push: Push on each state, `(*batch, n_x)` [its unit per second].
        outputs: Indices of the tracked states.
        guess: Solution before, dx and du, `(*batch, n_x + n_u)`.

    Returns:
        dx and du, `(*batch, n_x + n_u)`.
    """
    n_x, n_u = x.shape[-1], u.shape[-1]
    scale = torch.tensor([*system.signature.x_scale, *[1.0] * n_u], dtype=x.dtype)
    nudges = NUDGE * torch.cat([torch.zeros(1, n_x + n_u, dtype=x.dtype), torch.eye(n_x + n_u), -torch.eye(n_x + n_u)])
    held = torch.zeros(len(outputs), n_x + n_u, dtype=x.dtype)
    held[range(len(outputs)), list(outputs)] = 1.0
    held = held.expand(*x.shape[:-1], *held.shape)
    wanted, point, shift = system(x, u) + push, torch.cat([x, u], -1), guess
    for _ in range(STEPS):
        around = (point - shift).unsqueeze(-2) + nudges * scale
        rates = (system(around[..., :n_x], around[..., n_x:]) - wanted.unsqueeze(-2)) / scale[:n_x]
        excess, forth, back = rates.split([1, n_x + n_u, n_x + n_u], -2)
        slopes = torch.cat([(forth - back).mT / (2 * NUDGE), held], -2)
        missing = torch.cat([excess.squeeze(-2), -(shift / scale)[..., list(outputs)]], -1).unsqueeze(-1)
        normal = slopes.mT @ slopes + DAMPING * torch.eye(n_x + n_u, dtype=x.dtype)
        # Far off, where a model explodes, the matrix may be singular in spite of the damping: no number is no shift.
        step, failed = torch.linalg.solve_ex(normal, slopes.mT @ missing)
        shift = shift + step.squeeze(-1).masked_fill(failed.bool().unsqueeze(-1), torch.nan) * scale
    return torch.where(shift.isfinite().all(-1, keepdim=True), shift, torch.zeros_like(shift))


def acting(policy: Policy, env: Sampled, pushed: bool = False) -> Policy:
    """Return a policy as it acts on a plant: within the limits of inputs, and against the push that is estimated.

    Args:
        policy: Reads `observation`, writes `action`.
        env: Where it acts; the task has the limits.
        pushed: Whether an observer estimates a push, under `observer`, which is counteracted.
    """
    return partial(_act, policy, env, pushed) if pushed or env.task.limited else policy


def _act(policy: Policy, env: Sampled, pushed: bool, tensordict: TensorDictBase) -> TensorDictBase:
    """Write the action, or that for the state without the push and what counteracts it, within the limits."""
    if not pushed:
        return tensordict.set("action", env.task.limit(policy(tensordict)["action"]))
    x, t = tensordict["state"], tensordict["step_count"] * env.dt
    dx, du = tensordict["observer", "shift"].split([x.shape[-1], env.task.signature.n_u], -1)
    seen = tensordict.copy().set("state", x - dx)
    observation = env.task.observation(x - dx, tensordict["task_params"], t.to(x))
    action = policy(seen.set("observation", observation.to(tensordict["observation"])))["action"]
    return tensordict.set("action", env.task.limit(action + du.to(action)))
