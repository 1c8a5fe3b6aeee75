"""A sparse model as machine code: coefficients are arguments, so a refit that keeps its functions compiles nothing."""

from __future__ import annotations

from torch import Tensor

from dynasindy.systems.machine import Machine, Program
from dynasindy.world_models.fast_field import FieldWriter
from dynasindy.world_models.functions import function
from dynasindy.world_models.library import Library


def machine(library: Library, coefficients: Tensor) -> Machine:
    """Return the sparse model dx/dt = Xi' Theta(x, u), compiled in single precision.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.

    Raises:
        ValueError: a function has no formula, the model has too many terms, or the compiler refuses the text.
        FileNotFoundError: there is no compiler.
    """
    try:
        writer = _MachineWriter(library, coefficients)
    except RecursionError as error:
        raise ValueError(f"the model has too many terms of {len(library)}; remove some") from error
    lines = tuple((name, formula) for name, _, formula in (line.partition(" = ") for line in writer.lines))
    signature = library.signature
    return Machine(Program(signature.n_x, signature.n_u, lines, tuple(writer.results), tuple(writer.constants)))


class _MachineWriter(FieldWriter):
    """Write sums with infix operators, numbers as elements of `k`."""

    def __init__(self, library: Library, coefficients: Tensor) -> None:
        self._n_x = library.signature.n_x
        super().__init__(library, coefficients)

    def _variable(self, place: int) -> str:
        return f"x[{place}]" if place < self._n_x else f"u[{place - self._n_x}]"

    def _call(self, name: str, args: list[str]) -> str:
        if not (formula := function(name).formula):
            raise ValueError(f"the function '{name}' has no formula; register it with one to have it compiled")
        return formula.format(*args)

    def _zero(self) -> str:
        return "0"

    def _plus_product(self, total: str, a: str, b: str) -> str:
        return f"{total} + {a} * {b}"

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        return f"{total} + {self._constant(c)} * {value}"
