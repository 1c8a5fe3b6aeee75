"""Functions of a user's own from a line of text, as `1 / (1 + exp(-{0}))`: data, not code.

A formula is read by Python's parser and evaluated on tensors by a walk over its tree, in which nothing but numbers, the
argument, operators and `FORMULA_FUNCTIONS` may stand. The same line is what C and other languages are written from.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.world_models.functions import FORMULA_FUNCTIONS, Function, is_built_in, register_function

LONGEST = 300
"""Characters of a formula."""
_OPERATORS: dict[type[ast.AST], Callable[..., Tensor]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
}
_CALLS: dict[str, Callable[..., Tensor]] = {
    "sin": torch.sin,
    "cos": torch.cos,
    "exp": torch.exp,
    "tanh": torch.tanh,
    "sqrt": torch.sqrt,
    "fabs": torch.abs,
    "sign": torch.sign,
    "square": torch.square,
    "larger": torch.maximum,
}


def register_formula(name: str, formula: str) -> Function:
    """Make a function of one argument available to libraries, saved models and exports, from its formula.

    Args:
        name: a Python identifier, not that of a function that comes with the package.
        formula: a line of numbers, `{0}` for the argument, `+ - * /`, brackets and `FORMULA_FUNCTIONS`; where it is not
            finite, as `sqrt({0})` below zero, no model is: write `sqrt(larger({0}, 0.001))`.

    Raises:
        ValueError: the name is taken or no identifier, or the formula holds anything else.
    """
    if is_built_in(name):
        raise ValueError(f"function {name!r} comes with dynasindy and stays as it is; give yours another name")
    tree = _read(name, formula)
    return register_function(name, lambda z: _value(tree, z), formula=f"({formula})")


def _read(name: str, formula: object) -> ast.expr:
    """Return the tree of a formula, of which every node is allowed."""
    allowed = f"allowed are {{0}}, numbers, + - * /, brackets and {', '.join(FORMULA_FUNCTIONS)}"
    if not isinstance(formula, str) or len(formula) > LONGEST or "z" in _without_calls(formula):
        raise ValueError(f"function {name!r} has the formula {str(formula)[:60]!r}; {allowed}: mend it")
    try:
        tree = ast.parse(formula.replace("{0}", " z ").strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(f"function {name!r}: {formula!r} cannot be read; {allowed}: mend it") from error
    wrong = next((node for node in ast.walk(tree) if not _allowed(node)), None)
    if wrong is not None:
        raise ValueError(f"function {name!r}: {formula!r} holds {ast.unparse(wrong)[:40]!r}; {allowed}: mend it")
    if not any(isinstance(node, ast.Name) and node.id == "z" for node in ast.walk(tree)):
        raise ValueError(f"function {name!r}: {formula!r} has no {{0}}, which stands for its argument; write it in")
    return tree


def _without_calls(formula: str) -> str:
    """Return a formula without the names of its functions, in which no `z` may stand but those put in later."""
    for call in FORMULA_FUNCTIONS:
        formula = formula.replace(call, "")
    return formula


def _allowed(node: ast.AST) -> bool:
    match node:
        case ast.BinOp(op=op) | ast.UnaryOp(op=op):
            return type(op) in _OPERATORS
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            return name in _CALLS and len(args) == (2 if name == "larger" else 1)
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        case ast.Name(id=name):
            return name == "z" or name in _CALLS
        case _:
            return isinstance(node, ast.operator | ast.unaryop | ast.expr_context)


def _value(node: ast.AST, z: Tensor) -> Tensor:
    """Return the value of a node at the argument, of its shape."""
    match node:
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, z), _value(right, z))
        case ast.UnaryOp(op=op, operand=operand):
            return _OPERATORS[type(op)](_value(operand, z))
        case ast.Call(func=ast.Name(id=name), args=args):
            return _CALLS[name](*(_value(arg, z) for arg in args))
        case ast.Constant(value=value):
            return torch.full_like(z, float(value))  # type: ignore[arg-type]
        case _:
            return z
