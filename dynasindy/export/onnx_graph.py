"""Formulas as an ONNX graph: what is computed with its values becomes nodes, in double precision unless told otherwise.

A value has the operators of a NumPy array, so that the field of a model, which reads any numbers, writes itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynasindy.safe_io import write_bytes

OPSET, FORMAT = 17, 8
"""Versions of the operators and of the file, which runtimes since 2022 read."""


class Graph:
    """Nodes and constants so far.

    Raises:
        ModuleNotFoundError: onnx is not installed.
    """

    def __init__(self) -> None:
        try:
            from onnx import helper, numpy_helper
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "ONNX needs the package onnx, which is not installed; install it by pip install 'dynasindy[export]'"
            ) from error
        self.helper, self.numpy_helper = helper, numpy_helper
        self.nodes: list[Any] = []
        self.ends: dict[str, list[Any]] = {"in": [], "out": []}
        self._constants: dict[tuple[str, tuple[int, ...], bytes], Any] = {}

    def constant(self, values: ArrayLike, dtype: Any = np.float64) -> Value:
        """Return numbers as a value; the same ones are kept once."""
        array = np.ascontiguousarray(np.asarray(values, dtype=dtype))
        array = array.reshape(np.shape(values))
        key = array.dtype.str, array.shape, array.tobytes()
        if key not in self._constants:
            self._constants[key] = self.numpy_helper.from_array(array, f"c{len(self._constants)}")
        return Value(self, self._constants[key].name)

    def put(self, operator: str, *given: Value | ArrayLike, name: str = "", **attributes: Any) -> Value:
        """Add a node of ONNX's operators and return its value; numbers become constants in double precision."""
        values = [value if isinstance(value, Value) else self.constant(value) for value in given]
        name = name or f"v{len(self.nodes)}"
        self.nodes.append(self.helper.make_node(operator, [value.name for value in values], [name], **attributes))
        return Value(self, name)

    def places(self, *numbers: int) -> Value:
        """Return whole numbers, as places and shapes are given."""
        return self.constant(list(numbers), np.int64)

    def given(self, name: str, shape: Sequence[int | str], dtype: Any = np.float64) -> Value:
        """Add an input of the graph."""
        self._end("in", name, shape, dtype)
        return Value(self, name)

    def result(self, value: Value, name: str, shape: Sequence[int | str], dtype: Any = np.float64) -> None:
        """Add an output of the graph."""
        self._end("out", name, shape, dtype)
        self.put("Identity", value, name=name)

    def stack(self, values: Sequence[Value], axis: int = 0) -> Value:
        """Return values of one shape side by side along a new axis."""
        return self.put("Concat", *(self.put("Unsqueeze", value, self.places(axis)) for value in values), axis=axis)

    def save(self, path: Path, title: str, told: Mapping[str, str]) -> None:
        """Write the graph with what is told of it."""
        graph = self.helper.make_graph(
            self.nodes, title, self.ends["in"], self.ends["out"], [*self._constants.values()]
        )
        model = self.helper.make_model(graph, opset_imports=[self.helper.make_opsetid("", OPSET)], ir_version=FORMAT)
        self.helper.set_model_props(model, dict(told))
        write_bytes(path, model.SerializeToString())

    def _end(self, where: str, name: str, shape: Sequence[int | str], dtype: Any) -> None:
        kind = self.helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        self.ends[where].append(self.helper.make_tensor_value_info(name, kind, list(shape)))


class Value:
    """A tensor of the graph, of double precision unless it was cast.

    Args:
        graph: Where it stands.
        name: Its name there.
    """

    __array_ufunc__ = None  # NumPy leaves operators with arrays to this class

    def __init__(self, graph: Graph, name: str) -> None:
        self.graph, self.name = graph, name

    def __add__(self, other: Value | ArrayLike) -> Value:
        return self.graph.put("Add", self, other)

    def __radd__(self, other: ArrayLike) -> Value:
        return self.graph.put("Add", other, self)

    def __sub__(self, other: Value | ArrayLike) -> Value:
        return self.graph.put("Sub", self, other)

    def __rsub__(self, other: ArrayLike) -> Value:
        return self.graph.put("Sub", other, self)

    def __mul__(self, other: Value | ArrayLike) -> Value:
        return self.graph.put("Mul", self, other)

    def __rmul__(self, other: ArrayLike) -> Value:
        return self.graph.put("Mul", other, self)

    def __truediv__(self, other: Value | ArrayLike) -> Value:
        return self.graph.put("Div", self, other)

    def __rtruediv__(self, other: ArrayLike) -> Value:
        return self.graph.put("Div", other, self)

    def __neg__(self) -> Value:
        return self.graph.put("Neg", self)

    def __matmul__(self, other: Value | ArrayLike) -> Value:
        return self.graph.put("MatMul", self, other)

    def __getitem__(self, places: int | slice) -> Value:
        """Return one place, without its axis, or a range of places of the first axis."""
        if isinstance(places, slice):
            first, last = (self.graph.places(int(end)) for end in (places.start or 0, places.stop))
            return self.graph.put("Slice", self, first, last)
        return self.graph.put("Gather", self, self.graph.constant(places, np.int64), axis=0)

    @property
    def transposed(self) -> Value:
        """Its rows as columns; to be multiplied by matrices.

        Multiplied by a vector it would be right as a graph, but onnxruntime 1.31 loses the transposition then.
        """
        return self.graph.put("Transpose", self, perm=[1, 0])

    def reshape(self, *shape: int) -> Value:
        """Return the same numbers in another shape."""
        return self.graph.put("Reshape", self, self.graph.places(*shape))

    def total(self) -> Value:
        """Return the sum of all its numbers, a scalar."""
        return self.graph.put("ReduceSum", self, keepdims=0)

    def where(self, true: Value, other: Value | ArrayLike) -> Value:
        """Return itself where a value is true, and another elsewhere."""
        return self.graph.put("Where", true, self, other)

    def finite(self) -> Value:
        """Return which numbers are finite: those that leave nothing over times zero."""
        return self.graph.put("Not", self.graph.put("IsNaN", self * 0.0))


def functions(graph: Graph) -> dict[str, Any]:
    """Return what formulas call, of values of a graph."""
    calls = {"sin": "Sin", "cos": "Cos", "exp": "Exp", "tanh": "Tanh", "sqrt": "Sqrt", "fabs": "Abs", "sign": "Sign"}

    def _of(operator: str) -> Any:
        return lambda value: graph.put(operator, value)

    return {
        **{name: _of(operator) for name, operator in calls.items()},
        "square": lambda value: value * value,
        "larger": lambda a, b: graph.put("Max", a, b),
    }
