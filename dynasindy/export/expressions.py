"""The equations of a sparse model as plain formulas, which C, NumPy and CasADi read alike.

They are written by the very code that writes them for torch, `dynasindy.sindy.codegen`: what several
terms share is computed once. Operators are infix, and what is called are `functions.FORMULA_FUNCTIONS` alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from torch import Tensor

from dynasindy.export.c_text import number
from dynasindy.sindy import SindyModel
from dynasindy.sindy.codegen import InfixWriter
from dynasindy.sindy.equations import mapping
from dynasindy.sindy.functions import FORMULA_FUNCTIONS
from dynasindy.sindy.library import Library

_CALL = re.compile(rf"\b({'|'.join(FORMULA_FUNCTIONS)})\(")


@dataclass(frozen=True)
class Formulas:
    """A vector field dx/dt = f(x, u) in formulas of `x[0]`, `u[0]`, ...

    Attributes:
        lines: Name and formula of each value, in the order in which they are computed.
        results: Formula of dx/dt of each state.
        calls: Which of `FORMULA_FUNCTIONS` are called.
    """

    lines: tuple[tuple[str, str], ...]
    results: tuple[str, ...]
    calls: frozenset[str]

    def reads(self, variable: str) -> bool:
        """Whether `x` or `u` occurs."""
        return any(f"{variable}[" in formula for formula in (*self.results, *(text for _, text in self.lines)))


def formulas(model: SindyModel) -> Formulas:
    """Return the rates of change of a model as formulas.

    Raises:
        ValueError: The model has a function without a formula, or too many terms.
    """
    return _written(model.library, model.coefficients)


def right_sides(model: SindyModel) -> Formulas:
    """Return the right sides of the equations as formulas: rates of change, or of a difference equation next states.

    Raises:
        ValueError: The model has a function without a formula, or too many terms.
    """
    return _written(*mapping(model.library, model.coefficients))


def _written(library: Library, coefficients: Tensor) -> Formulas:
    writer = _FormulaWriter.of(library, coefficients)
    lines = writer.named
    written = [*(text for _, text in lines), *writer.results]
    calls = frozenset(name for text in written for name in _CALL.findall(text))
    return Formulas(lines, tuple(writer.results), calls)


class _FormulaWriter(InfixWriter):
    """Write numbers where they are used."""

    def _constant(self, value: float) -> str:
        return number(value)

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        sign = "-" if c < 0 else "+"
        return f"{total} {sign} {number(abs(c))} * {value}" if abs(c) != 1 else f"{total} {sign} {value}"
