"""Derivatives of formulas: values and slopes in one graph, from which C text and instructions are made.

Formulas are in operators, numbers and `FORMULA_FUNCTIONS`, as `dynasindy.sindy.codegen` writes them. Every value
carries the derivatives that are not zero, by the variables that it depends on (forward mode). They call one function
more: `exceeds(a, b)` is 1 where a > b, else 0.
"""

from __future__ import annotations

import ast
import math
import re
import threading
from collections.abc import Callable, Iterable, Mapping

Slopes = dict[int, int]
"""Place of each derivative that is not zero, by the number of the variable."""

FORMULA_FUNCTIONS = ("sin", "cos", "exp", "tanh", "sqrt", "fabs", "sign", "square", "larger")
"""What a formula may call: functions of C's <math.h>, and the sign, the square, and the larger one of two."""
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
OPERATIONS = (*_OPERATORS.values(), "neg", *FORMULA_FUNCTIONS, "exceeds")
"""What values are computed by, operators first, in the order of `c/interpreter.c`."""
_SLOPE: dict[str, Callable[[Callable[..., int], int], int]] = {
    "sin": lambda node, a: node("cos", a),
    "cos": lambda node, a: node("neg", node("sin", a)),
    "exp": lambda node, a: node("exp", a),
    "tanh": lambda node, a: node("-", node("1.0"), node("square", node("tanh", a))),
    "sqrt": lambda node, a: node("/", node("0.5"), node("sqrt", a)),
    "fabs": lambda node, a: node("sign", a),
    "square": lambda node, a: node("*", node("2.0"), a),
}
_ARGUMENTS = {**dict.fromkeys(_SLOPE, 1), "sign": 1, "larger": 2, "exceeds": 2}
_CONSTANT = re.compile(r"k\[\d+\]")


class ExpressionGraph:
    """Values of formulas and their derivatives, each of them once.

    Args:
        variables: number of each variable, by its text, e.g. `{"x[0]": 0, "u[0]": 1}`; None of one by which nothing is
            differentiated.
        lines: name and formula of values that others have by their names.
        results: formulas of what is wanted.

    Attributes:
        nodes: operation and operands of each value, which stand before it; the text of a variable, a constant or a
            number, which has no operands.
        results: places of the results.
        entries: row, variable and place of each derivative of a result that is not zero.

    Raises:
        ValueError: A formula holds something else than operators, numbers, what has a name, constants and functions.
    """

    def __init__(
        self, variables: Mapping[str, int | None], lines: Iterable[tuple[str, str]], results: Iterable[str]
    ) -> None:
        self.nodes: list[tuple[str, tuple[int, ...]]] = []
        self._places: dict[tuple[str, tuple[int, ...]], int] = {}
        self._one, self._named = self.node("1.0"), {text: self.node(text) for text in variables}
        given = zip(self._named.values(), variables.values(), strict=True)
        self._slopes: dict[int, Slopes] = {k: {} if number is None else {number: self._one} for k, number in given}
        for name, formula in lines:
            self._named[name] = self._value(parsed(formula))
        self.results = [self._value(parsed(formula)) for formula in results]
        rows = (sorted(self._slopes[place].items()) for place in self.results)
        self.entries = [(row, *entry) for row, entries in enumerate(rows) for entry in entries]

    def node(self, operation: str, *operands: int) -> int:
        """Return the place of what an operation gives."""
        place = self._places.setdefault((operation, operands), len(self.nodes))
        if place == len(self.nodes):
            self.nodes.append((operation, operands))
        return place

    def _value(self, tree: ast.expr) -> int:
        """Return the place of the value of a formula, once its slopes are there, too."""
        text, operands = ast.unparse(tree), list[ast.expr]()
        match tree:
            case _ if text in self._named:
                return self._named[text]
            case ast.Constant(number) if type(number) in (int, float) and math.isfinite(float(text)):
                operation = repr(float(text))
            case ast.UnaryOp(ast.USub(), operand):
                operation, operands = "neg", [operand]
            case ast.BinOp(left, operator, right) if type(operator) in _OPERATORS:
                operation, operands = _OPERATORS[type(operator)], [left, right]
            case ast.Call(ast.Name(operation), operands) if len(operands) == _ARGUMENTS.get(operation):
                pass
            case _ if _CONSTANT.fullmatch(text):
                operation = text
            case _:
                raise ValueError(f"{text[:60]!r} is no part of a formula")
        place = self.node(operation, *(places := [self._value(operand) for operand in operands]))
        if place not in self._slopes:
            self._slopes[place] = self._differentiate(place, operation, places)
        return place

    def needed(self, places: Iterable[int]) -> list[int]:
        """Return the places of values and of all that they are made of, in the order in which they can be computed."""
        found, left = set[int](), [*places]
        while left:
            if (place := left.pop()) not in found:
                found.add(place)
                left += self.nodes[place][1]
        return sorted(found)

    def _differentiate(self, place: int, operation: str, operands: list[int]) -> Slopes:
        node, inner = self.node, [self._slopes[operand] for operand in operands]
        if not any(inner):
            return {}
        match operation, operands:
            case "neg", _:
                return {n: node("neg", slope) for n, slope in inner[0].items()}
            case "+", _:
                return self._added(*inner)
            case "-", _:
                return self._added(inner[0], {n: node("neg", slope) for n, slope in inner[1].items()})
            case "*", (a, b):
                return self._added(self._scaled(a, b), self._scaled(b, a))
            case "/", (a, b):
                shrunk = {n: node("/", node("*", node("neg", place), slope), b) for n, slope in inner[1].items()}
                return self._added({n: node("/", slope, b) for n, slope in inner[0].items()}, shrunk)
            case "larger", (a, b):
                first = node("exceeds", a, b)
                return self._added(self._scaled(a, first), self._scaled(b, node("-", self._one, first)))
            case _, (a,) if operation in _SLOPE:
                return self._scaled(a, _SLOPE[operation](node, a))
        return {}

    def _scaled(self, place: int, factor: int) -> Slopes:
        slopes = self._slopes[place].items()
        return {n: factor if slope == self._one else self.node("*", slope, factor) for n, slope in slopes}

    def _added(self, first: Slopes, second: Slopes) -> Slopes:
        return {**first, **second} | {n: self.node("+", first[n], second[n]) for n in first.keys() & second}


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
