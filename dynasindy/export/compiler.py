"""A controller in C, compiled by this computer's compiler, called and timed from Python."""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynasindy.export.c_controller import ControllerSources
from dynasindy.systems.compiler import SUFFIX, build


class Native:
    """A controller in C that this computer has compiled, called as the one in Python.

    Args:
        sources: The controller.

    Raises:
        FileNotFoundError: There is no compiler.
        ValueError: The compiler refuses the sources.
    """

    def __init__(self, sources: ControllerSources) -> None:
        # A folder of its own each time: a library that is loaded must not be overwritten.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
            folder = Path(place)
            size = f"unsigned long size(void);\nunsigned long size(void) {{ return sizeof({sources.name}_state); }}\n"
            texts = {**sources.files(), "size.c": f'#include "{sources.name}.h"\n{size}'}
            for name, text in texts.items():
                (folder / name).write_text(text, encoding="utf-8")
            units = [folder / f"{sources.name}.c", folder / "size.c"]
            loaded = ctypes.CDLL(str(build(units, folder / f"{sources.name}{SUFFIX}")))
        self.shape = sources.shape
        self._reset, self._act = (getattr(loaded, f"{sources.name}_{name}") for name in ("reset", "act"))
        numbers = ctypes.POINTER(ctypes.c_double)
        self._reset.argtypes, self._reset.restype = [ctypes.c_void_p], None
        self._act.argtypes, self._act.restype = [ctypes.c_void_p, *[numbers] * 4], ctypes.c_int
        loaded.size.restype = ctypes.c_ulong
        self.state = ctypes.create_string_buffer(loaded.size())
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        self._reset(self.state)

    def act(self, y: Sequence[float], r: Sequence[float], rate: Sequence[float] | None = None) -> NDArray[np.float64]:
        """Return the inputs of the control period that begins now, `(n_u,)`.

        Args:
            y: What was measured now, NaN where nothing was.
            r: Where the outputs are to be.
            rate: How fast the reference moves; 0 if omitted.

        Raises:
            ValueError: There are more or fewer numbers than there have to be, or one is not finite.
        """
        n_x, n_u, n_r = self.shape
        u = np.empty(n_u)
        slope = None if rate is None else _numbers(rate, n_r)
        if self._act(self.state, _numbers(y, n_x), _numbers(r, n_r), slope, _pointer(u)):
            raise ValueError("a measurement, a reference or an input is not finite; give finite numbers")
        return u


def microseconds(sources: ControllerSources) -> float:
    """Return the time that a call of a controller takes on this computer, the best of five [us].

    Raises:
        FileNotFoundError: There is no compiler.
        ValueError: The compiler refuses the sources.
    """
    many = (
        f'#include "{sources.name}.h"\n\nstatic {sources.name}_state state;\n\n'
        "void many(const double *y, double *u, int n);\n\nvoid many(const double *y, double *u, int n)\n{\n"
        f"    while (n--)\n        {sources.name}_act(&state, y, y, y, u);\n}}\n"
    )
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
        for name, text in {**sources.files(), "many.c": many}.items():
            (Path(place) / name).write_text(text, encoding="utf-8")
        units = [Path(place) / f"{sources.name}.c", Path(place) / "many.c"]
        call = ctypes.CDLL(str(build(units, Path(place) / f"many{SUFFIX}"))).many
    # One array serves as measurements, references and rates. Zeros would end in numbers too small to be added fast.
    n = max(sources.shape)
    rest = (ctypes.c_double * n)(*[0.1] * n)
    u, calls, best = (ctypes.c_double * sources.shape[1])(), 1, 0.0
    while best < 0.02:
        calls *= 4
        best = min(_timed(call, rest, u, ctypes.c_int(calls)) for _ in range(5))
    return 1e6 * best / calls


def _timed(call: Callable[..., object], *arguments: object) -> float:
    start = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - start


def _numbers(values: Sequence[float], count: int) -> object:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (count,):
        raise ValueError(f"{array.size} numbers are given where {count} belong")
    return _pointer(array)


def _pointer(values: NDArray[np.float64]) -> object:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
