"""Derivatives of formulas: from straight-line code of values to straight-line code of values and slopes.

Formulas are in operators, numbers and `FORMULA_FUNCTIONS`, as `dynasindy.sindy.codegen` writes them. Every value
carries the derivatives that are not zero, by the variables that it depends on (forward mode). They call one function
more: `exceeds(a, b)` is 1 where a > b, else 0.
"""

from __future__ import annotations

import ast
import math
import re
import threading
from collections.abc import Mapping, Sequence

Slopes = dict[int, str]
"""Text of each derivative that is not zero, by the number of the variable."""

FORMULA_FUNCTIONS = ("sin", "cos", "exp", "tanh", "sqrt", "fabs", "sign", "square", "larger")
"""What a formula may call: functions of C's <math.h>, and the sign, the square, and the larger one of two."""
_SLOPE = {
    "sin": "cos({0})",
    "cos": "-sin({0})",
    "exp": "exp({0})",
    "tanh": "(1 - square(tanh({0})))",
    "sqrt": "(0.5 / sqrt({0}))",
    "fabs": "sign({0})",
    "square": "(2 * {0})",
}
_ARGUMENTS = {**dict.fromkeys(_SLOPE, 1), "sign": 1, "larger": 2, "exceeds": 2}
_CONSTANT = re.compile(r"k\[\d+\]")
_NAME = re.compile(r"[a-z]\w*", re.ASCII)


class Tangents:
    """Differentiate formulas line by line.

    Args:
        variables: number of each variable, by its text, e.g. `{"x[0]": 0, "u[0]": 1}`.
        others: texts of those by which nothing is differentiated.

    Attributes:
        lines: name and formula of every value and slope, in the order in which they are computed.
    """

    def __init__(self, variables: Mapping[str, int], others: Sequence[str] = ()) -> None:
        self.lines: list[tuple[str, str]] = []
        self._slopes: dict[str, Slopes] = {text: {number: "1"} for text, number in variables.items()}
        self._slopes |= {text: {} for text in others}

    def line(self, name: str, formula: str) -> None:
        """Add a value and its derivatives.

        Raises:
            ValueError: The name is none, or the formula holds something that does not belong there.
        """
        if not _NAME.fullmatch(name):
            raise ValueError(
                f"{name[:60]!r} is no name of a value; allowed are a small letter, letters, digits and '_'"
            )
        value, slopes = self._of(parsed(formula))
        self.lines.append((name, value))
        self._slopes[name] = {number: self._kept(f"{name}_{number}", text) for number, text in slopes.items()}

    def last(self, formula: str) -> tuple[str, Slopes]:
        """Return the text of a formula of what was added before, and those of its derivatives.

        Raises:
            ValueError: It holds something else than operators, numbers, what was added, constants and functions.
        """
        return self._of(parsed(formula))

    def _kept(self, name: str, text: str) -> str:
        """Give a text a name, unless it is one or a number."""
        if text.replace("_", "").isalnum():
            return text
        self.lines.append((name, text))
        return name

    def _of(self, node: ast.expr) -> tuple[str, Slopes]:
        """Return the text of a formula and those of its derivatives."""
        text = ast.unparse(node)
        if isinstance(node, ast.Constant) and type(node.value) in (int, float) and math.isfinite(float(text)):
            return repr(float(text)), {}  # a quotient of whole numbers is a whole number in C
        if text in self._slopes or _CONSTANT.fullmatch(text):
            return text, self._slopes.get(text, {})
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            value, slopes = self._of(node.operand)
            return f"(-{value})", {number: f"(-{slope})" for number, slope in slopes.items()}
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div):
            return self._pair(node.op, self._of(node.left), self._of(node.right))
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and len(node.args) == _ARGUMENTS.get(node.func.id)
        ):
            return self._call(node.func.id, [self._of(argument) for argument in node.args])
        raise ValueError(f"{text[:60]!r} is no part of a formula")

    def _pair(self, operator: ast.operator, left: tuple[str, Slopes], right: tuple[str, Slopes]) -> tuple[str, Slopes]:
        (a, da), (b, db) = left, right
        if isinstance(operator, ast.Add | ast.Sub):
            sign = "+" if isinstance(operator, ast.Add) else "-"
            slopes = {n: f"({da[n]} {sign} {db[n]})" if n in da and n in db else da.get(n, "") for n in {**da, **db}}
            slopes = {n: text or (db[n] if sign == "+" else f"(-{db[n]})") for n, text in slopes.items()}
            return f"({a} {sign} {b})", slopes
        if isinstance(operator, ast.Mult):
            parts = [_scaled(da, b), _scaled(db, a)]
            return f"({a} * {b})", _added(parts)
        value = f"({a} / {b})"
        shrunk = {n: f"(-{value} * {slope} / {b})" for n, slope in db.items()}
        return value, _added([{n: f"({slope} / {b})" for n, slope in da.items()}, shrunk])

    def _call(self, name: str, arguments: Sequence[tuple[str, Slopes]]) -> tuple[str, Slopes]:
        text = f"{name}({', '.join(value for value, _ in arguments)})"
        if name in ("sign", "exceeds"):
            return text, {}
        if name == "larger":
            (a, da), (b, db) = arguments
            first = f"exceeds({a}, {b})"
            return text, _added([_scaled(da, first), _scaled(db, f"(1 - {first})")])
        ((argument, inner),) = arguments
        return text, _scaled(inner, _SLOPE[name].format(argument))


def _scaled(slopes: Slopes, factor: str) -> Slopes:
    return {number: factor if slope == "1" else f"({slope} * {factor})" for number, slope in slopes.items()}


def _added(parts: Sequence[Slopes]) -> Slopes:
    total: Slopes = {}
    for part in parts:
        for number, slope in part.items():
            total[number] = f"({total[number]} + {slope})" if number in total else slope
    return total


_ALONE = threading.Lock()


def parsed(formula: str) -> ast.expr:
    """Return the syntax tree of a formula.

    One thread parses at a time: CPython 3.11 counts the depth of trees for all threads together, and ends in a
    SystemError ("AST constructor recursion depth mismatch") where one begins while another is at it.

    Raises:
        SyntaxError: It is no expression of Python.
        ValueError: It holds characters that no source may hold.
    """
    with _ALONE:
        return ast.parse(formula, mode="eval").body
