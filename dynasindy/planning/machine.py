"""Imagined windows as machine code: the policy, the model and the adjoint equation of `planning.rollout`, fused.

Period by period, a good half of a window is what torch does around its products. `c/rollout.c` does the same arithmetic
in one call, for a perceptron on the CPU whose observations are linear in the states, and a model that has machine code.
"""

from __future__ import annotations

import ctypes
import warnings
from functools import cache
from importlib import resources

import torch
from torch import Tensor

from dynasindy.agents.machine import LINE, line_of, network_pointers, source
from dynasindy.agents.networks import MLP, Layer
from dynasindy.envs import ControlEnv
from dynasindy.planning.randomization import InputStrength
from dynasindy.systems import System
from dynasindy.systems.compiler import load_library
from dynasindy.systems.machine import Machine

FUNCTIONS = ("imagine", "adjoint", "layers_size", "room_size")


@cache
def _library() -> ctypes.CDLL | None:
    """Return the code of windows, None where there is no compiler or one that refuses it, which is tried once."""
    own = resources.files("dynasindy.planning").joinpath("c", "rollout.c")
    try:
        text = source("perceptron.c") + own.read_text(encoding="utf-8")
        code = load_library(text, FUNCTIONS, fast=True, cached=True)
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        warnings.warn(f"windows are imagined by torch code, which is slower: {error}", stacklevel=4)
        return None
    code.layers_size.restype = code.room_size.restype = ctypes.c_long
    return code


class MachineRollout:
    """Windows of a policy in a model, as machine code; `MachineRollout.of` returns one where there can be.

    Args:
        library: `c/rollout.c`, compiled.
        env: Imagined environment: its task, period, sub-steps and stops.
        code: Machine code of the model.
        policy: The perceptron.
        periods: Control periods of a window.
        rows: Parallel episodes.
        late: Share of a control period by which inputs are late, `(rows, 1)`; None for no delay.
        strength: How strong inputs are, and the inputs at rest in each period, `(periods or 1, rows, n_u)`.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        env: ControlEnv,
        code: Machine,
        policy: MLP,
        periods: int,
        rows: int,
        late: Tensor | None,
        strength: tuple[InputStrength, Tensor] | None,
    ) -> None:
        self._code = library
        self.policy, self.periods, self.rows = policy, periods, rows
        self._layers = [Layer(*(tensor.detach() for tensor in layer)) for layer in policy.layers()]
        self._policy = network_pointers(self._layers)
        n_o, n_x = policy.layers()[0].weight.shape[-1], code.n_x
        params, t = torch.zeros(n_x, *env.task.params_shape), torch.zeros(n_x, 1)
        still, moved = (env.task.observation(x, params, t) for x in (torch.zeros(n_x, n_x), torch.eye(n_x)))
        slope = _floats((moved - still).T)
        call = code.advance_arguments(env.dt, env.substeps, env.stops)
        factor = rest = limits = None
        if strength is not None:
            factor, rest = _floats(strength[0].factor), _floats(strength[1])
            limits = None if strength[0].limits is None else _floats(strength[0].limits)
        late = None if late is None else _floats(late)
        jump = rest.stride(0) if rest is not None and len(rest) > 1 else 0
        ends = (None, None) if limits is None else (_at(limits[0]), _at(limits[1]))
        self._rollout = _Rollout(
            periods, rows, jump, n_x, code.n_u, n_o, *call, _at(slope), _at(late), _at(factor), _at(rest), *ends
        )
        self._held = code, call, slope, late, factor, rest, limits, self._layers  # what the code points to
        self._size = self._code.layers_size(ctypes.byref(self._policy), ctypes.c_long(rows))
        self._room = torch.empty(self._code.room_size(*self._arguments()) + LINE // 4)
        self._kept = torch.empty(0)

    @classmethod
    def of(
        cls,
        env: ControlEnv,
        system: System,
        network: object,
        x: Tensor,
        periods: int,
        late: Tensor | None,
        strength: tuple[InputStrength, Tensor] | None,
    ) -> MachineRollout | None:
        """Return the machine code for windows that begin at states x, `(rows, n_x)`; None where it cannot be.

        Args:
            env: Imagined environment.
            system: Vector field.
            network: Policy.
            x: States that the windows begin at.
            periods: Control periods of a window.
            late: See `MachineRollout`.
            strength: See `MachineRollout`.
        """
        if not (isinstance(network, MLP) and network.squash and env.task.linear and x.dim() == 2 and len(x)):
            return None
        if any(p.dtype != torch.float32 or not p.is_cpu for p in network.parameters()):
            return None
        code = system.compiled(x, x.new_zeros(len(x), env.task.signature.n_u))
        if type(code) is not Machine or code.dtype != torch.float32 or (library := _library()) is None:
            return None
        return cls(library, env, code, network, periods, len(x), late, strength)

    def imagine(self, x: Tensor, held: Tensor, free: Tensor, keep: bool) -> tuple[Tensor, Tensor, Tensor]:
        """Return states `(T + 1, rows, n_x)`, inputs that acted and actions, `(T, rows, n_u)`, of a window.

        Args:
            x: States at its begin, `(rows, n_x)`.
            held: Inputs of the period before, `(rows, n_u)`.
            free: Observations of states of zero, `(T, rows, n_o)`.
            keep: Whether the policy's layers are kept for `adjoint`.
        """
        states = x.new_empty(self.periods + 1, *x.shape)
        states[0] = x
        applied, actions = x.new_empty(2, self.periods, *held.shape)
        touched = torch.empty(self.rows, dtype=torch.bool)
        held, free = _floats(held), _floats(free)
        self._kept = torch.empty(self._size * (self.periods if keep else 1) + LINE // 4)
        window = map(_at, (held, free, states, applied, actions))
        self._code.imagine(*self._arguments(), *window, *self._layers_at(keep), line_of(self._room), _at(touched))
        return states, applied, actions

    def adjoint(self, a: Tensor, b: Tensor, cost: Tensor, effort: Tensor | None) -> None:
        """Add the gradient of the cost of the last window to the policy's parameters.

        Args:
            a: Derivatives of the next state by the state, `(T, rows, n_x, n_x)`.
            b: Those by the action that acts, `(T, rows, n_x, n_u)`.
            cost: Derivatives of the cost by the states, `(T + 1, rows, n_x)`.
            effort: Those by the actions, `(T, rows, n_u)`; None where these cost nothing.
        """
        gradients = [Layer(*(_gradient(each) for each in layer)) for layer in self.policy.layers()]
        given = [None if each is None else _floats(each) for each in (a, b, cost, effort)]
        policy, pointers = self._arguments(), network_pointers(gradients)
        self._code.adjoint(
            *policy, ctypes.byref(pointers), *map(_at, given), *self._layers_at(True), line_of(self._room)
        )

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
        *((name, ctypes.c_void_p) for name in ("slope", "late", "factor", "rest", "weakest", "strongest")),
    )


def _at(tensor: Tensor | None) -> ctypes.c_void_p | None:
    return None if tensor is None else ctypes.c_void_p(tensor.data_ptr())


def _floats(tensor: Tensor) -> Tensor:
    """Return numbers as the code reads them: a plant may have set another default."""
    return tensor.float().contiguous()


def _gradient(parameter: Tensor) -> Tensor:
    if parameter.grad is None:
        parameter.grad = torch.zeros_like(parameter)
    return parameter.grad
