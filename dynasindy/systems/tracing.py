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
    given = iter([[f"{name}[{i}]" for i in range(n)] for name, n in (("x", n_x), ("u", n_u))])
    names, values = dict[str, str](), dict[torch.fx.Node, Any]()  # formulas by their names; columns, or lists of these

    def line(formula: str) -> str:
        return names.setdefault(formula, f"v{len(names)}")

    def text(value: object) -> str:
        if isinstance(value, str):
            return value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise TypeError(f"its code cannot be read: {value} is neither a state nor a number")
        return repr(float(value)) if value >= 0 else f"(-{-float(value)!r})"

    for node in nodes:
        name = str(node.target).split(".")[1] if node.op == "call_function" and "." in str(node.target) else node.op
        match name, torch.fx.node.map_arg(node.args, values.get):
            case "placeholder", _:
                found: Any = next(given)
            case "output", (found,) if isinstance(node.args[0], torch.fx.Node):
                pass
            case "unbind", (list() as found, (-1 | 1)):
                pass
            case ("call_function", (list() as row, int(i))) | ("select", (list() as row, (-1 | 1), int(i))):
                found = row[i]
            case "stack", (list() | tuple() as columns, (-1 | 1)):
                found = [*map(text, columns)]
            case "zeros_like", _:
                found = line("0.0")
            case "pow", (value, int() | float() as power) if power in range(1, HIGHEST + 1):
                found = one = text(value)
                for _ in range(int(power) - 1):
                    found = line(f"{found} * {one}")
            case _, (value, *_) if name in SAME:
                found = text(value)
            case _, args if name in PATTERNS and not node.kwargs:
                found = line(PATTERNS[name].format(*map(text, args)))
            case _:
                raise TypeError(f"its code cannot be read: {node.target}{node.args} is none of what can be")
        kind = node.meta.get("val")
        if isinstance(kind, torch.Tensor) and not kind.is_floating_point() and name not in COMPARISONS:
            raise TypeError(f"its code cannot be read: {node.target}{node.args} makes whole numbers or truth values")
        values[node] = found
    if not isinstance(found, list) or len(found) != n_x:
        raise TypeError("its code cannot be read: it has to return a stack of one rate of change per state")
    return Program(n_x, n_u, tuple((name, formula) for formula, name in names.items()), tuple(found))
