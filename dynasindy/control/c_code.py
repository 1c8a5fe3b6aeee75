"""A controller as C99, observer, integral action, observation and policy, or a model alone: no Python, no library.

The text is put together from `dynasindy/control/c`, with the numbers of the controller as constants and with what it
does not have left out. It allocates nothing and keeps everything that changes in a struct of the caller.
"""

from __future__ import annotations

import ctypes
import re
import textwrap
import timeit
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jinja2
import numpy as np

from dynasindy.control.controller import Array, Controller, IntegralAction
from dynasindy.control.observer import FAR, LARGEST_SHIFT, LEAST, MOST_STEPS, NUDGE, STEPS, UNKNOWN
from dynasindy.sindy import SindyModel
from dynasindy.sindy.codegen import PLAIN, comment, formulas, number, right_sides
from dynasindy.systems import Signature
from dynasindy.systems.base import WHOLE
from dynasindy.systems.compiler import load_library

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")


def _module_name(name: str) -> str:
    if not IDENTIFIER.fullmatch(name):
        raise ValueError(
            f"name is {name[:40]!r}; allowed are a letter, then letters, digits and '_', 31 at most: choose another"
        )
    return name


def _identifiers(names: Iterable[str]) -> list[str]:
    """Return one identifier per name, none twice; they are to follow a prefix, and may be a word of the language."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W", "_", name.translate(PLAIN), flags=re.ASCII)
        numbered = (f"{plain}_{count}" for count in range(2, len(found) + 3))
        found.append(next(each for each in (plain, *numbered) if each not in found))
    return found


def _floats(values: Array) -> str:
    """Return numbers of single precision for C, exact to their last bits, in lines of a readable length."""
    lines = textwrap.wrap(", ".join(f"{value:.8e}f" for value in values.tolist()), 100, break_on_hyphens=False)
    return "\n".join(f"    {line}" for line in lines)


def _block(lines: Iterable[str]) -> str:
    wrap = partial(textwrap.wrap, width=110, subsequent_indent="      ", break_on_hyphens=False)
    return "\n".join(f" * {part}".rstrip() for line in lines for part in wrap(comment(line)) or [""])


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("dynasindy.control", "c"),
    undefined=jinja2.StrictUndefined,
    line_statement_prefix="@",
    keep_trailing_newline=True,
)
TEMPLATES.filters |= {"number": number, "comment": comment, "block": _block, "floats": _floats}
# An end that is not there is the largest number.
TEMPLATES.filters["bound"] = lambda value: number(np.nan_to_num(value))
TEMPLATES.filters["numbers"] = lambda values: ", ".join(map(number, values))


def fill(template: str, templates: jinja2.Environment = TEMPLATES, /, **words: object) -> str:
    """Return the text of a template of Jinja, whose statements are lines that begin with `@`.

    What is filled in is not looked at again, so that words of a file cannot open gaps of their own.
    """
    return templates.get_template(template).render(words)


@dataclass(frozen=True)
class Sources:
    """A header and a source file of C99.

    Attributes:
        name: What all their names begin with, and the files too.
        header: Text of `NAME.h`.
        source: Text of `NAME.c`.
        shape: Of a controller, numbers of states, of inputs and of tracked states.
    """

    name: str
    header: str
    source: str
    shape: tuple[int, ...] = ()

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
        ValueError: The name is none.
    """
    name, signature, found = _module_name(name), model.signature, right_sides(model)
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
    return [
        f"    {name}_{kind}_{word} = {place}"
        for kind, names in (("x", signature.state_names), ("u", signature.input_names), ("r", outputs))
        for place, word in enumerate(_identifiers(names))
    ]


def _signature_words(signature: Signature, limits: Sequence[Sequence[float]] = ()) -> list[str]:
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


def controller_sources(controller: Controller, name: str = "controller") -> Sources:
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
    name, signature, observer = _module_name(name), controller.signature, controller.observer
    task, integral = controller.setup.task, controller.integral
    weights = [(layer.weight.cpu(), layer.bias.cpu()) for layer in controller.network.layers()]
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
        model, size = observer.sparse_model, observer.scale
        if (n := observer.n_x + model.signature.n_u) > MANY:
            raise ValueError(f"an observer of {n} states and inputs is too large for the stack of C, {MANY} at most")
        sensed = [signature.state_index(state) for state in controller.measured]
        words |= {
            "model": model,
            "found": formulas(model).with_constants(observer.pushed, len(observer.pushed)),
            "stops": [] if observer.stops is None else observer.stops.rows(observer.n_x),
            "measured": comment(", ".join(controller.measured)),
            "memory": observer.sensors.delay + observer.late()[0] + 2,
            "size": size,
            "nudge": NUDGE,
            "strays": (observer.q * size).square() * observer.dt,
            "unknown": (UNKNOWN * size).square(),
            "sensed": sensed,
            "narrowest": (LEAST * size[sensed]).square(),
            "far": FAR,
            "turns": (STEPS, MOST_STEPS),
            "most": LARGEST_SHIFT,
            "range": [*size[: observer.n_x].tolist(), *[1.0] * model.signature.n_u],
        }
    header, source = (fill(f"controller.{ending}", **words) for ending in "hc")
    return Sources(name, header, source, (signature.n_x, signature.n_u, task.n_r))


class Native:
    """A controller in C that this computer has compiled, called as the one in Python.

    Args:
        sources: The controller.

    Attributes:
        state: Its struct in C, as numbers.

    Raises:
        FileNotFoundError: There is no compiler.
        ValueError: The compiler refuses the sources.
        OSError: What the compiler wrote cannot be loaded.
    """

    def __init__(self, sources: Sources) -> None:
        name, self._sources = sources.name, sources
        size = f"\nunsigned long size(void) {{ return sizeof({name}_state) / sizeof(double); }}\n"
        text = sources.header + sources.source.replace(f'#include "{name}.h"\n', "") + size
        code = load_library(text, fast=False)
        n_x, n_u, n_r = sources.shape
        self.state, self._u = np.zeros(code.size()), np.zeros(n_u)
        self._given = np.zeros(n_x), np.zeros(n_r), np.zeros(n_r)
        places = [ctypes.c_void_p(array.ctypes.data) for array in (self.state, *self._given, self._u)]
        self._act = partial(code[f"{name}_act"], *places)

    def __reduce__(self) -> tuple[object, ...]:
        """Return what a copy is made of, which the library itself is not."""
        return Native, (self._sources,), self.state

    def __setstate__(self, state: Array) -> None:
        self.state[:] = state

    def reset(self) -> None:
        """Forget what was measured."""
        self.state[:] = 0.0

    def act(
        self, y: Sequence[float] | Array, r: Sequence[float] | Array, rate: Sequence[float] | Array | None = None
    ) -> Array:
        """Return the inputs of the control period that begins now, `(n_u,)`.

        Args:
            y: What was measured now, NaN where nothing was.
            r: Where the outputs are to be.
            rate: How fast the reference moves; 0 if omitted.

        Raises:
            ValueError: There are more or fewer numbers than there have to be, or one is not finite.
        """
        for place, values in zip(self._given, (y, r, [0.0] * len(r) if rate is None else rate), strict=True):
            if len(values) != len(place):
                raise ValueError(f"{len(values)} numbers are given where {len(place)} belong")
            place[:] = values
        if self._act():
            raise ValueError("a measurement, a reference or an input is not finite; give finite numbers")
        return self._u.copy()

    def microseconds(self) -> float:
        """Return the time that a call takes on this computer, from Python and as the best of five [us]."""
        for values in self._given:  # zeros would end in numbers too small to be added fast
            values[:] = 0.1
        timer = timeit.Timer(self._act)
        calls, _ = timer.autorange()
        best = min(timer.repeat(5, calls // 10 + 1)) / (calls // 10 + 1)
        self.reset()
        return 1e6 * best
