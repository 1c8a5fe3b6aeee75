"""A controller as C99, observer, integral action, observation and policy, or a model alone: no Python, no library.

The text is put together from `dynasindy/export/c`, with the numbers of the controller as constants and with what it
does not have left out. It allocates nothing and keeps everything that changes in a struct of the caller.
"""

from __future__ import annotations

import ctypes
import tempfile
import timeit
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynasindy.control import Controller
from dynasindy.control.files import network, require_sparse, require_states
from dynasindy.control.integral import IntegralAction
from dynasindy.export.expressions import (
    comment,
    fill,
    formulas,
    identifiers,
    module_name,
    number,
    right_sides,
)
from dynasindy.sensing import Observer
from dynasindy.sensing.observer import FAR, LEAST, NUDGE, UNKNOWN
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, Stops
from dynasindy.systems.base import WHOLE
from dynasindy.systems.compiler import SUFFIX, compile_library


@dataclass(frozen=True)
class Sources:
    """A header and a source file of C99.

    Attributes:
        name: What all their names begin with, and the files too.
        header: Text of `NAME.h`.
        source: Text of `NAME.c`.
    """

    name: str
    header: str
    source: str

    def files(self) -> dict[str, str]:
        """Return the texts by the names of their files."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.source}


def model_sources(model: SindyModel, name: str = "model") -> Sources:
    """Write a model as a C function `NAME_dx(x, u, dx)`; a difference equation as `NAME_next(x, u, next)`.

    Args:
        model: The model.
        name: What the names in C, and those of the files, begin with.

    Returns:
        Header and source of the model in C.

    Raises:
        ValueError: The name is none, or the model has a function without a formula.
    """
    name, signature, found = module_name(name), model.signature, right_sides(model)
    kind, result = ("dx/dt = f(x, u)", "dx") if model.step is None else ("x[k+1] = F(x[k], u[k])", "next")
    about = _signature_words(signature)
    if model.step is not None:
        about.append(f"A step takes {model.step!r} s, in which the inputs are held.")
    if model.delay:
        about.append(f"Inputs act {model.delay!r} s after they are given: u is what acts.")
    n_x, n_u = signature.n_x, max(1, signature.n_u)
    head = f"void {name}_{result}(const double x[{n_x}], const double u[{n_u}], double {result}[{n_x}])"
    header = fill("model.h", name=name, kind=kind, about=about, places=_places(signature, name), head=head)
    source = f'#include "{name}.h"\n\n#include <math.h>\n\n'
    return Sources(name, header, source + fill("field.c", model=model, found=found, head=head, result=result))


def _places(signature: Signature, name: str, outputs: Sequence[str] = ()) -> list[str]:
    """Return enumerators of the places of states, inputs and references in their arrays."""
    return [
        f"    {name}_{kind}_{word} = {place}"
        for kind, names in (("x", signature.state_names), ("u", signature.input_names), ("r", outputs))
        for place, word in enumerate(identifiers(names))
    ]


def _signature_words(signature: Signature, limits: Sequence[Sequence[float]] = ()) -> list[str]:
    """Return lines that tell states and inputs with their units.

    Args:
        signature: Of the plant.
        limits: Least and largest value of each input that is commanded; by default what the plant takes.
    """
    ends = limits or signature.input_limits or (WHOLE,) * signature.n_u
    states = zip(signature.state_names, signature.state_units, signature.x_scale, strict=True)
    return [
        "x: states",
        *(f"    {i}  {n} [{unit}], of a range of {number(scale)}" for i, (n, unit, scale) in enumerate(states)),
        "u: inputs of the plant",
        *(
            f"    {i}  {n} [-], from {low:.6g} to {high:.6g}"
            for i, (n, (low, high)) in enumerate(zip(signature.input_names, ends, strict=True))
        ),
        *signature.own_inputs(ranged=False),
    ]


MANY = 400
"""States and inputs of an observer in C: a call takes three matrices of them on the stack, 4 MiB of the usual 8."""


@dataclass(frozen=True)
class ControllerSources(Sources):
    """A controller in C.

    Attributes:
        shape: Numbers of states, of inputs and of tracked states.
    """

    shape: tuple[int, int, int]


def controller_sources(controller: Controller, name: str = "controller") -> ControllerSources:
    """Write a controller as C functions `NAME_reset` and `NAME_act`.

    Args:
        controller: Its policy is an actor of `dynasindy.agents`, and the model of its observer a sparse one.
        name: What the names in C, and those of the files, begin with.

    Returns:
        Header, source and names of the controller in C.

    Raises:
        ValueError: The name is none, the policy or the model is of another kind, or the model has a function without a
            formula, or so many states that a call would overflow the stack.
    """
    name, signature, task, observer = (
        module_name(name),
        controller.signature,
        controller.setup.task,
        controller.observer,
    )
    weights = [(layer.weight.cpu(), layer.bias.cpu()) for layer in network(controller).layers()]
    integral = controller.integral
    targets, units = controller.targets_in_words(), dict(zip(signature.state_names, signature.state_units, strict=True))
    words: dict[str, Any] = {
        "name": name,
        "signature": signature,
        "task": task,
        "dt": number(controller.dt),
        "about": [
            *_signature_words(signature, task.input_limits.mT.tolist()),
            "r: references" + (f", planned for {', '.join(targets)}" if targets else ""),
            *(f"    {i}  {output} [{units[output]}]" for i, output in enumerate(controller.outputs)),
            "",
            f"Period: {number(controller.dt)} s.",
        ],
        "places": _places(signature, name, controller.outputs),
        "weights": weights,
        "widest": max(max(w.shape) for w, _ in weights),
        "integral": None if integral is None else IntegralAction(controller.policy, controller.setup, **integral),
        "moves": [dict(zip(task.rated, task.rates, strict=True)).get(k, -1) for k in range(task.n_r)],
        "observer": observer,
        "pushed": False if observer is None else observer.pushed,
    }
    if observer is not None:
        words |= _observer_words(controller, observer)
    header, source = (fill(f"controller.{ending}", **words) for ending in "hc")
    return ControllerSources(name, header, source, (signature.n_x, signature.n_u, task.n_r))


def _observer_words(controller: Controller, observer: Observer) -> dict[str, Any]:
    """Return what the templates are told of an observer.

    Raises:
        ValueError: The model is not sparse, or has so many states that a call would overflow the stack.
    """
    model, (whole, part), dt, size = require_sparse(observer), observer.late(), observer.dt, observer.scale
    if (n := observer.n_x + model.signature.n_u) > MANY:
        raise ValueError(
            f"an observer of {n} states and inputs overflows the stack in C; allowed are {MANY}: identify fewer states"
        )
    late = observer.sensors.delay + whole
    sensed = [controller.signature.state_index(state) for state in controller.measured]

    def _flow(age: int, seconds: float) -> list[tuple[int, float, int]]:
        """Return the age of an input, and the steps by which a time is passed under it; none where it is zero."""
        number = max(1, observer.steps(seconds).number) if seconds else 0
        return [(age, seconds / number, number)] if number else []

    return {
        "model": model,
        "found": formulas(model).with_constants(observer.pushed, len(observer.pushed)),
        "stops": stop_ends(observer.stops, observer.n_x),
        "measured": comment(", ".join(controller.measured)),
        "memory": late + 2,
        "period": _flow(late + 2, part) + _flow(late + 1, dt - part),
        "ahead": _flow(late + 1, part) + [step for age in range(late, 0, -1) for step in _flow(age, dt)],
        "size": size,
        "nudge": NUDGE,
        "strays": (observer.q * size).square() * dt,
        "unknown": (UNKNOWN * size).square(),
        "sensed": sensed,
        "narrowest": (LEAST * size[sensed]).square(),
        "far": number(FAR**2),
        "range": [*size[: observer.n_x].tolist(), *[1.0] * model.signature.n_u],
    }


def stop_ends(stops: Stops | None, n_x: int) -> list[tuple[int, int, float, float]]:
    """Return the places of position and rate of each stop, and its ends.

    Raises:
        ValueError: They are at states that do not exist.
    """
    if stops is None:
        return []
    require_states(stops, n_x)
    return list(zip(stops.positions, stops.rates, stops.low, stops.high, strict=True))


class Native:
    """A controller in C that this computer has compiled, called as the one in Python.

    Args:
        sources: The controller.

    Raises:
        FileNotFoundError: There is no compiler.
        ValueError: The compiler refuses the sources.
    """

    def __init__(self, sources: ControllerSources) -> None:
        name = sources.name
        more = f'''#include "{name}.h"

unsigned long size(void);
unsigned long size(void) {{ return sizeof({name}_state); }}

void many({name}_state *s, const double *y, double *u, int n);
void many({name}_state *s, const double *y, double *u, int n)
{{
    while (n--)
        {name}_act(s, y, y, y, u);
}}
'''
        # A folder of its own each time: a library that is loaded must not be overwritten.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
            for file, text in {**sources.files(), "more.c": more}.items():
                (Path(place) / file).write_text(text, encoding="utf-8")
            units = [Path(place) / f"{name}.c", Path(place) / "more.c"]
            loaded = ctypes.CDLL(str(compile_library(units, Path(place) / f"loaded{SUFFIX}")))
        self.shape, self._many = sources.shape, loaded.many
        self._reset, self._act = (getattr(loaded, f"{name}_{function}") for function in ("reset", "act"))
        numbers = ctypes.POINTER(ctypes.c_double)
        self._reset.argtypes, self._reset.restype = [ctypes.c_void_p], None
        self._act.argtypes, self._act.restype = [ctypes.c_void_p, *[numbers] * 4], ctypes.c_int
        loaded.size.restype = ctypes.c_ulong
        self.state = ctypes.create_string_buffer(loaded.size())
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        self._reset(self.state)

    def act(self, y: Sequence[float], r: Sequence[float], rate: Sequence[float] | None = None) -> NDArray[np.float64]:
        """Return the inputs of the control period that begins now, `(n_u,)`.

        Args:
            y: What was measured now, NaN where nothing was.
            r: Where the outputs are to be.
            rate: How fast the reference moves; 0 if omitted.

        Raises:
            ValueError: There are more or fewer numbers than there have to be, or one is not finite.
        """
        n_x, n_u, n_r = self.shape
        u = np.empty(n_u)
        slope = None if rate is None else _numbers(rate, n_r)
        if self._act(self.state, _numbers(y, n_x), _numbers(r, n_r), slope, _pointer(u)):
            raise ValueError("a measurement, a reference or an input is not finite; give finite numbers")
        return u

    def microseconds(self) -> float:
        """Return the time that a call takes on this computer, the best of five [us]."""
        # One array serves as measurements, references and rates. Zeros would end in numbers too small to be added fast.
        given, u, calls, best = np.full(max(self.shape), 0.1), np.empty(self.shape[1]), 1, 0.0
        while best < 0.02:
            calls *= 4
            call = partial(self._many, self.state, _pointer(given), _pointer(u), ctypes.c_int(calls))
            best = min(timeit.repeat(call, number=1, repeat=5))
        self.reset()
        return 1e6 * best / calls


def _numbers(values: Sequence[float], count: int) -> object:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (count,):
        raise ValueError(f"{array.size} numbers are given where {count} belong")
    return _pointer(array)


def _pointer(values: NDArray[np.float64]) -> object:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
