"""One imagined window: a closed-loop rollout of a differentiable model and the policy's gradient through it.

| name      | symbol                         | shape                    |
| --------- | ------------------------------ | ------------------------ |
| `states`  | z_k, k = 0..T                  | `(T + 1, rows, n_z)`     |
| `actions` | u_k = pi(o(z_k))               | `(T, rows, n_u)`         |
| `a`, `b`  | A_k = dz_k+1/dz_k, B_k = dz_k+1/du_k | `(T, rows, n_z, n_z or n_u)` |
| `k`       | K_k = du_k/dz_k                | `(T, rows, n_u, n_z)`    |
| `adjoint` | lambda_k = dJ/dz_k             | `(rows, n_z)`            |

The rollout is sequential and runs without a graph. The derivatives of the model are then taken at once, on
`T * rows` rows, and what is left of back-propagation through time is the adjoint equation of the closed loop

    lambda_k = dJ/dz_k + (A_k + B_k K_k)' lambda_k+1,    dJ/du_k = B_k' lambda_k+1,

and one backward pass of the policy. An effort e(u_k) adds K_k' de/du_k to the first and de/du_k to the second. The
machine code of `planning.machine` keeps the layers of a perceptron, and K_k' dJ/du_k comes out of that pass, period by
period, without K. The gradient equals that of automatic differentiation through the rollout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv
from dynasindy.planning.machine import MachineRollout
from dynasindy.planning.randomization import InputStrength
from dynasindy.systems import System, integrate

Network = Callable[[Tensor], Tensor]
"""Observations `(*batch, n_o)` to actions `(*batch, n_u)`."""

CHUNK = 20
"""Control periods whose activations are handled at once; more would not stay in a core's cache."""


@dataclass
class Rows:
    """Where the parallel imagined episodes stand.

    Attributes:
        x: States, `(rows, n_x)`.
        held: Inputs of the period before, `(rows, n_u)`, which go on acting where inputs are late.
        params: Task parameters, `(rows, *params_shape)`.
        t: Time since the start of each episode [s], `(rows, 1)`.
        reach: Magnitude of each state beyond which the model has diverged, `(n_x,)`; None for any finite one.
        kept: Whether `backward` follows, for which the machine code keeps the policy's layers.
        strength: How strong the inputs of each episode are; None for that of the model.
        late: Share of a control period by which the inputs of each episode are late, `(rows, 1)`, in [0, 1]: so much of
            what acts is the input of the period before. None for no delay.
    """

    x: Tensor
    held: Tensor
    params: Tensor
    t: Tensor
    reach: Tensor | None = None
    kept: bool = False
    strength: InputStrength | None = None
    late: Tensor | None = None


@dataclass(frozen=True)
class Window:
    """An imagined window; from where a row has diverged it holds the row's first state and inputs of zero.

    Attributes:
        states: `(T + 1, rows, n_x)`.
        applied: Inputs that reached the plant, `(T, rows, n_u)`.
        actions: Actions of the policy, `(T, rows, n_u)`; those applied unless the actuator is late, or of another
            strength.
        times: `(T + 1, rows, 1)` [s].
        alive: Where the row has not diverged so far, bool `(T + 1, rows)`.
        machine: The machine code that made the window and can go back through it, if any.
    """

    states: Tensor
    applied: Tensor
    actions: Tensor
    times: Tensor
    alive: Tensor
    machine: MachineRollout | None = None


@torch.no_grad()
def imagine(
    env: ControlEnv,
    system: System,
    network: Network,
    rows: Rows,
    steps: int,
) -> Window:
    """Roll the policy out in the model.

    Args:
        env: Imagined environment: its task, period, sub-steps and stops.
        system: Vector field; the environment's own, or a variation of it with a row per rollout.
        network: Policy.
        rows: Where the rollouts begin; not changed.
        steps: Control periods T of the window.
    """
    times = rows.t + env.dt * torch.arange(steps + 1, dtype=rows.x.dtype).reshape(-1, 1, 1)
    strength = None
    if (acting := rows.strength) is not None:
        fixed = acting.along is None
        strength = acting, torch.stack([acting.at(rows.params, t).rest for t in (times[:1] if fixed else times[:-1])])
    machine = MachineRollout.of(env, system, network, rows.x, steps, rows.late, strength)
    if machine is not None:
        still = rows.x.new_zeros(steps, *rows.x.shape)
        free = env.task.observation(still, rows.params.expand(steps, *rows.params.shape), times[:-1])
        whole, entered, actions = machine.imagine(rows.x, rows.held, free, rows.kept)
    else:
        whole, entered, actions = _imagine(env, system, network, rows, times)
    alive = _alive(whole, rows.reach)
    kept = alive.unsqueeze(-1)
    x, nothing = rows.x, torch.zeros_like(rows.held)
    return Window(
        states=torch.where(kept, whole, x),
        applied=torch.where(kept[1:], entered, nothing),
        actions=torch.where(kept[1:], actions, nothing),
        times=times,
        alive=alive,
        machine=machine if rows.kept and bool(alive.all()) else None,
    )


def _imagine(
    env: ControlEnv, system: System, network: Network, rows: Rows, times: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return states, inputs that acted and actions of a window, period by period."""
    x, held, states, applied, actions = rows.x, rows.held, [rows.x], [], []
    for t in times[:-1]:
        u = network(env.task.observation(x, rows.params, t))
        entering, held = u if rows.late is None else torch.lerp(u, held, rows.late), u
        if rows.strength is not None:
            entering = rows.strength.at(rows.params, t).acting(entering)
        samples, _ = integrate(system, x, entering, env.dt, env.substeps, env.stops)
        x = samples[..., -1, :]
        states.append(x)
        applied.append(entering)
        actions.append(u)
    return torch.stack(states), torch.stack(applied), torch.stack(actions)


def backward(
    env: ControlEnv,
    system: System,
    network: Network,
    rows: Rows,
    window: Window,
) -> Tensor:
    """Add the gradient of the window's mean cost, the negative reward, to the policy's parameters.

    A row that diverges does not count: its slopes point wherever the model explodes, and would drown the others'. Up to
    where it diverges is no better: a policy that leaves early would pay less.

    Args:
        env: Imagined environment.
        system: Vector field of the window.
        network: Policy.
        rows: Where the window began.
        window: What `imagine` returned.

    Returns:
        The mean reward of the window's periods, a scalar; a row that diverged earns zero.
    """
    with torch.enable_grad():
        a, b = sensitivities(env, system, window.states[:-1], window.applied)
        if rows.strength is not None:
            b = b * rows.strength.slope(window.applied).unsqueeze(-2)
        # A period that ends in divergence has derivatives without bounds; times zero they would not be zero.
        if not bool(window.alive.all()):
            a, b = (slope.where(window.alive[1:, :, None, None], torch.zeros(())) for slope in (a, b))
        reward, cost, effort = _cost(env, rows, window)
        if window.machine is not None:
            window.machine.adjoint(a, b, cost, effort)
            return reward
        actions, k = _policy(env, network, rows, window)
        whole = _adjoint(a, b, cost, effort, rows.late, k)
        for acted, slopes in zip(actions, whole.split(CHUNK), strict=True):
            torch.autograd.backward(acted, slopes)
    return reward


def sensitivities(env: ControlEnv, system: System, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Return dx_next/dx, `(*batch, n_x, n_x)`, and dx_next/du, `(*batch, n_x, n_u)`, of a control period.

    The mechanical stops are left out: a beam that lies at a stop would have no gradient that leads away.
    """
    if (code := system.compiled(x, u)) is not None:
        return code.sensitivities(x, u, env.dt, env.substeps)
    x, u = x.detach().requires_grad_(), u.detach().requires_grad_()
    samples, _ = integrate(system, x, u, env.dt, env.substeps)
    columns = samples[..., -1, :].unbind(-1)
    rows = [torch.autograd.grad(column.sum(), (x, u), retain_graph=True) for column in columns]
    return torch.stack([row[0] for row in rows], -2), torch.stack([row[1] for row in rows], -2)


def _alive(states: Tensor, reach: Tensor | None) -> Tensor:
    """Return where states `(T + 1, rows, n_x)` are finite and within reach, and were so all along."""
    believed = states.isfinite()
    if reach is not None:
        believed &= states.abs() <= reach
    return believed.all(-1).int().cummin(0).values.bool()


def _policy(env: ControlEnv, network: Network, rows: Rows, window: Window) -> tuple[list[Tensor], Tensor]:
    """Return the actions with their graphs, in chunks of periods, and K, `(T, rows, n_u, n_x)`."""
    actions, gains = [], []
    for x, t in zip(window.states[:-1].split(CHUNK), window.times[:-1].split(CHUNK)):
        seen = x.detach().requires_grad_()
        acted = network(env.task.observation(seen, rows.params.expand(len(x), *rows.params.shape), t))
        columns = [torch.autograd.grad(column.sum(), seen, retain_graph=True)[0] for column in acted.unbind(-1)]
        actions.append(acted)
        gains.append(torch.stack(columns, -2))
    return actions, torch.cat(gains)


def _cost(env: ControlEnv, rows: Rows, window: Window) -> tuple[Tensor, Tensor, Tensor | None]:
    """Return mean reward, rows that diverged at zero, and its negative's derivatives.

    They are those by states, `(T + 1, rows, n_x)`, and by actions, `(T, rows, n_u)`, None where these cost nothing.
    """
    states, u = (values.detach().requires_grad_() for values in (window.states, window.actions))
    free = torch.zeros(states[1:].shape[:-1], dtype=torch.bool)
    params = rows.params.expand(len(free), *rows.params.shape)
    rewards = env.task.earned(states[:-1], u, states[1:], params, window.times[1:], free)
    reward = (rewards * window.alive[-1]).mean()
    slope = effort = None
    if reward.requires_grad:
        slope, effort = torch.autograd.grad(-reward, (states, u), allow_unused=True)
    if slope is None:
        raise TypeError(
            f"the reward of task {type(env.task).__name__} has no derivative by the states, and planning by gradient "
            "needs one; use planning=dyna, which any task allows"
        )
    return reward.detach(), slope, effort


def _adjoint(a: Tensor, b: Tensor, cost: Tensor, effort: Tensor | None, late: Tensor | None, k: Tensor) -> Tensor:
    """Solve the adjoint equation backwards and return dJ/du, `(T, rows, n_u)`.

    Args:
        a: Derivatives of the next state by the state, `(T, rows, n_x, n_x)`.
        b: Those by the input that acts, `(T, rows, n_x, n_u)`.
        cost: Derivatives of the cost by the states, `(T + 1, rows, n_x)`.
        effort: Those by the actions, `(T, rows, n_u)`; None where these cost nothing.
        late: Share of each action that acts a period later, `(rows, 1)`; None for no delay.
        k: Derivatives of the actions by the state, `(T, rows, n_u, n_x)`.
    """
    adjoint, slopes, later = cost[-1].unsqueeze(-2), [], torch.zeros(())
    for step in range(len(a) - 1, -1, -1):
        slope = (adjoint @ b[step]).squeeze(-2)
        if late is not None:  # an action acts in part in its own period, and for the rest in the next one
            slope, later = slope * (1 - late) + later, slope * late
        slopes.append(slope if effort is None else slope + effort[step])
        adjoint = torch.baddbmm(cost[step].unsqueeze(-2), adjoint, a[step])
        adjoint = torch.baddbmm(adjoint, slopes[-1].unsqueeze(-2), k[step])
    return torch.stack(slopes[::-1])
