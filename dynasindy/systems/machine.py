"""Vector fields as machine code: control periods and their derivatives, on the CPU.

Rollouts of a hundred rows, and of one, are made of small operations, each of which costs torch more than its
arithmetic. Where the equations are known in formulas they are written in C and compiled by the system's compiler, if
there is one.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from dynasindy.systems.compiler import addresses, c_text, load_library
from dynasindy.systems.steps import Stops, steps_of
from dynasindy.systems.tangents import ExpressionGraph

SINGLE = {
    "sin": "sine",
    "cos": "cosine",
    "exp": "power_of_e",
    "tanh": "hyperbolic_tangent",
    "sqrt": "sqrtf",
    "fabs": "magnitude",
}
"""Names in `c/period.c`, in single precision, of what formulas call by other names."""
WIDTH = 32
"""Rows that are handled at once, of which rollouts have hundreds."""
MANY = 512
"""Derivatives of so many states by state and input are handled for several rows at once, as they stay in a cache."""
FREE = Stops((), (), (), ())
_STATE = re.compile(r"([xu])\[(\d+)\]")


@dataclass(frozen=True)
class Program:
    """A vector field dx/dt = f(x, u) in formulas of `x[0]`, `u[0]`, ... in operators and `FORMULA_FUNCTIONS`.

    Attributes:
        n_x: number of states.
        n_u: number of inputs.
        lines: name and formula of each value, in the order in which they are computed.
        results: formula of dx/dt of each state.
        constants: what `k[0]`, `k[1]`, ... stand for.
        step: of the difference equation that it belongs to [s]; None of a differential equation.
    """

    n_x: int
    n_u: int
    lines: tuple[tuple[str, str], ...]
    results: tuple[str, ...]
    constants: tuple[float, ...] = ()
    step: float | None = None

    def has(self, word: str) -> bool:
        """Whether a formula has a word, such as `u`, or `sin`."""
        return any(re.search(rf"\b{word}\b", text) for text in (*(formula for _, formula in self.lines), *self.results))

    def with_constants(self, added_to: Sequence[int], count: int) -> Program:
        """Return the vector field with states more that stay, the first of which add to the rates of some.

        Args:
            added_to: states that one of them adds to the rate of, one for each.
            count: how many there are.
        """
        terms = {state: f" + x[{self.n_x + k}]" for k, state in enumerate(added_to)}
        results = (f"{result}{terms.get(i, '')}" for i, result in enumerate(self.results))
        return replace(self, n_x=self.n_x + count, results=(*results, *["0.0"] * count))


class Machine:
    """A vector field, compiled.

    Args:
        program: its formulas; programs that differ by their constants share their code.
        dtype: float32, fast for many rows, or float64, operation by operation as the formulas say.

    Raises:
        ValueError: a formula holds something that is none, or the compiler refuses the text.
        FileNotFoundError: there is no compiler.
    """

    def __init__(self, program: Program, dtype: torch.dtype = torch.float32) -> None:
        self.n_x, self.n_u, self.dtype, self.program = program.n_x, program.n_u, dtype, program
        self.step = program.step
        self._real = ctypes.c_float if dtype == torch.float32 else ctypes.c_double
        self._constants = self._reals(program.constants)
        single = dtype == torch.float32
        source = _source(replace(program, constants=()), WIDTH if single else 1, single)
        self._code = load_library(source, fast=single)
        n_x, n_u = program.n_x, program.n_u
        self._size = (6 * n_x + n_u + 5 * n_x * (n_x + n_u)) * _rows(n_x, n_u, WIDTH if single else 1)
        self._room = torch.empty(self._size, dtype=dtype)
        self._ends: dict[Stops, tuple[Any, ...]] = {}

    def fits(self, x: Tensor, u: Tensor) -> bool:
        """Return whether states and inputs are as many numbers of the kind as it computes in, in the CPU's memory."""
        if not (x.dtype == u.dtype == self.dtype and x.device.type == u.device.type == "cpu"):
            return False
        # The code reads as many numbers as it was written for, whatever is there.
        return x.shape[:-1] == u.shape[:-1] and (x.shape[-1:], u.shape[-1:]) == ((self.n_x,), (self.n_u,))

    def bind(
        self, x: Tensor, u: Tensor, samples: Tensor, touched: Tensor, dt: float, substeps: int, stops: Stops | None
    ) -> Callable[[], None]:
        """Return the call that advances what lies in these tensors when it is made, over periods in their order.

        Args:
            x: states at the start of the first period, `(*batch, n_x)`.
            u: inputs held in each period, `(T, *batch, n_u)`.
            samples: where the states go, `(T, *batch, steps, n_x)`; the steps of a difference equation are its own.
            touched: where it goes whether a stop was touched, bool `(T, *batch)`.
            dt: control period [s].
            substeps: Runge-Kutta steps per period.
            stops: mechanical stops, if any.

        Raises:
            IndexError: a stop is of a state that does not exist.
            ValueError: the period is not made of whole steps of a difference equation.
        """
        length, count, _ = steps_of(self.step, dt, substeps)
        ends, n_stops = self._in_memory(stops or FREE), len((stops or FREE).positions)
        periods, rows = ctypes.c_long(len(u)), ctypes.c_long(x.shape[:-1].numel())
        room = x.new_empty(self._size)
        read = *addresses(x, u), self._constants, self._real(length), int(count), n_stops, *ends
        arguments = periods, rows, *read, *addresses(samples, touched, room)

        held = x, u, samples, touched, room  # the code knows only where they lie

        def _advance(code: ctypes.CDLL = self._code, kept: object = held) -> None:
            code.advance(*arguments)

        return _advance

    def advance_arguments(self, dt: float, substeps: int, stops: Stops | None = None) -> tuple[object, ...]:
        """Return what other machine code advances states with: steps, stops, step length, and where the rest lies.

        The last six are the function `advance` of `c/period.c` and what it reads: constants, four arrays of the stops,
        and room. They stay where they are as long as this code.

        Args:
            dt: control period [s].
            substeps: Runge-Kutta steps per period.
            stops: mechanical stops, if any.
        """
        stops = stops or FREE
        length, count, _ = steps_of(self.step, dt, substeps)
        places = (self._code.advance, self._constants, *self._in_memory(stops))
        read = (ctypes.cast(each, ctypes.c_void_p) for each in places)
        return int(count), len(stops.positions), length, *read, *addresses(self._room)

    def sensitivities(self, x: Tensor, u: Tensor, dt: float, substeps: int) -> tuple[Tensor, Tensor]:
        """Return dx_next/dx, `(*batch, n_x, n_x)`, and dx_next/du, `(*batch, n_x, n_u)`, of a period without stops.

        Args:
            x: states, `(*batch, n_x)`.
            u: inputs, `(*batch, n_u)`.
            dt: control period [s].
            substeps: Runge-Kutta steps per period.

        Raises:
            ValueError: the period is not made of whole steps of a difference equation.
        """
        x, u = x.contiguous(), u.contiguous()
        length, count, _ = steps_of(self.step, dt, substeps)
        a, b = x.new_empty(*x.shape, self.n_x), x.new_empty(*x.shape, self.n_u)
        rows, h = ctypes.c_long(x.numel() // self.n_x), self._real(length)
        room = x.new_empty(self._size)
        self._code.sensitivities(rows, *addresses(x, u), self._constants, h, int(count), *addresses(a, b, room))
        return a, b

    def _in_memory(self, stops: Stops) -> tuple[Any, ...]:
        """Return stops as the code reads them; they are kept, as to write them costs as much as a control period."""
        if stops not in self._ends:
            places = range(self.n_x)  # of a column that is negative, and counts from the last, too
            columns = ([places[column] for column in of] for of in (stops.positions, stops.rates))
            at = ((ctypes.c_int * len(of))(*of) for of in columns)
            self._ends[stops] = *at, self._reals(stops.low), self._reals(stops.high)
        return self._ends[stops]

    def _reals(self, values: Sequence[float]) -> ctypes.Array[ctypes.c_float] | ctypes.Array[ctypes.c_double]:
        return (self._real * len(values))(*values)


def _rows(n_x: int, n_u: int, width: int) -> int:
    return width if n_x * (n_x + n_u) <= MANY else 1


@lru_cache(maxsize=128)
def _source(program: Program, width: int, single: bool) -> str:
    """Return the C text of a program, its constants left out; every word of it is one that the graph knows."""
    names = [f"x[{i}]" for i in range(program.n_x)] + [f"u[{j}]" for j in range(program.n_u)]
    graph = ExpressionGraph({name: number for number, name in enumerate(names)}, program.lines, program.results)
    entries = graph.entries or [(0, 0, graph.node("0.0"))]  # C has no empty arrays
    rows, columns, slopes = zip(*entries, strict=True)

    def text(place: int) -> str:
        leaf, operands = graph.nodes[place]
        return f"v{place}" if operands else _STATE.sub(r"\1[\2 * W + r]", leaf) if leaf[0] in "xuk" else f"(real){leaf}"

    def body(places: Iterable[int], results: Sequence[str]) -> str:
        statements = list[str]()
        for place in graph.needed(places):
            operation, operands = graph.nodes[place]
            first, *others = map(text, operands or (place,))
            called = SINGLE.get(operation, operation) if single else operation
            formula = f"-{first}" if operation == "neg" else f"{called}({', '.join([first, *others])})"
            formula = f"{first} {operation} {others[0]}" if operation in "+-*/" else formula
            statements += [f"const real v{place} = {formula};"] * bool(operands)
        return "\n".join(f"        {statement}" for statement in [*statements, *results])

    rates = [f"f[{i} * W + r] = {text(place)};" for i, place in enumerate(graph.results)]
    words = {
        "real": "float" if single else "double",
        "single": int(single),
        "width": _rows(program.n_x, program.n_u, width),
        "n_x": program.n_x,
        "n_u": program.n_u,
        "n_slopes": len(entries),
        "stages": 4 if program.step is None else 1,
        "affine": int(not any(_STATE.match(graph.nodes[place][0]) for place in graph.needed(slopes))),
        "rates": body(graph.results, rates),
        "slopes": body(
            [*graph.results, *slopes], rates + [f"j[{p} * W + r] = {text(at)};" for p, at in enumerate(slopes)]
        ),
        "slope_rows": ", ".join(map(str, rows)),
        "slope_columns": ", ".join(map(str, columns)),
    }
    return re.sub(r"@(\w+)@", lambda gap: str(words[gap[1]]), c_text("systems", "period.c"))
