"""A sparse model in formulas of `x[0]`, `u[0]`, ... with infix operators, for other languages than torch."""

from __future__ import annotations

from typing import Self

from torch import Tensor

from dynasindy.world_models.libraries.functions import function
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.writers.fast_field import FieldWriter


class InfixWriter(FieldWriter):
    """Write sums with infix operators; what is called are `functions.FORMULA_FUNCTIONS` alone.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.

    Raises:
        ValueError: a function has no formula.
    """

    def __init__(self, library: Library, coefficients: Tensor) -> None:
        self._n_x = library.signature.n_x
        super().__init__(library, coefficients)

    @classmethod
    def of(cls, library: Library, coefficients: Tensor) -> Self:
        """Write a model.

        Args:
            library: candidate functions.
            coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.

        Raises:
            ValueError: a function has no formula, or the model has too many terms.
        """
        try:
            return cls(library, coefficients)
        except RecursionError as error:
            raise ValueError(
                f"the model has too many terms of {len(library)}; remove some: raise the threshold"
            ) from error

    @property
    def named(self) -> tuple[tuple[str, str], ...]:
        """Name and formula of each value, in the order in which they are computed."""
        return tuple((name, text) for name, _, text in (line.partition(" = ") for line in self.lines))

    def _variable(self, place: int) -> str:
        return f"x[{place}]" if place < self._n_x else f"u[{place - self._n_x}]"

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
