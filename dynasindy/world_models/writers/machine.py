"""A sparse model as machine code: coefficients are arguments, so a refit that keeps its functions compiles nothing."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.machine import Machine, Program
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
    writer = _MachineWriter.of(library, coefficients)
    n_x, n_u = library.signature.n_x, library.signature.n_u
    return Machine(Program(n_x, n_u, writer.named, tuple(writer.results), tuple(writer.constants), library.step), dtype)


class _MachineWriter(InfixWriter):
    """Leave numbers as elements of `k`."""

    def _plus_scaled(self, total: str, value: str, c: float) -> str:
        return f"{total} + {self._constant(c)} * {value}"
