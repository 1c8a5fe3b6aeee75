"""The tracking task as machine code: what a control period shows and earns, in one call for any number of rows."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from dynasindy.envs.references import N_PARAMS
from dynasindy.envs.reward import ERROR_SHAPES, TrackingReward
from dynasindy.envs.task import Task
from dynasindy.envs.tracking import Tracking
from dynasindy.systems.compiler import addresses, c_text, find_library

REALS = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
COUNTS = ("n_x", "n_r", "n_rates", "observe_rate", "shape")
PLACES = ("outputs", "rates", "rated")
VECTORS = ("scale", "unit", "error_unit", "weight")
NUMBERS = ("rate_weight", "bonus", "tolerance", "stop_penalty", "width", "dt")


class TrackingMachine:
    """Observations, references and rewards of a `Tracking` task, as its torch code computes them.

    Args:
        library: `c/tracking.c`, compiled for the type of the states.
        task: The task.
        dt: Control period [s].
        dtype: Type of states, parameters and references.
    """

    def __init__(self, library: ctypes.CDLL, task: Tracking, dt: float, dtype: torch.dtype) -> None:
        self._made_of = task, dt, dtype
        reward, unit, real = task.reward_function, task.boxes().tolist(), REALS[dtype]
        rated = task.rated if len(task.rates) < task.n_r else range(task.n_r)
        shape, one = list(ERROR_SHAPES).index(reward.error_shape), len(reward.error_weights) == 1
        counts = task.signature.n_x, task.n_r, len(task.rates), task.observe_rate, shape
        weights = reward.error_weights * (task.n_r if one else 1)
        vectors = task.signature.x_scale, unit, [task.error_scale * extent for extent in unit], weights
        places = [(ctypes.c_int * len(of))(*of) for of in (task.outputs, task.rates, list(rated))]
        fields = [*((name, ctypes.c_int) for name in COUNTS), *((name, ctypes.c_void_p) for name in PLACES + VECTORS)]
        kind = type("Task", (ctypes.Structure,), {"_fields_": [*fields, *((name, real) for name in NUMBERS)]})
        self._held: list[Any] = [*places, *((real * len(of))(*of) for of in vectors)]
        numbers = (*(getattr(reward, name) for name in NUMBERS[:-1]), dt)
        self._task = kind(*counts, *(ctypes.addressof(each) for each in self._held), *numbers)
        self._code, self.n_o, self.n_r = library, task.n_o, task.n_r

    @classmethod
    def of(cls, task: Task, dt: float, dtype: torch.dtype) -> TrackingMachine | None:
        """Return the machine code of a task; None of another than `Tracking`, or without a compiler."""
        if type(task) is not Tracking or type(task.reward_function) is not TrackingReward or task.fence:
            return None
        library = _library(dtype) if dtype in REALS else None
        return None if library is None else cls(library, task, dt, dtype)

    def __reduce__(self) -> tuple[Any, ...]:
        """Have copies and pickles make their own."""
        return TrackingMachine.of, self._made_of

    def judge(
        self, x: Tensor | None, following: Tensor, params: Tensor, steps: Tensor, touched: Tensor | None
    ) -> dict[str, Tensor]:
        """Return `observation`, `reference` and, of a period, `reward`, `(*batch, 1)`; see `bind` for its arguments."""
        batch = following.shape[:-1]
        if following.dim() != 2 or following.stride(-1) != 1:
            following = following.contiguous()
        params = params.to(following).expand(*batch, self.n_r, N_PARAMS).contiguous()
        steps = steps.expand(*batch, 1).contiguous()
        shown = {
            "observation": torch.empty(*batch, self.n_o, dtype=torch.float32),
            "reference": following.new_empty(*batch, self.n_r),
        }
        if x is not None and touched is not None:
            x, touched = x.expand_as(following).contiguous(), touched.expand(batch).contiguous()
            shown["reward"] = torch.empty(*batch, 1, dtype=torch.float32)
        self.bind(x, following, params, steps, touched, list(shown.values()))()
        return shown

    def bind(
        self,
        x: Tensor | None,
        following: Tensor,
        params: Tensor,
        steps: Tensor,
        touched: Tensor | None,
        results: Sequence[Tensor],
    ) -> Callable[[], None]:
        """Return the call that judges what lies in these tensors when it is made; all are contiguous but `following`.

        Args:
            x: States at the start of the period, `(*batch, n_x)`; None if nothing is earned.
            following: States at its end, `(*batch, n_x)`, whose rows may lie apart.
            params: Parameters of the references, `(*batch, n_r, 5)`.
            steps: Control periods since the episodes began, int64 `(*batch, 1)`.
            touched: Whether a stop was touched, bool `(*batch,)`; None if nothing is earned.
            results: Where the observations, `(*batch, n_o)`, the references, `(*batch, n_r)`, and, if something is
                earned, the rewards, `(*batch,)`, are written to.
        """
        rows, stride = ctypes.c_long(steps.numel()), following.stride(-2) if following.dim() > 1 else 0
        read, written = (
            addresses(x, following),
            addresses(params, steps, touched, *results, *[None] * (3 - len(results))),
        )
        arguments = ctypes.byref(self._task), rows, *read, ctypes.c_long(stride), *written
        held = self, x, following, params, steps, touched, results  # the code knows only where they lie

        def _judge(code: ctypes.CDLL = self._code, kept: object = held) -> None:
            code.judge(*arguments)

        return _judge


@cache
def _library(dtype: torch.dtype) -> ctypes.CDLL | None:
    text = c_text("envs", "tracking.c")
    single = dtype == torch.float32
    words = {"real": "float" if single else "double"}
    text = re.sub(r"@(\w+)@", lambda gap: words.get(gap[1], gap[1] + "f" * single), text)
    return find_library(text, "a tracking task is judged", fast=False)
