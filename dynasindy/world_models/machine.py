"""A sparse model as machine code: control periods and their derivatives, in single precision on the CPU.

Imagined rollouts of a hundred rows are made of small operations, each of which costs torch more than its arithmetic.
The equations are known in closed form, so they are written in C, with their derivatives, and compiled by the system's
compiler where there is one. Coefficients are arguments: a refit that keeps its functions needs no compiler.
"""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path

import torch
from torch import Tensor

from dynasindy.systems.stops import Stops
from dynasindy.world_models.compiler import SUFFIX, build_fast, compiler
from dynasindy.world_models.fast_field import FieldWriter
from dynasindy.world_models.functions import function
from dynasindy.world_models.library import Library
from dynasindy.world_models.tangents import Tangents

IN_C = {
    "sin": "sine",
    "cos": "cosine",
    "exp": "power_of_e",
    "tanh": "hyperbolic_tangent",
    "sqrt": "sqrtf",
    "fabs": "magnitude",
}
"""Names in `c/period.c` of what formulas call by other names."""
FREE = Stops((), (), (), ())
_CALLED = re.compile(rf"\b({'|'.join(IN_C)})\(")
_STATE = re.compile(r"\b([xu])\[(\d+)\]")
_FRACTION = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+)")


class Machine:
    """A sparse model, compiled.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.

    Raises:
        ValueError: a function has no formula, the model has too many terms, or the compiler refuses the text.
        FileNotFoundError: there is no compiler.
    """

    def __init__(self, library: Library, coefficients: Tensor) -> None:
        try:
            writer = _MachineWriter(library, coefficients)
        except RecursionError as error:
            raise ValueError(f"the model has too many terms of {len(library)}; remove some") from error
        self.n_x, self.n_u = library.signature.n_x, library.signature.n_u
        self._constants = _real(writer.constants)
        self._code = _compiled(_source(writer, self.n_x, self.n_u))

    def integrate(
        self, x: Tensor, u: Tensor, dt: float, substeps: int, stops: Stops | None = None
    ) -> tuple[Tensor, Tensor]:
        """Advance states over one control period under held inputs, see `systems.integrate`.

        Args:
            x: states, `(*batch, n_x)` float32.
            u: inputs, `(*batch, n_u)` float32.
            dt: control period [s].
            substeps: Runge-Kutta steps per period.
            stops: mechanical stops, if any.

        Returns:
            The state after each sub-step, `(*batch, substeps, n_x)`, and whether a stop was touched, bool `(*batch,)`.
        """
        x, u, stops = x.contiguous(), u.contiguous(), stops or FREE
        samples = x.new_empty(*x.shape[:-1], substeps, self.n_x)
        touched = torch.empty(x.shape[:-1], dtype=torch.bool)
        ends = _whole(stops.positions), _whole(stops.rates), _real(stops.low), _real(stops.high)
        rows, h, n_stops = ctypes.c_long(touched.numel()), ctypes.c_float(dt / substeps), len(stops.positions)
        into = _data(samples, touched)
        self._code.advance(rows, *_data(x, u), self._constants, h, substeps, n_stops, *ends, *into)
        return samples, touched

    def sensitivities(self, x: Tensor, u: Tensor, dt: float, substeps: int) -> tuple[Tensor, Tensor]:
        """Return dx_next/dx, `(*batch, n_x, n_x)`, and dx_next/du, `(*batch, n_x, n_u)`, of a period without stops.

        Args:
            x: states, `(*batch, n_x)` float32.
            u: inputs, `(*batch, n_u)` float32.
            dt: control period [s].
            substeps: Runge-Kutta steps per period.
        """
        x, u = x.contiguous(), u.contiguous()
        a, b = x.new_empty(*x.shape, self.n_x), x.new_empty(*x.shape, self.n_u)
        rows, h = ctypes.c_long(x.numel() // self.n_x), ctypes.c_float(dt / substeps)
        self._code.sensitivities(rows, *_data(x, u), self._constants, h, substeps, *_data(a, b))
        return a, b


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


def _source(writer: _MachineWriter, n_x: int, n_u: int) -> str:
    """Return the C text of a model, its numbers left out."""
    names = [f"x[{i}]" for i in range(n_x)] + [f"u[{j}]" for j in range(n_u)]
    tangents = Tangents({name: number for number, name in enumerate(names)})
    lines = [(name, formula) for name, _, formula in (line.partition(" = ") for line in writer.lines)]
    for name, formula in lines:
        tangents.line(name, formula)
    found = [tangents.slopes(result) for result in writer.results]
    entries = [(i, column, text) for i, row in enumerate(found) for column, text in sorted(row.items())]
    rates = [f"f[{i} * W + r] = {text};" for i, text in enumerate(writer.results)]
    slopes = [f"j[{p} * W + r] = {text};" for p, (_, _, text) in enumerate(entries)]
    words = {
        "n_x": n_x,
        "n_u": n_u,
        "n_slopes": len(entries),
        "rates": _body(lines, rates),
        "slopes": _body(tangents.lines, [*rates, *slopes]),
        "slope_rows": ", ".join(str(i) for i, _, _ in entries),
        "slope_columns": ", ".join(str(column) for _, column, _ in entries),
    }
    text = resources.files("dynasindy.world_models").joinpath("c", "period.c").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda gap: str(words[gap[1]]), text)


def _body(lines: Sequence[tuple[str, str]], results: Sequence[str]) -> str:
    """Return values and results as statements of C."""
    statements = [*(f"const real {name} = {formula};" for name, formula in lines), *results]
    return "\n".join(f"        {_in_c(statement)}" for statement in statements)


def _in_c(text: str) -> str:
    text = _CALLED.sub(lambda call: f"{IN_C[call[1]]}(", text)
    return _FRACTION.sub(r"(real)\1", _STATE.sub(r"\1[\2 * W + r]", text))


@cache
def _folder(process: int) -> Path:
    """Return a folder that is gone when the process ends; a forked one has its own."""
    path = Path(tempfile.mkdtemp(prefix="dynasindy_"))

    def _remove() -> None:
        if os.getpid() == process:
            shutil.rmtree(path, ignore_errors=True)

    atexit.register(_remove)
    return path


@cache
def _compiled(source: str) -> ctypes.CDLL:
    """Return the compiled text; the same text is compiled once."""
    if compiler() is None:
        raise FileNotFoundError("no C compiler was found; install gcc or clang, or do without machine code")
    stem = _folder(os.getpid()) / hashlib.sha256(source.encode()).hexdigest()[:16]
    text = stem.with_suffix(".c")
    text.write_text(source, encoding="utf-8")
    return ctypes.CDLL(str(build_fast(text, stem.with_suffix(SUFFIX))))


def _whole(values: Sequence[int]) -> object:
    return (ctypes.c_int * max(1, len(values)))(*values)


def _real(values: Sequence[float]) -> object:
    return (ctypes.c_float * max(1, len(values)))(*values)


def _data(*tensors: Tensor) -> list[ctypes.c_void_p]:
    return [ctypes.c_void_p(tensor.data_ptr()) for tensor in tensors]
