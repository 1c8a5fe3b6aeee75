"""Elementary functions that libraries are made of, as formulas that every language reads alike."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache

import torch
from torch import Tensor

from dynasindy.safe_io import FileError
from dynasindy.systems.tangents import FORMULA_FUNCTIONS, parsed

LONGEST = 1000
"""Characters of a formula, also with all brackets, as files hold it."""
_ARGUMENT = "argument_"
"""What stands for `{` and a digit while a formula is read."""
_SIGNS: dict[type[ast.AST], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}


def _called(compute: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Return a torch function that takes numbers, too."""
    return lambda *z: compute(*(v if torch.is_tensor(v) else torch.tensor(v, dtype=torch.float64) for v in z))


TORCH_FUNCTIONS = {name: _called(getattr(torch, name)) for name in FORMULA_FUNCTIONS if hasattr(torch, name)}
"""What formulas call, as torch computes it."""
TORCH_FUNCTIONS |= {"fabs": _called(torch.abs), "larger": _called(torch.maximum)}


@dataclass(frozen=True)
class Function:
    """Describe an elementary function.

    Attributes:
        name: name in tables and files, e.g. `sin`.
        formula: format string of its value in operators, numbers and `FORMULA_FUNCTIONS`, which torch code and other
            languages are written from.
        text: format string of how it is written, e.g. `sin({0})`; `{0}` are its variables, `{1}` its number, and from
            `{2}` on the variables one by one.
        parametric: whether the number of a factor is the last argument, and not what the others are multiplied by.
    """

    name: str
    formula: str
    text: str
    parametric: bool = False

    @property
    def n_variables(self) -> int:
        """Return how many variables it takes."""
        return len(set(re.findall(r"\{\d\}", self.formula))) - self.parametric

    @cached_property
    def compute(self) -> Callable[..., Tensor]:
        """Its values by torch, elementwise in every argument."""
        names = [f"z{k}" for k in range(self.n_variables + self.parametric)]
        # Formulas are our own, or written anew from the tree of one that was given, see `_read`.
        call: Callable[..., Tensor] = eval(f"lambda {', '.join(names)}: {self.formula.format(*names)}", TORCH_FUNCTIONS)
        return call

    def of_two(self, sign: str) -> str:
        """Return the name of the function that has the sum (sign `+`) or the difference of two variables as argument.

        Raises:
            ValueError: it takes no sum and no difference.
        """
        if self.n_variables != 1 or (self.name in _BUILT_IN and self.name not in _EVERYWHERE):
            raise ValueError(
                f"function {self.name!r} takes no sum and no difference of two variables; those that do are "
                f"{', '.join(_EVERYWHERE)}, and each function of your own of one argument. For a root of either sign, "
                f"{_ways('flow', '{0} / sqrt(larger(fabs({0}), 0.001))')}; then flow(a {sign} b) is one of the library"
            )
        return f"{self.name}_sum" if sign == "+" else f"{self.name}_gap"


class FunctionError(FileError):
    """A function is needed that is not known here, or is another one here; what needs it is not damaged for that."""


SMALLEST_ROOT = 1e-3
"""Number below which `sqrt` is that of this one, so that its slope stays finite at zero and roots of less are none."""

_REGISTRY: dict[str, Function] = {
    f.name: f
    for f in (
        Function("id", "{0}", "{0}"),
        *(Function(name, f"{name}({{0}})", f"{name}({{0}})") for name in ("sin", "cos", "sign", "exp", "tanh")),
        Function("abs", "fabs({0})", "|{0}|"),
        Function("sqrt", f"sqrt(larger({{0}}, {SMALLEST_ROOT!r}))", "sqrt({0})"),
        Function("bell", "exp(-square({0}))", "exp(-({0})^2)"),
        Function("root", f"sqrt(larger({{0}} - {{1}}, {SMALLEST_ROOT!r}))", "sqrt({0} - {1})", parametric=True),
        Function("hinge", "larger({0} - {1}, 0)", "max(0, {0} - {1})", parametric=True),
        Function("per_cos2", "1 / (1 + {1} * square(cos({0})))", "/(1 + {1} cos({0})^2)", parametric=True),
        Function("ahead", "{0} - {1}", "({2} - {3})"),
        Function(
            "slack", "larger({0} - {1} - {2}, 0) - larger({1} - {0} - {2}, 0)", "slack({0}; {1})", parametric=True
        ),
    )
}


@lru_cache
def _turned(plain: Function, name: str, sign: str) -> Function:
    """Return a function of the sum or the difference of two variables, written as one of their sum or difference."""
    both = plain.formula.replace("{1}", "{2}").replace("({0})", "{0}").replace("{0}", f"({{0}} {sign} {{1}})")
    return Function(name, both, plain.text.replace("{0}", f"{{2}} {sign} {{3}}"), plain.parametric)


QUOTIENTS = ("per_cos2", "per_cos2_sum", "per_cos2_gap")
"""Functions that are written as a division."""
_BUILT_IN = frozenset(_REGISTRY)
_SIGN_OF = {"_sum": "+", "_gap": "-"}
"""Endings of functions of a sum or a difference, which are made when they are asked for, and its sign."""
_EVERYWHERE = ("sin", "cos", "abs", "sign", "exp", "tanh", "bell", "per_cos2")
"""Functions of the package of which a difference may be the argument, as they have a value at each number."""


def _of_one(name: str) -> str:
    """Return the name of the function of one variable that one of a sum or a difference is made of, or the name."""
    return name[:-4].rstrip("_") if name not in _REGISTRY and name[-4:] in _SIGN_OF else name


@contextmanager
def registering(formulas: Mapping[str, str]) -> Iterator[None]:
    """Make functions of a file available, and forget them again where reading it fails within."""
    before = dict(_REGISTRY)
    try:
        for name, formula in formulas.items():
            register_function(name, formula)
        yield
    except BaseException:
        _REGISTRY.clear()
        _REGISTRY.update(before)
        raise


def register_function(name: str, formula: str) -> Function:
    """Make a function available to libraries, saved models, printed equations and exports under a name.

    A saved model holds the formulas of its functions, and is read where they are not registered.

    Args:
        name: a Python identifier, not that of another function.
        formula: a line of numbers, `{0}` for the argument, `{1}` for a second one, `+ - * /`, brackets and
            `FORMULA_FUNCTIONS`, e.g. `1 / (1 + square({0}))`. Where it is not finite, as `sqrt({0})` below zero, no
            model is: write `sqrt(larger({0}, 0.001))`.

    Returns:
        The function, as libraries hold it.

    Raises:
        FunctionError: the name is that of another function.
        ValueError: the name is no identifier, or the formula holds anything else.
    """
    if not name.isidentifier():
        raise ValueError(f"register_function got the name {name!r}; allowed is a Python identifier: rename it")
    # What is given is not kept for other languages: its tree is written anew, from numbers and known names alone.
    made = Function(name, _read(name, formula), name + "({0})")
    if _REGISTRY.get(name, made) != made:
        raise FunctionError(
            f"function {name!r} is another function here, {_REGISTRY[name].formula}; give yours another name"
        )
    return _REGISTRY.setdefault(name, made)


def function(name: str) -> Function:
    """Look up an elementary function.

    Raises:
        FunctionError: no function has that name.
    """
    if name in _REGISTRY:
        return _REGISTRY[name]
    if (plain := _of_one(name)) in _REGISTRY and (plain not in _BUILT_IN or plain in _EVERYWHERE):
        return _turned(_REGISTRY[plain], name, _SIGN_OF[name[-4:]])
    raise FunctionError(
        f"function {plain!r} is not known; allowed are {', '.join(sorted(_REGISTRY))}. If it is one of your own, "
        f"{_ways(plain, '{0} / (1 + fabs({0}))')}, or import the module that does, before a library is built or a "
        "model is read"
    )


def _ways(name: str, formula: str) -> str:
    """Say how a user registers a function, in the settings of a command and in Python."""
    return (
        f'write it into plant.functions, such as {{{name}: "{formula}"}}; in Python, call register_function({name!r}, '
        f"{formula!r})"
    )


def formula_texts(names: Iterable[str]) -> dict[str, str]:
    """Return the formulas of a user's own functions, by name; functions of the package are left out."""
    return {name: function(name).formula for name in sorted(set(map(_of_one, names)) - _BUILT_IN)}


def _read(name: str, formula: object) -> str:
    """Return a formula in brackets, floats and known names, which every language reads alike."""
    allowed = f"allowed are {{0}}, {{1}}, numbers, + - * /, brackets and {', '.join(FORMULA_FUNCTIONS)}"
    told = str(formula)[:60]
    if not isinstance(formula, str) or len(formula) > LONGEST:
        raise ValueError(f"function {name!r} has the formula {told!r}; {allowed}: mend it")
    try:
        written = _rewritten(parsed(re.sub(r"\{(\d)\}", rf" {_ARGUMENT}\1 ", formula).strip()))
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
    if len(written) > LONGEST:
        raise ValueError(f"function {name!r}: {told!r}... has {len(written)} characters with all brackets; shorten it")
    return written


def _rewritten(node: ast.expr) -> str:
    """Return the text of a part of a formula; a `LookupError` holds a node that is none."""
    match node:
        case ast.BinOp(left, op, right) if type(op) in _SIGNS:
            return f"({_rewritten(left)} {_SIGNS[type(op)]} {_rewritten(right)})"
        case ast.UnaryOp(ast.USub(), operand):
            return f"(0.0 - {_rewritten(operand)})"
        case ast.Call(ast.Name(name), args, []) if name in FORMULA_FUNCTIONS and len(args) == 1 + (name == "larger"):
            return f"{name}({', '.join(map(_rewritten, args))})"
        case ast.Constant(int() | float() as number) if type(number) is not bool and math.isfinite(float(number)):
            return repr(float(number))
        case ast.Name(name) if re.fullmatch(rf"{_ARGUMENT}\d", name):
            return f"{{{name.removeprefix(_ARGUMENT)}}}"
    raise LookupError(node)
