"""Trajectories of formulas that change from one call to the next, as those of a fit do: nothing is compiled for them.

`dynasindy.systems.machine` compiles a vector field, which takes the time of thousands of its steps. Here formulas are a
list of instructions, each of which is done for many rows at once.
"""

from __future__ import annotations

import ast
import ctypes
from dataclasses import replace
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.systems.compiler import load_library
from dynasindy.systems.machine import Program
from dynasindy.systems.steps import steps_of
from dynasindy.systems.tangents import FORMULA_FUNCTIONS, parsed

WIDTH = 32
"""Rows that are handled at once."""
OPERATIONS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.USub)
"""What instructions do, those of `FORMULA_FUNCTIONS` behind them, in the order of `c/interpreter.c`."""


def simulate_program(program: Program, x: Tensor, u: Tensor, dt: float, substeps: int) -> Tensor:
    """Advance states over periods that follow each other, see `dynasindy.systems.integrators.trajectory`.

    Args:
        program: the vector field.
        x: states at the start of the first period, `(rows, n_x)` float64.
        u: inputs held over each period, `(rows, T, n_u)` float64.
        dt: length of a period [s].
        substeps: Runge-Kutta steps in it.

    Returns:
        States at the end of each period, `(rows, T, n_x)`.

    Raises:
        ValueError: a formula holds something that is none.
        FileNotFoundError: there is no compiler.
    """
    listing = _listing(replace(program, constants=()), len(program.constants))
    h, steps, difference = steps_of(program.step, dt, substeps)
    x, u, ends = x.contiguous(), u.contiguous(), x.new_empty(*u.shape[:2], program.n_x)
    constants = torch.tensor([*program.constants, *listing.numbers], dtype=torch.float64)
    room = x.new_empty((listing.values + 3 * program.n_x) * WIDTH)
    sizes = (program.n_x, program.n_u, len(constants), listing.values)
    places = [ctypes.c_void_p(tensor.data_ptr()) for tensor in (listing.code, listing.results, constants)]
    data = [ctypes.c_void_p(tensor.data_ptr()) for tensor in (x, u, ends, room)]
    rows, periods, count = (ctypes.c_long(n) for n in (len(x), u.shape[1], len(listing.code)))
    _library().simulate(rows, periods, *sizes, count, *places, ctypes.c_double(h), steps, int(difference), *data)
    return ends


class _Listing(NamedTuple):
    """Hold the instructions of a program.

    Attributes:
        code: operation, operands and result of each, `(N, 4)` int32.
        results: where the rate of each state is, `(n_x,)` int32.
        numbers: what stands in the formulas, behind the constants of the program.
        values: how many values there are, with room for the next states behind them.
    """

    code: Tensor
    results: Tensor
    numbers: tuple[float, ...]
    values: int


def _library() -> ctypes.CDLL:
    text = resources.files("dynasindy.systems").joinpath("c", "interpreter.c").read_text(encoding="utf-8")
    return load_library(text.replace("@width@", str(WIDTH)), ("simulate",), fast=False)


@lru_cache(maxsize=512)
def _listing(program: Program, constants: int) -> _Listing:
    """Return the instructions of a program whose constants are left out, so many as there are."""
    formulas = [*(formula for _, formula in program.lines), *program.results]
    trees = [parsed(formula) for formula in formulas]
    numbers = list(
        dict.fromkeys(number for tree in trees for n in ast.walk(tree) if (number := _number(n)) is not None)
    )
    known = program.n_x + program.n_u + constants + len(numbers)
    places = {f"x[{i}]": i for i in range(program.n_x)}
    places |= {f"u[{j}]": program.n_x + j for j in range(program.n_u)}
    places |= {f"k[{k}]": program.n_x + program.n_u + k for k in range(constants)}
    places |= {repr(number): known - len(numbers) + k for k, number in enumerate(numbers)}
    code: list[tuple[int, int, int, int]] = []

    def _place(node: ast.expr) -> int:
        """Return where a formula's value is, once what computes it is in the list."""
        text = ast.unparse(node) if (number := _number(node)) is None else repr(number)
        if text in places:
            return places[text]
        match node:
            case ast.BinOp(left, operator, right) if type(operator) in OPERATIONS:
                own, operands = OPERATIONS.index(type(operator)), [left, right]
            case ast.UnaryOp(ast.USub(), operand):
                own, operands = OPERATIONS.index(ast.USub), [operand]
            case ast.Call(ast.Name(name), operands) if name in FORMULA_FUNCTIONS:
                own = len(OPERATIONS) + FORMULA_FUNCTIONS.index(name)
            case _:
                raise ValueError(f"{text[:60]!r} is no part of a formula")
        first, *others = map(_place, operands)
        place = places[text] = known + len(code)
        code.append((own, first, others[0] if others else first, place))
        return place

    found = []
    for name, tree in zip([*(name for name, _ in program.lines), *program.results], trees, strict=True):
        found.append(_place(tree))
        places[name] = found[-1]
    listed = torch.tensor(code, dtype=torch.int32).reshape(-1, 4)
    results = torch.tensor(found[len(program.lines) :], dtype=torch.int32)
    return _Listing(listed, results, tuple(numbers), known + len(code) + program.n_x)


def _number(node: ast.AST) -> float | None:
    """Return the number that a part of a formula is; None if it is none."""
    value = node.value if isinstance(node, ast.Constant) else None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
