"""Functions of a user's own from a line of text, as `1 / (1 + exp(-{0}))`: data, not code.

A formula is read by Python's parser and evaluated on tensors by a walk over its tree, in which nothing but numbers, the
arguments, operators and `FORMULA_FUNCTIONS` may stand. The same line is what C and other languages are written from.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import replace

import torch
from torch import Tensor

from dynasindy.systems.parsed import parsed
from dynasindy.world_models.libraries.functions import (
    FORMULA_FUNCTIONS,
    Function,
    FunctionError,
    function,
    is_registered,
    keep,
    of_one,
    register_function,
    unregister_function,
)

LONGEST = 300
"""Characters of a formula."""
_OPERATORS: dict[type[ast.AST], Callable[..., Tensor]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
}
_SIGNS: dict[type[ast.AST], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
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


_ARGUMENT = "argument_"
"""What stands for `{` and a digit while a formula is read."""


def register_formula(name: str, formula: str) -> Function:
    """Make a function of one argument or several available to libraries, saved models and exports, from its formula.

    Where a function of the same formula is registered, in Python or by this, it stays.

    Args:
        name: a Python identifier, not that of another function.
        formula: a line of numbers, `{0}` for the argument, `{1}` for a second one, `+ - * /`, brackets and
            `FORMULA_FUNCTIONS`; where it is not finite, as `sqrt({0})` below zero, no model is: write
            `sqrt(larger({0}, 0.001))`.

    Raises:
        FunctionError: the name is that of another function.
        ValueError: the name is no identifier, or the formula holds anything else.
    """
    if is_registered(name):
        if (known := function(name)).given == formula != "":
            return known
        told = known.given or "which is not of a formula"
        raise FunctionError(f"function {name!r} is another function here, {told}; give yours another name")
    tree = _read(name, formula)
    # What was given is not kept for other languages: its tree is written anew, from numbers and known names alone.
    return keep(replace(register_function(name, lambda *z: _value(tree, z), formula=_written(tree)), given=formula))


def texts(names: Iterable[str]) -> dict[str, str]:
    """Return the formulas that functions were registered with, by name.

    Other functions are left out, and so are those whose formula cannot be read again.
    """
    found = {name: function(name).given for name in sorted(set(map(of_one, names)))}
    return {name: formula for name, formula in found.items() if formula and _is_readable(name, formula)}


def forget(names: Iterable[str]) -> None:
    """Take back the registration of functions, of a file that turned out to be damaged."""
    for name in names:
        unregister_function(name)


def _is_readable(name: str, formula: str) -> bool:
    try:
        _read(name, formula)
    except ValueError:
        return False
    return True


def _places(formula: str) -> set[int]:
    """Return which arguments a formula has."""
    return set(map(int, re.findall(r"\{(\d)\}", formula)))


def _read(name: str, formula: object) -> ast.expr:
    """Return the tree of a formula, of which every node is allowed."""
    allowed = f"allowed are {{0}}, {{1}}, numbers, + - * /, brackets and {', '.join(FORMULA_FUNCTIONS)}"
    told = str(formula)[:60]
    if not isinstance(formula, str) or len(formula) > LONGEST:
        raise ValueError(f"function {name!r} has the formula {told!r}; {allowed}: mend it")
    try:
        tree = parsed(re.sub(r"\{(\d)\}", rf" {_ARGUMENT}\1 ", formula).strip())
        wrong = _wrong(tree)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        raise ValueError(f"function {name!r}: {told!r} cannot be read; {allowed}: mend it") from error
    if wrong is not None:
        raise ValueError(f"function {name!r}: {told!r} holds {ast.unparse(wrong)[:40]!r}; {allowed}: mend it")
    places = _places(_written(tree))
    if lacking := sorted({*range(max(places, default=0) + 1)} - places):
        raise ValueError(
            f"function {name!r}: {told!r} has no {{{lacking[0]}}}, which stands for argument {lacking[0] + 1}; write "
            "it in"
        )
    return tree


def _wrong(node: ast.expr) -> ast.expr | None:
    """Return the first node that is not allowed."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _wrong(left) or _wrong(right)
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            return _wrong(operand)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _CALLS:
            return next(filter(None, map(_wrong, args)), None) if len(args) == 1 + (name == "larger") else node
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            return None if math.isfinite(float(value)) else node
        case ast.Name(id=name) if re.fullmatch(rf"{_ARGUMENT}\d", name):
            return None
        case _:
            return node


def _written(node: ast.expr) -> str:
    """Return a node in brackets, floats and known names, which every language reads alike."""
    match node:
        case ast.BinOp(left=left, op=op, right=right):
            return f"({_written(left)} {_SIGNS[type(op)]} {_written(right)})"
        case ast.UnaryOp(operand=operand):
            return f"(0.0 - {_written(operand)})"
        case ast.Call(func=ast.Name(id=name), args=args):
            return f"{name}({', '.join(_written(arg) for arg in args)})"
        case ast.Constant(value=value):
            return repr(float(value))  # type: ignore[arg-type]
        case ast.Name(id=name):
            return f"{{{name.removeprefix(_ARGUMENT)}}}"
        case _:
            raise AssertionError  # `_wrong` has refused it


def _value(node: ast.expr, z: tuple[Tensor, ...]) -> Tensor:
    """Return the value of a node at the arguments, of their shape."""
    match node:
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, z), _value(right, z))
        case ast.UnaryOp(op=op, operand=operand):
            return _OPERATORS[type(op)](_value(operand, z))
        case ast.Call(func=ast.Name(id=name), args=args):
            return _CALLS[name](*(_value(arg, z) for arg in args))
        case ast.Constant(value=value):
            return torch.full_like(z[0], float(value))  # type: ignore[arg-type]
        case ast.Name(id=name):
            return z[int(name.removeprefix(_ARGUMENT))]
        case _:
            raise AssertionError  # `_wrong` has refused it
