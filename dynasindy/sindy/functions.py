"""Elementary functions that libraries are made of: values, and how other languages write them."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from dynasindy.safe_io import FileError
from dynasindy.systems.tangents import FORMULA_FUNCTIONS, parsed


@dataclass(frozen=True)
class Function:
    """Describe an elementary function.

    Attributes:
        name: name in tables and files, e.g. `sin`.
        compute: torch function, elementwise in every argument.
        text: format string of its value, e.g. `sin({0})`; `{0}` are its variables, `{1}` its number, and from `{2}` on
            the variables one by one.
        parametric: whether the number of a factor is the last argument, and not what the others are multiplied by.
        formula: format string of its value in operators, numbers and `FORMULA_FUNCTIONS`, which other languages than
            torch are written from; empty where there is none.
        given: formula of a function of a user's own as it was given, which files hold; empty where there is none.
    """

    name: str
    compute: Callable[..., Tensor]
    text: str
    parametric: bool = False
    formula: str = ""
    given: str = ""

    @property
    def n_variables(self) -> int | None:
        """Return how many variables a function of a user's formula takes; None where no formula tells."""
        return len(set(re.findall(r"\{\d\}", self.given))) or None


class FunctionError(FileError):
    """A function is needed that is not known here, or is another one here; what needs it is not damaged for that."""


SMALLEST_ROOT = 1e-3
"""Number below which `sqrt` is that of this one, so that its slope stays finite at zero and roots of less are none."""

_REGISTRY: dict[str, Function] = {
    f.name: f
    for f in (
        Function("id", lambda z: z, "{0}", formula="{0}"),
        Function("sin", torch.sin, "sin({0})", formula="sin({0})"),
        Function("cos", torch.cos, "cos({0})", formula="cos({0})"),
        Function("abs", torch.abs, "|{0}|", formula="fabs({0})"),
        Function("sign", torch.sign, "sign({0})", formula="sign({0})"),
        Function("exp", torch.exp, "exp({0})", formula="exp({0})"),
        Function("tanh", torch.tanh, "tanh({0})", formula="tanh({0})"),
        Function(
            "sqrt",
            lambda z: z.clamp_min(SMALLEST_ROOT).sqrt(),
            "sqrt({0})",
            formula=f"sqrt(larger({{0}}, {SMALLEST_ROOT!r}))",
        ),
        Function("bell", lambda z: (-z * z).exp(), "exp(-({0})^2)", formula="exp(-square({0}))"),
        Function(
            "root",
            lambda z, p: (z - p).clamp_min(SMALLEST_ROOT).sqrt(),
            "sqrt({0} - {1})",
            parametric=True,
            formula=f"sqrt(larger({{0}} - {{1}}, {SMALLEST_ROOT!r}))",
        ),
        Function(
            "hinge",
            lambda z, p: (z - p).clamp_min(0),
            "max(0, {0} - {1})",
            parametric=True,
            formula="larger({0} - {1}, 0)",
        ),
        Function(
            "per_cos2",
            lambda z, p: 1 / (1 + p * z.cos().square()),
            "/(1 + {1} cos({0})^2)",
            parametric=True,
            formula="1 / (1 + {1} * square(cos({0})))",
        ),
        Function("ahead", lambda a, b: a - b, "({2} - {3})", formula="{0} - {1}"),
        Function(
            "slack",
            lambda a, b, p: a - b - (a - b).clamp(-p, p),
            "slack({0}; {1})",
            parametric=True,
            formula="larger({0} - {1} - {2}, 0) - larger({1} - {0} - {2}, 0)",
        ),
    )
}


@lru_cache
def _turned(plain: Function, name: str, sign: int) -> Function:
    """Return a function of the sum or the difference of two variables, written as one of their sum or difference."""
    word = "+" if sign > 0 else "-"
    compute = plain.compute
    return Function(
        name,
        lambda a, b, *p: compute(a + sign * b, *p),
        plain.text.replace("{0}", f"{{2}} {word} {{3}}"),
        parametric=plain.parametric,
        # The number of a parametric function comes after its variables.
        formula=_in_brackets(plain.formula.replace("{1}", "{2}"), f"{{0}} {word} {{1}}"),
    )


def _in_brackets(form: str, two: str) -> str:
    """Return a format string with two variables in the place of the first, in one pair of brackets."""
    return form.replace("({0})", "{0}").replace("{0}", f"({two})")


for _plain in ("sin", "cos", "per_cos2"):
    for _name, _sign in (("sum", 1), ("gap", -1)):
        _made = _turned(_REGISTRY[_plain], f"{_plain}_{_name}", _sign)
        _REGISTRY[_made.name] = _made

QUOTIENTS = ("per_cos2", "per_cos2_sum", "per_cos2_gap")
"""Functions that are written as a division."""
_BUILT_IN = frozenset(_REGISTRY)


_SUFFIXES = {"__sum": 1, "__gap": -1}
"""Endings of functions of a sum or a difference that are made when they are asked for, and its sign."""
_EVERYWHERE = ("abs", "sign", "exp", "tanh", "bell")
"""Functions of the package of which a difference may be the argument, as they have a value at each number."""


def is_registered(name: str) -> bool:
    """Return whether there is a function of that name."""
    return name in _REGISTRY


def _of_one(name: str) -> str:
    """Return the name of the function of one variable that one of a sum or a difference is made of, or the name."""
    return name[:-5] if name not in _REGISTRY and name[-5:] in _SUFFIXES else name


def of_two(name: str, sign: str) -> str:
    """Return the name of the function that has the sum (sign `+`) or the difference of two variables for its argument.

    Raises:
        ValueError: the function is not known, or takes no sum and no difference.
    """
    ending = "sum" if sign == "+" else "gap"
    if f"{name}_{ending}" in _BUILT_IN:
        return f"{name}_{ending}"
    if function(name).n_variables not in (1, None) or (name in _BUILT_IN and name not in _EVERYWHERE):
        raise ValueError(
            f"function {name!r} takes no sum and no difference of two variables; those that do are sin, cos, "
            f"{', '.join(_EVERYWHERE)}, and each function of your own of one argument. For a root of either sign, "
            f"{_ways('flow', '{0} / sqrt(larger(fabs({0}), 0.001))')}; then flow(a {sign} b) is one of the library"
        )
    return f"{name}__{ending}"


def unregister_function(name: str) -> None:
    """Forget a function, unless it comes with the package."""
    if name not in _BUILT_IN:
        _REGISTRY.pop(name, None)


def register_function(name: str, compute: Callable[..., Tensor], formula: str = "") -> Function:
    """Make a torch function available to libraries, saved models and printed equations under a name.

    Args:
        name: a Python identifier; registering a name again replaces it.
        compute: torch function, elementwise in each argument, differentiable by autograd.
        formula: format string in operators and `FORMULA_FUNCTIONS`, e.g. `1 / (1 + square({0}))`, with `{1}` for a
            second argument. It is saved with a model, which then can be read where the function is not registered,
            and be exported to C and other languages. It has to say what `compute` does.

    Returns:
        The function, as libraries hold it.

    Raises:
        ValueError: the name is not an identifier, or the formula holds anything but arguments, numbers, + - * / and
            `FORMULA_FUNCTIONS`.
    """
    if not name.isidentifier():
        raise ValueError(f"register_function got the name {name!r}; allowed is a Python identifier: rename it")
    # What is given is not kept for other languages: its tree is written anew, from numbers and known names alone.
    written = _read(name, formula)[0] if formula else ""
    made = Function(name, compute, name + "({0})", formula=written, given=formula)
    _REGISTRY[name] = made
    return made


def function(name: str) -> Function:
    """Look up an elementary function.

    Raises:
        FunctionError: no function has that name.
    """
    if name in _REGISTRY:
        return _REGISTRY[name]
    if (plain := _of_one(name)) in _REGISTRY and (plain not in _BUILT_IN or plain in _EVERYWHERE):
        return _turned(_REGISTRY[plain], name, _SUFFIXES[name[-5:]])
    raise FunctionError(
        f"function {plain!r} is not known; allowed are {', '.join(sorted(_REGISTRY))}. If it is one of your own, "
        f"{_ways(plain, '{0} / (1 + fabs({0}))')}, or import the module that does, before a library is built or a "
        "model is read"
    )


def _ways(name: str, formula: str) -> str:
    """Say how a user registers a function, in the settings of a command and in Python."""
    return (
        f'write it into plant.functions, such as {{{name}: "{formula}"}}; in Python, call register_function({name!r}, '
        f"..., formula={formula!r})"
    )


LONGEST = 300
"""Characters of a formula."""
_OPERATORS: dict[type[ast.AST], tuple[str, Callable[..., Tensor]]] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv),
}
_CALLS: dict[str, Callable[..., Tensor]] = {
    **{name: getattr(torch, name) for name in FORMULA_FUNCTIONS if hasattr(torch, name)},
    "fabs": torch.abs,
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
    return register_function(name, _read(name, formula)[1], formula=formula)


def formula_texts(names: Iterable[str]) -> dict[str, str]:
    """Return the formulas that functions were registered with, by name; functions without one are left out."""
    found = {name: function(name).given for name in sorted(set(map(_of_one, names)))}
    return {name: formula for name, formula in found.items() if formula}


def _read(name: str, formula: object) -> tuple[str, Callable[..., Tensor]]:
    """Return a formula in brackets, floats and known names, which every language reads alike, and what computes it."""
    allowed = f"allowed are {{0}}, {{1}}, numbers, + - * /, brackets and {', '.join(FORMULA_FUNCTIONS)}"
    told = str(formula)[:60]
    if not isinstance(formula, str) or len(formula) > LONGEST:
        raise ValueError(f"function {name!r} has the formula {told!r}; {allowed}: mend it")
    try:
        written, compute = _translated(parsed(re.sub(r"\{(\d)\}", rf" {_ARGUMENT}\1 ", formula).strip()))
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        raise ValueError(f"function {name!r}: {told!r} cannot be read; {allowed}: mend it") from error
    except LookupError as error:
        wrong = ast.unparse(error.args[0])[:40]
        raise ValueError(f"function {name!r}: {told!r} holds {wrong!r}; {allowed}: mend it") from error
    places = {int(place) for place in re.findall(r"\{(\d)\}", written)}
    if lacking := sorted({*range(max(places, default=0) + 1)} - places):
        raise ValueError(
            f"function {name!r}: {told!r} has no {{{lacking[0]}}}, which stands for argument {lacking[0] + 1}; write "
            "it in"
        )
    return written, compute


def _translated(node: ast.expr) -> tuple[str, Callable[..., Tensor]]:
    """Return the text of a part of a formula, and what computes it; a `LookupError` holds a node that is none."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            (a, first), (b, second), (sign, both) = _translated(left), _translated(right), _OPERATORS[type(op)]
            return f"({a} {sign} {b})", lambda *z: both(first(*z), second(*z))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            a, value = _translated(operand)
            return f"(0.0 - {a})", lambda *z: -value(*z)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _CALLS:
            if len(args) == 1 + (name == "larger"):
                texts, values = zip(*map(_translated, args), strict=True)
                return f"{name}({', '.join(texts)})", lambda *z: _CALLS[name](*(value(*z) for value in values))
        case ast.Constant(value=number) if isinstance(number, int | float) and not isinstance(number, bool):
            if math.isfinite(size := float(number)):
                return repr(size), lambda z, *_: torch.full_like(z, size)
        case ast.Name(id=name) if re.fullmatch(rf"{_ARGUMENT}\d", name):
            place = int(name.removeprefix(_ARGUMENT))
            return f"{{{place}}}", lambda *z: z[place]
    raise LookupError(node)
