"""A sparse model as machine code: coefficients are arguments, so a refit that keeps its functions compiles nothing."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.systems.machine import Machine, Program
from dynasindy.world_models.libraries.features import Feature
from dynasindy.world_models.libraries.functions import function
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.writers.infix import InfixWriter


def machine(library: Library, coefficients: Tensor, dtype: torch.dtype = torch.float32) -> Machine:
    """Return the sparse model dx/dt = Xi' Theta(x, u), compiled.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.
        dtype: precision, see `Machine`.

    Raises:
        ValueError: a function has no formula, the model has too many terms, or the compiler refuses the text.
        FileNotFoundError: there is no compiler.
    """
    values = coefficients.flatten().tolist()
    kinds = tuple(value if value in (0.0, 1.0) else None for value in values)
    # A name may be registered anew, for another function.
    names = {factor.function for feature in library.features for factor in feature.factors}
    formulas = tuple((name, function(name).formula) for name in sorted(names))
    written = _written(library.signature, library.features, formulas, kinds)
    constants = (number if place is None else values[place] for place, number in written.constants)
    n_x, n_u = library.signature.n_x, library.signature.n_u
    program = Program(n_x, n_u, written.lines, written.results, tuple(constants), library.step)
    return Machine(program, dtype)


class _Written(NamedTuple):
    """Formulas of all models that have the same functions in their equations.

    Attributes:
        lines: see `Program`.
        results: see `Program`.
        constants: of each constant its place among the coefficients, or None and the number itself.
    """

    lines: tuple[tuple[str, str], ...]
    results: tuple[str, ...]
    constants: tuple[tuple[int | None, float], ...]


@lru_cache(maxsize=128)
def _written(
    signature: Signature,
    features: tuple[Feature, ...],
    formulas: tuple[tuple[str, str | None], ...],
    kinds: tuple[float | None, ...],
) -> _Written:
    """Write models of some features, of whose coefficients those are told that are zero or one.

    Args:
        signature: names of states and inputs.
        features: candidate functions.
        formulas: those of their elementary functions, by name.
        kinds: zero, one, or None for another number, of each coefficient, feature by feature.
    """
    # Every coefficient is written as a number of its own, by which its constant is found again.
    first = 2.0 + math.ceil(max((abs(f.frequency) for feature in features for f in feature.factors), default=0.0))
    told = [first + place if kind is None else kind for place, kind in enumerate(kinds)]
    places = {number: place for place, number in enumerate(told) if kinds[place] is None}
    table = torch.tensor(told, dtype=torch.float64).reshape(len(features), signature.n_x)
    writer = _MachineWriter.of(Library(signature, features), table)
    constants = tuple((places.get(number), number) for number in writer.constants)
    return _Written(writer.named, tuple(writer.results), constants)


class _MachineWriter(InfixWriter):
    """Leave numbers as elements of `k`."""

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        return f"{total} + {self._constant(c)} * {value}"
