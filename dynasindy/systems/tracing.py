"""A plant's equations in formulas, read off a trace of what its own torch code does.

What can be read are the operators, `torch.sin`, `cos`, `exp`, `tanh`, `sqrt`, `abs`, `square` and `sign`,
`torch.zeros_like` of a column, comparisons turned into numbers by `to`, whole powers, `unbind` and `[..., i]` of states
and inputs, and a last `torch.stack`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from dynasindy.systems.machine import Program

COMPARISONS = ("gt", "lt", "ge", "le")
PATTERNS = {
    **{"add": "{} + {}", "sub": "{} - {}", "rsub": "{1} - {0}", "mul": "{} * {}", "div": "{} / {}", "neg": "-{}"},
    **{name: f"{name}({{}})" for name in ("sin", "cos", "exp", "tanh", "sqrt", "sign", "square")},
    **{"abs": "fabs({})", "reciprocal": "1.0 / {}", "gt": "exceeds({}, {})", "lt": "exceeds({1}, {0})"},
    **{"ge": "1 - exceeds({1}, {0})", "le": "1 - exceeds({0}, {1})"},
}
"""Operations of torch, with their formulas."""
SAME = ("_to_copy", "clone", "detach", "alias")
HIGHEST = 8
"""Highest power that is written as a product."""


def program(forward: Callable[[Any, Any], Any], n_x: int, n_u: int) -> Program:
    """Return the formulas of a vector field.

    Args:
        forward: `(x, u) -> dx`, elementwise but for the last dimension.
        n_x: number of states.
        n_u: number of inputs.

    Raises:
        TypeError: it does something that cannot be read.
    """
    from torch.fx.experimental.proxy_tensor import make_fx  # a second, where nothing else has asked for it

    rows = [torch.zeros(n_x + n_u + 3, n, dtype=torch.float64) for n in (n_x, n_u)]
    try:
        with torch.no_grad():
            nodes = make_fx(lambda x, u: forward(x, u))(*rows).graph.nodes
    except (AttributeError, IndexError, RuntimeError, TypeError, ValueError) as error:
        raise TypeError(f"its code cannot be read: {str(error).partition(chr(10))[0]}") from error
    page = _Page([[f"{name}[{i}]" for i in range(n)] for name, n in (("x", n_x), ("u", n_u))])
    *_, results = [page.read(node) for node in nodes]
    if not isinstance(results, list) or len(results) != n_x:
        raise TypeError("its code cannot be read: it has to return a stack of one rate of change per state")
    return Program(n_x, n_u, tuple((name, formula) for formula, name in page.names.items()), tuple(results))


class _Page:
    """Formulas by their names, each written once; a value is the text of a column, or a list of columns."""

    def __init__(self, given: list[list[str]]) -> None:
        self.given, self.names = iter(given), dict[str, str]()
        self.values: dict[torch.fx.Node, str | list[str]] = {}

    def read(self, node: torch.fx.Node) -> str | list[str]:
        """Return what an operation gives, and write its formula."""
        name = str(node.target).split(".")[1] if node.op == "call_function" and "." in str(node.target) else node.op
        match name, node.args:
            case "placeholder", _:
                found: str | list[str] = next(self.given)
            case "output", (torch.fx.Node() as last,):
                found = self.values[last]
            case "unbind", (torch.fx.Node() as row, (-1 | 1)):
                found = self.values[row]
            case ("call_function", (torch.fx.Node() as row, int(i))) | (
                "select", (torch.fx.Node() as row, (-1 | 1), int(i))
            ):  # fmt: skip
                found = self.values[row][i]
            case "stack", (columns, (-1 | 1)) if isinstance(columns, list | tuple):
                found = [self._text(column) for column in columns]
            case "zeros_like", _:
                found = self._line("0.0")
            case "pow", (value, int() | float() as power) if power in range(1, HIGHEST + 1):
                found = one = self._text(value)
                for _ in range(int(power) - 1):
                    found = self._line(f"{found} * {one}")
            case _ if name in SAME:
                found = self._text(node.args[0])
            case _ if name in PATTERNS and not node.kwargs:
                found = self._line(PATTERNS[name].format(*map(self._text, node.args)))
            case _:
                raise TypeError(f"its code cannot be read: {node.target}{node.args} is none of what can be")
        value = node.meta.get("val")
        if isinstance(value, torch.Tensor) and not value.is_floating_point() and name not in COMPARISONS:
            raise TypeError(f"its code cannot be read: {node.target}{node.args} makes whole numbers or truth values")
        self.values[node] = found
        return found

    def _line(self, formula: str) -> str:
        return self.names.setdefault(formula, f"v{len(self.names)}")

    def _text(self, value: object) -> str:
        """Return a column or a number as part of a formula."""
        found = self.values.get(value) if isinstance(value, torch.fx.Node) else None
        if isinstance(found, str):
            return found
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise TypeError(f"its code cannot be read: {value} is neither a state nor a number")
        return repr(float(value)) if value >= 0 else f"(-{-float(value)!r})"
