"""A plant's equations in formulas, read off its own torch code: it is run once, on symbols.

What can be read are the operators, `torch.sin`, `cos`, `exp`, `tanh`, `sqrt`, `abs` and `sign`, `torch.zeros_like` of a
column, comparisons turned into numbers by `to`, whole powers, `unbind` and `[..., i]` of states and inputs, and a last
`torch.stack`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

import torch

from dynasindy.systems.machine import Program

CALLED = {"sin": "sin", "cos": "cos", "exp": "exp", "tanh": "tanh", "sqrt": "sqrt", "abs": "fabs", "sign": "sign"}
"""Functions of torch, and methods of its tensors, with their names in formulas."""
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
    page = _Page()
    x, u = (_Row([_Symbol(page, f"{name}[{i}]") for i in range(n)]) for name, n in (("x", n_x), ("u", n_u)))
    try:
        result = forward(x, u)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise TypeError(f"its code cannot be read: {error}") from error
    if not isinstance(result, _Row) or len(result.columns) != n_x:
        raise TypeError("its code cannot be read: it has to return a stack of one rate of change per state")
    return Program(n_x, n_u, tuple(page.lines), tuple(page.text(column) for column in result.columns))


class _Page:
    """Lines of formulas; the same one is written once."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []
        self._names: dict[str, str] = {}

    def line(self, formula: str) -> _Symbol:
        """Write a formula and return what stands for it."""
        if formula not in self._names:
            self._names[formula] = f"v{len(self.lines)}"
            self.lines.append((self._names[formula], formula))
        return _Symbol(self, self._names[formula])

    def text(self, value: object) -> str:
        """Return a symbol or a number as part of a formula."""
        if isinstance(value, _Symbol):
            return value.name
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise TypeError(f"{type(value).__name__} is neither a state nor a number")
        return repr(float(value)) if value >= 0 else f"(-{-float(value)!r})"


_Operator = Callable[["_Symbol", object], "_Symbol"]


def _infix(sign: str) -> tuple[_Operator, _Operator]:
    """Return an operator with the symbol to its left, and that with the symbol to its right."""
    text = f"{{}} {sign} {{}}"
    return lambda self, other: self.formula(text, self, other), lambda self, other: self.formula(text, other, self)


class _Symbol:
    """Stand for one column of a tensor."""

    def __init__(self, page: _Page, name: str) -> None:
        self.page, self.name = page, name

    dtype = torch.float64

    def to(self, *_: object) -> Self:
        """Return a comparison as the number that it is here."""
        return self

    def square(self) -> _Symbol:
        """Return the square."""
        return self.formula("square({})", self)

    def formula(self, pattern: str, *values: object) -> _Symbol:
        """Write a formula of some values and return what stands for it."""
        return self.page.line(pattern.format(*map(self.page.text, values)))

    def __neg__(self) -> _Symbol:
        return self.formula("-{}", self)

    __add__, __radd__ = _infix("+")
    __sub__, __rsub__ = _infix("-")
    __mul__, __rmul__ = _infix("*")
    __truediv__, __rtruediv__ = _infix("/")

    def __pow__(self, power: object) -> _Symbol:
        if power not in range(1, HIGHEST + 1):
            raise TypeError(f"the power {power} is none of 1 to {HIGHEST}")
        assert isinstance(power, int | float)
        result = self
        for _ in range(int(power) - 1):
            result = result * self
        return result

    def __gt__(self, other: object) -> _Symbol:
        return self.formula("exceeds({}, {})", self, other)

    def __lt__(self, other: object) -> _Symbol:
        return self.formula("exceeds({}, {})", other, self)

    def __ge__(self, other: object) -> _Symbol:
        return self.formula("1 - exceeds({}, {})", other, self)

    def __le__(self, other: object) -> _Symbol:
        return self.formula("1 - exceeds({}, {})", self, other)

    def __bool__(self) -> bool:
        raise TypeError("it decides by a state; write a product with the comparison")

    def __getattr__(self, name: str) -> Callable[[], _Symbol]:
        if name not in CALLED:
            raise AttributeError(f"a column has no '{name}' here")
        return lambda: self.formula(f"{CALLED[name]}({{}})", self)

    @classmethod
    def __torch_function__(
        cls, func: Any, types: Sequence[type], args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Answer a call of torch's own functions."""
        name = getattr(func, "__name__", "")
        if name == "stack" and (args[1:] == (-1,) or (kwargs or {}) == {"dim": -1}):
            return _Row(list(args[0]))
        if name == "zeros_like" and len(args) == 1 and not kwargs:
            return args[0].page.line("0.0")
        if name == "square" and not kwargs:
            return args[0].square()
        if name in CALLED and len(args) == 1 and not kwargs:
            return getattr(args[0], name)()
        raise TypeError(f"torch.{name} is called")


class _Row:
    """Stand for a tensor by its columns."""

    dtype = torch.float64

    def __init__(self, columns: Sequence[_Symbol]) -> None:
        self.columns = tuple(columns)

    def unbind(self, dim: int) -> tuple[_Symbol, ...]:
        """Return the columns."""
        if dim != -1:
            raise TypeError(f"unbind({dim}) is not of the last dimension")
        return self.columns

    def __getitem__(self, place: object) -> _Symbol:
        match place:
            case (e, int(i)) if e is Ellipsis:
                return self.columns[i]
        raise TypeError(f"[{place}] is not one of its columns, [..., i]")
