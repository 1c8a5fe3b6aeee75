"""The equations of a sparse model as plain formulas, which C, NumPy and CasADi read alike.

They are written by the very code that writes them for torch, `dynasindy.world_models.fast_field`: what several terms
share is computed once. Operators are infix, and what is called are `functions.FORMULA_FUNCTIONS` alone.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from torch import Tensor

from dynasindy.export.names import number
from dynasindy.world_models import SindyModel
from dynasindy.world_models.fast_field import FieldWriter
from dynasindy.world_models.functions import FORMULA_FUNCTIONS, function
from dynasindy.world_models.library import Library

_OPERATOR = re.compile(r" [-+*/] |-(?=square)")
_CALL = re.compile(rf"\b({'|'.join(FORMULA_FUNCTIONS)})\(")


@dataclass(frozen=True)
class Formulas:
    """A vector field dx/dt = f(x, u) in formulas of `x[0]`, `u[0]`, ...

    Attributes:
        lines: Name and formula of each value, in the order in which they are computed.
        results: Formula of dx/dt of each state.
        calls: How often each of `FORMULA_FUNCTIONS` is called.
        operations: Number of sums, differences, products and quotients.
    """

    lines: tuple[tuple[str, str], ...]
    results: tuple[str, ...]
    calls: Counter[str]
    operations: int

    @property
    def flops(self) -> int:
        """Number of operations on floating-point numbers, a call counted as one."""
        return self.operations + self.calls.total()

    def reads(self, variable: str) -> bool:
        """Whether `x` or `u` occurs."""
        return any(f"{variable}[" in formula for formula in (*self.results, *(text for _, text in self.lines)))


def formulas(model: SindyModel) -> Formulas:
    """Return the equations of a model as formulas.

    Raises:
        ValueError: The model has a function without a formula, or too many terms.
    """
    try:
        writer = _FormulaWriter(model.library, model.coefficients)
    except RecursionError as error:
        raise ValueError(
            f"the model has too many terms of {len(model.library)}; remove some: raise the threshold"
        ) from error
    lines = tuple((name, text) for name, _, text in (line.partition(" = ") for line in writer.lines))
    written = [*(text for _, text in lines), *writer.results]
    calls = Counter(name for text in written for name in _CALL.findall(text))
    return Formulas(lines, tuple(writer.results), calls, sum(len(_OPERATOR.findall(text)) for text in written))


class _FormulaWriter(FieldWriter):
    """Write sums with infix operators, and numbers where they are used."""

    def __init__(self, library: Library, coefficients: Tensor) -> None:
        self._n_x = library.signature.n_x
        super().__init__(library, coefficients)

    def _variable(self, place: int) -> str:
        return f"x[{place}]" if place < self._n_x else f"u[{place - self._n_x}]"

    def _constant(self, value: float) -> str:
        return number(value)

    def _call(self, name: str, args: list[str]) -> str:
        if not (formula := function(name).formula):
            raise ValueError(
                f"the model uses the function '{name}', which has no formula; give one: "
                f"register_function('{name}', ..., formula='1 / (1 + square({{0}}))')"
            )
        return formula.format(*args)

    def _zero(self) -> str:
        return "0.0"

    def _plus_product(self, total: str, a: str, b: str) -> str:
        return f"{total} + {a} * {b}"

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        sign = "-" if c < 0 else "+"
        return f"{total} {sign} {number(abs(c))} * {value}" if abs(c) != 1 else f"{total} {sign} {value}"
