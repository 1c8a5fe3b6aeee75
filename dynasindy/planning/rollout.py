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
gradient equals that of automatic differentiation through the rollout.

Period by period, a good half of a window is what torch does around its products. `c/rollout.c` does the same arithmetic
in one call, for a perceptron on the CPU whose observations are linear in the states, and a model that has machine code.
It keeps the layers of the perceptron, and K_k' dJ/du_k comes out of the backward pass, without K.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import torch
from torch import Tensor

from dynasindy.agents.networks import LINE, MLP, Layer, line_of, network_pointers
from dynasindy.envs import ControlEnv, Task, Tracking
from dynasindy.planning.regulator import Regulator
from dynasindy.systems import integrate
from dynasindy.systems.compiler import addresses, c_text, find_library
from dynasindy.systems.equilibria import Equilibria
from dynasindy.systems.machine import Machine

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

    @classmethod
    def start(cls, x: Tensor, params: Tensor, n_u: int) -> Rows:
        """Return episodes that begin now, after inputs of zero, at states `(rows, n_x)` with task parameters."""
        return cls(x.float(), torch.zeros(len(x), n_u), params, torch.zeros(len(x), 1))

    @classmethod
    def draw(cls, env: ControlEnv, number: int, rng: torch.Generator) -> Rows:
        """Return so many episodes that begin as the task lets them, with drawn references."""
        batch = torch.Size((number,))
        return cls.start(env.task.initial_state(batch, rng), env.task.sample(batch, rng), env.system.signature.n_u)


@dataclass(frozen=True)
class Window:
    """An imagined window; from where a row has diverged it holds the row's first state and inputs of zero.

    Attributes:
        states: `(T + 1, rows, n_x)`.
        applied: Inputs that reached the plant, `(T, rows, n_u)`.
        actions: Actions of the policy, `(T, rows, n_u)`; those applied unless the actuator is late, or of another
            strength.
        params: Task parameters, `(T, rows, *params_shape)`.
        times: `(T + 1, rows, 1)` [s].
        alive: Where the row has not diverged so far, bool `(T + 1, rows)`.
        machine: The machine code that made the window and can go back through it, if any.
    """

    states: Tensor
    applied: Tensor
    actions: Tensor
    params: Tensor
    times: Tensor
    alive: Tensor
    machine: _MachineRollout | None = None

    def observations(self, task: Task) -> Tensor:
        """Return what the policy saw, `(T, rows, n_o)`."""
        return task.observation(self.states[:-1], self.params, self.times[:-1])

    def rewards(self, task: Task) -> Tensor:
        """Return what each control period earns, `(T, rows)`."""
        free = torch.zeros(self.actions.shape[:-1], dtype=torch.bool)
        return task.earned(self.states[:-1], self.actions, self.states[1:], self.params, self.times[1:], free)


@torch.no_grad()
def imagine(env: ControlEnv, network: Network, rows: Rows, steps: int) -> Window:
    """Roll the policy out in the model.

    Args:
        env: Imagined environment.
        network: Policy.
        rows: Where the rollouts begin; not changed.
        steps: Control periods T of the window.
    """
    times = rows.t + env.dt * torch.arange(steps + 1, dtype=rows.x.dtype).reshape(-1, 1, 1)
    rest = None if rows.strength is None else rows.strength.rest(rows.params, times[:-1])
    params = rows.params.expand(steps, *rows.params.shape)
    machine = _machine(env, network, rows, steps, rest)
    if machine is not None:
        free = env.task.observation(rows.x.new_zeros(steps, *rows.x.shape), params, times[:-1])
        whole, entered, actions = machine.imagine(rows.x, rows.held, free, rows.kept)
    else:
        whole, entered, actions = _imagine(env, network, rows, times[:-1], rest)
    believed = whole.isfinite() & (whole.abs() <= (torch.inf if rows.reach is None else rows.reach))
    alive = believed.all(-1).int().cummin(0).values.bool()
    kept = alive.unsqueeze(-1)
    x, nothing = rows.x, torch.zeros_like(rows.held)
    return Window(
        states=torch.where(kept, whole, x),
        applied=torch.where(kept[1:], entered, nothing),
        actions=torch.where(kept[1:], actions, nothing),
        params=params,
        times=times,
        alive=alive,
        machine=machine if rows.kept and bool(alive.all()) else None,
    )


def _imagine(
    env: ControlEnv, network: Network, rows: Rows, times: Tensor, rest: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return states, inputs that acted and actions of a window, period by period."""
    x, held, states, applied, actions = rows.x, rows.held, [rows.x], [], []
    for k, t in enumerate(times):
        u = network(env.task.observation(x, rows.params, t))
        entering, held = u if rows.late is None else torch.lerp(u, held, rows.late), u
        if rows.strength is not None and rest is not None:
            entering = rows.strength.acting(entering, rest[k % len(rest)])
        samples, _ = integrate(env.system, x, entering, env.dt, env.substeps, env.stops)
        x = samples[..., -1, :]
        states.append(x)
        applied.append(entering)
        actions.append(u)
    return torch.stack(states), torch.stack(applied), torch.stack(actions)


def backward(env: ControlEnv, network: Network, rows: Rows, window: Window) -> Tensor:
    """Add the gradient of the window's mean cost, the negative reward, to the policy's parameters.

    A row that diverges does not count: its slopes point wherever the model explodes, and would drown the others'. Up to
    where it diverges is no better: a policy that leaves early would pay less.

    Args:
        env: Imagined environment.
        network: Policy.
        rows: Where the window began.
        window: What `imagine` returned.

    Returns:
        The mean reward of the window's periods, a scalar; a row that diverged earns zero.
    """
    with torch.enable_grad():
        a, b = sensitivities(env, window.states[:-1], window.applied)
        if rows.strength is not None:
            b = b * rows.strength.slope(window.applied).unsqueeze(-2)
        # A period that ends in divergence has derivatives without bounds; times zero they would not be zero.
        if not bool(window.alive.all()):
            a, b = (slope.where(window.alive[1:, :, None, None], torch.zeros(())) for slope in (a, b))
        reward, cost, effort = _cost(env, window)
        if window.machine is not None:
            window.machine.adjoint(a, b, cost, effort)
            return reward
        # In chunks of periods.
        parts = zip(*(part.split(CHUNK) for part in (window.states[:-1], window.params, window.times[:-1])))
        actions, gains = zip(*(_policy_gain(env, network, *part) for part in parts), strict=True)
        whole = _adjoint(a, b, cost, effort, rows.late, torch.cat(gains))
        for acted, slopes in zip(actions, whole.split(CHUNK), strict=True):
            torch.autograd.backward(acted, slopes)
    return reward


def sensitivities(env: ControlEnv, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Return dx_next/dx, `(*batch, n_x, n_x)`, and dx_next/du, `(*batch, n_x, n_u)`, of a control period.

    The mechanical stops are left out: a beam that lies at a stop would have no gradient that leads away.
    """
    if (code := env.system.compiled(x, u)) is not None:
        return code.sensitivities(x, u, env.dt, env.substeps)
    x, u = x.detach().requires_grad_(), u.detach().requires_grad_()
    samples, _ = integrate(env.system, x, u, env.dt, env.substeps)
    columns = samples[..., -1, :].unbind(-1)
    rows = [torch.autograd.grad(column.sum(), (x, u), retain_graph=True) for column in columns]
    return torch.stack([row[0] for row in rows], -2), torch.stack([row[1] for row in rows], -2)


def _policy_gain(env: ControlEnv, network: Network, x: Tensor, params: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Return a policy's actions with their graph, and K = du/dx, `(*batch, n_u, n_x)`."""
    x = x.detach().requires_grad_()
    u = network(env.task.observation(x, params, t))
    slopes = [torch.autograd.grad(each.sum(), x, retain_graph=True)[0] for each in u.unbind(-1)]
    return u, torch.stack(slopes, -2)


def _cost(env: ControlEnv, window: Window) -> tuple[Tensor, Tensor, Tensor | None]:
    """Return mean reward, rows that diverged at zero, and its negative's derivatives by states and, if any, actions."""
    states, u = (values.detach().requires_grad_() for values in (window.states, window.actions))
    reward = (replace(window, states=states, actions=u).rewards(env.task) * window.alive[-1]).mean()
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
    """Solve the adjoint equation backwards and return dJ/du, `(T, rows, n_u)`; `cost`, `effort` as of `_cost`."""
    adjoint, slopes, later = cost[-1].unsqueeze(-2), [], torch.zeros(())
    for step in range(len(a) - 1, -1, -1):
        slope = (adjoint @ b[step]).squeeze(-2)
        if late is not None:  # an action acts in part in its own period, and for the rest in the next one
            slope, later = slope * (1 - late) + later, slope * late
        slopes.append(slope if effort is None else slope + effort[step])
        adjoint = torch.baddbmm(cost[step].unsqueeze(-2), adjoint, a[step])
        adjoint = torch.baddbmm(adjoint, slopes[-1].unsqueeze(-2), k[step])
    return torch.stack(slopes[::-1])


@cache
def _library() -> ctypes.CDLL | None:
    """Return the code of windows, None where there is none, which is tried once."""
    own = c_text("agents", "perceptron.c") + c_text("planning", "rollout.c")
    code = find_library(own, "windows are imagined")
    if code is not None:
        code.layers_size.restype = code.room_size.restype = ctypes.c_long
    return code


def _machine(env: ControlEnv, network: object, rows: Rows, steps: int, rest: Tensor | None) -> _MachineRollout | None:
    """Return the machine code of a window, None where it cannot be; `rest` are the inputs about which strengths act."""
    if not (isinstance(network, MLP) and network.squash and env.task.linear and rows.x.dim() == 2 and len(rows.x)):
        return None
    if any(p.dtype != torch.float32 or not p.is_cpu for p in network.parameters()):
        return None
    code = env.system.compiled(rows.x, rows.held)
    if code is None or code.dtype != torch.float32 or (library := _library()) is None:
        return None
    return _MachineRollout(library, env, code, network, rows, steps, rest)


class _MachineRollout:
    """A window of a perceptron in a model, as machine code: `library` is `c/rollout.c`, `code` that of the model."""

    def __init__(
        self,
        library: ctypes.CDLL,
        env: ControlEnv,
        code: Machine,
        policy: MLP,
        rows: Rows,
        steps: int,
        rest: Tensor | None,
    ) -> None:
        self._code, self.policy, self.periods, self.rows = library, policy, steps, len(rows.x)
        self._layers = [Layer(*(tensor.detach() for tensor in layer)) for layer in policy.layers()]
        self._policy = network_pointers(self._layers)
        n_o, n_x = policy.layers()[0].weight.shape[-1], code.n_x
        params, t = torch.zeros(n_x, *env.task.params_shape), torch.zeros(n_x, 1)
        still, moved = (env.task.observation(x, params, t) for x in (torch.zeros(n_x, n_x), torch.eye(n_x)))
        strength = (None, None) if rows.strength is None else (rows.strength.factor, rows.strength.limits)
        read = [None if each is None else _floats(each) for each in ((moved - still).T, rows.late, rest, *strength)]
        jump = 0 if rest is None or len(rest) == 1 else self.rows * code.n_u
        call = code.advance_arguments(env.dt, env.substeps, env.stops)
        self._rollout = _Rollout(steps, self.rows, jump, n_x, code.n_u, n_o, *call, *addresses(*read))
        self._held = code, call, read, self._layers  # what the code points to
        self._size = self._code.layers_size(ctypes.byref(self._policy), ctypes.c_long(self.rows))
        self._room = torch.empty(self._code.room_size(*self._arguments()) + LINE // 4)
        self._kept = torch.empty(0)

    def imagine(self, x: Tensor, held: Tensor, free: Tensor, keep: bool) -> tuple[Tensor, Tensor, Tensor]:
        """Return what `_imagine` does; `free` are observations of states of zero. Layers may be kept for `adjoint`."""
        states = x.new_empty(self.periods + 1, *x.shape)
        states[0] = x
        applied, actions = x.new_empty(2, self.periods, *held.shape)
        touched = torch.empty(self.rows, dtype=torch.bool)
        held, free = _floats(held), _floats(free)
        self._kept = torch.empty(self._size * (self.periods if keep else 1) + LINE // 4)
        window = addresses(held, free, states, applied, actions)
        room = line_of(self._room), *addresses(touched)
        self._code.imagine(*self._arguments(), *window, *self._layers_at(keep), *room)
        return states, applied, actions

    def adjoint(self, a: Tensor, b: Tensor, cost: Tensor, effort: Tensor | None) -> None:
        """Add the gradient of the cost of the last window to the policy's parameters; arguments as of `_adjoint`."""
        gradients = network_pointers([Layer(*map(_gradient, layer)) for layer in self.policy.layers()])
        given = [None if each is None else _floats(each) for each in (a, b, cost, effort)]
        slopes = ctypes.byref(gradients), *addresses(*given)
        self._code.adjoint(*self._arguments(), *slopes, *self._layers_at(True), line_of(self._room))

    def _arguments(self) -> tuple[object, ...]:
        return ctypes.byref(self._rollout), ctypes.byref(self._policy)

    def _layers_at(self, keep: bool) -> tuple[object, ...]:
        return line_of(self._kept), ctypes.c_long(self._size if keep else 0)


class _Rollout(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_long) for name in ("periods", "rows", "rest_jump")),
        *((name, ctypes.c_int) for name in ("n_x", "n_u", "n_o", "steps", "n_stops")),
        ("h", ctypes.c_float),
        *((name, ctypes.c_void_p) for name in ("advance", "constants", "position", "rate", "low", "high", "room")),
        *((name, ctypes.c_void_p) for name in ("slope", "late", "rest", "factor", "limits")),
    )


def _gradient(parameter: Tensor) -> Tensor:
    parameter.grad = torch.zeros_like(parameter) if parameter.grad is None else parameter.grad
    return parameter.grad


def _floats(tensor: Tensor) -> Tensor:
    """Return numbers as the code reads them: a plant may have set another default."""
    return tensor.float().contiguous()


@dataclass(frozen=True)
class InputStrength:
    """How strong the inputs of imagined episodes are: u_e + k (u - u_e) acts, k from 1 - share to 1 + share.

    A policy that is planned on one model alone may use all that inputs can do, and hold the model by a hair's breadth:
    the plant, whose inputs are a few hundredths weaker, is lost then. What holds a plant at rest, u_e, stays as it is,
    so that no policy has to be wrong there for some of the factors. Where an actuator reaches less than [-1, 1] to a
    side, as a pump that cannot draw, no strength takes an input beyond that.

    Attributes:
        share: By how much inputs are weaker or stronger at most.
        rest: Inputs at rest, `(T or 1, rows, n_u)`, of task parameters `(rows, n_r, 5)` at times `(T, rows, 1)` [s]; of
            the first time alone where no reference moves.
        limits: Least and largest input that acts, `(2, n_u)`, infinite where there is none.
        factor: Of the inputs' distance from rest, `(rows, n_u)`.
    """

    share: float
    rest: Callable[[Tensor, Tensor], Tensor]
    limits: Tensor
    factor: Tensor

    @classmethod
    def of(cls, env: ControlEnv, rests: Equilibria, share: float) -> InputStrength | None:
        """Return the strengths of a model, 1 all of them; None where none is asked for or nothing is regulated."""
        if not share or (regulator := Regulator.of(env, rests)) is None:
            return None
        task = env.task
        assert isinstance(task, Tracking)
        low, high = task.input_limits

        def _rest(params: Tensor, t: Tensor) -> Tensor:
            moving = bool(params[..., 1].any())  # amplitudes
            return regulator.rest(task.reference(params, t if moving else t[:1]).float())[1]

        limits = torch.stack([low.where(low > -1, -torch.inf), high.where(high < 1, torch.inf)])
        return cls(share, _rest, limits, torch.ones(1, limits.shape[1]))

    def draw(self, rows: int, rng: torch.Generator) -> InputStrength:
        """Return strengths between the ends, each input's its own, for so many episodes."""
        drawn = torch.rand(rows, self.factor.shape[1], generator=rng)
        return replace(self, factor=1 + self.share * (2 * drawn - 1))

    def ends(self, rows: int) -> InputStrength:
        """Return strengths to test a policy with: the weakest, that of the model, and the strongest, in turn."""
        turn = torch.arange(rows).remainder(3).sub(1).unsqueeze(-1)
        return replace(self, factor=(1 + self.share * turn).expand(-1, self.factor.shape[1]))

    def acting(self, u: Tensor, rest: Tensor) -> Tensor:
        """Return the inputs that act when `u` is commanded, about those at rest, `(rows, n_u)`."""
        return torch.lerp(rest, u, self.factor).clamp(self.limits[0], self.limits[1])

    def slope(self, acting: Tensor) -> Tensor:
        """Return the derivative of the inputs that acted by those commanded, each by its own, `(*batch, rows, n_u)`.

        Args:
            acting: What `acting` returned, `(*batch, rows, n_u)`.
        """
        return self.factor * ((acting > self.limits[0]) & (acting < self.limits[1]))
