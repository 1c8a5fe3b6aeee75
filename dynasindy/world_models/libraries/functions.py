"""Elementary functions that libraries are made of: values, slopes, and how other languages write them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Function:
    """Describe an elementary function.

    Attributes:
        name: name in tables and files, e.g. `sin`.
        compute: torch function, elementwise in every argument.
        text: format string of its value, e.g. `sin({0})`; `{0}` are its variables, `{1}` its number, and from `{2}` on
            the variables one by one.
        latex: format string for LaTeX.
        atomic: whether its LaTeX needs no brackets before a power.
        slope: its derivative, where it is known; found by automatic differentiation where not.
        parametric: whether the number of a factor is the last argument, and not what the others are multiplied by.
        by_number: derivative of a parametric function by its number, where it is known.
        formula: format string of its value in operators, numbers and `FORMULA_FUNCTIONS`, which other languages than
            torch are written from; empty where there is none.
        slopes: derivatives by each variable of a function of several, where they are known.
    """

    name: str
    compute: Callable[..., Tensor]
    text: str
    latex: str
    atomic: bool = True
    slope: Callable[..., Tensor] | None = None
    parametric: bool = False
    by_number: Callable[..., Tensor] | None = None
    formula: str = ""
    slopes: tuple[Callable[..., Tensor], ...] = ()


FORMULA_FUNCTIONS = ("sin", "cos", "exp", "tanh", "sqrt", "fabs", "sign", "square", "larger")
"""What a formula may call: functions of C's <math.h>, and the sign, the square, and the larger one of two."""
SMALLEST_ROOT = 1e-3
"""Number below which `sqrt` is that of this one, so that its slope stays finite at zero and roots of less are none."""

_REGISTRY: dict[str, Function] = {
    f.name: f
    for f in (
        Function("id", lambda z: z, "{0}", "{0}", formula="{0}"),
        Function("sin", torch.sin, "sin({0})", r"\sin {0}", slope=torch.cos, formula="sin({0})"),
        Function("cos", torch.cos, "cos({0})", r"\cos {0}", slope=lambda z: -torch.sin(z), formula="cos({0})"),
        Function("abs", torch.abs, "|{0}|", r"|{0}|", slope=torch.sign, formula="fabs({0})"),
        Function(
            "sign", torch.sign, "sign({0})", r"\operatorname{{sign}} {0}", slope=torch.zeros_like, formula="sign({0})"
        ),
        Function("exp", torch.exp, "exp({0})", r"e^{{{0}}}", atomic=False, slope=torch.exp, formula="exp({0})"),
        Function(
            "tanh",
            torch.tanh,
            "tanh({0})",
            r"\tanh {0}",
            slope=lambda z: 1 - torch.tanh(z).square(),
            formula="tanh({0})",
        ),
        Function(
            "sqrt",
            lambda z: z.clamp_min(SMALLEST_ROOT).sqrt(),
            "sqrt({0})",
            r"\sqrt{{{0}}}",
            formula=f"sqrt(larger({{0}}, {SMALLEST_ROOT!r}))",
        ),
        Function(
            "bell",
            lambda z: (-z * z).exp(),
            "exp(-({0})^2)",
            r"e^{{-({0})^2}}",
            atomic=False,
            formula="exp(-square({0}))",
        ),
        Function(
            "root",
            lambda z, p: (z - p).clamp_min(SMALLEST_ROOT).sqrt(),
            "sqrt({0} - {1})",
            r"\sqrt{{{0} - {1}}}",
            slope=lambda z, p: 0.5 * (z - p > SMALLEST_ROOT).to(z.dtype) / (z - p).clamp_min(SMALLEST_ROOT).sqrt(),
            parametric=True,
            by_number=lambda z, p: -0.5 * (z - p > SMALLEST_ROOT).to(z.dtype) / (z - p).clamp_min(SMALLEST_ROOT).sqrt(),
            formula=f"sqrt(larger({{0}} - {{1}}, {SMALLEST_ROOT!r}))",
        ),
        Function(
            "hinge",
            lambda z, p: (z - p).clamp_min(0),
            "max(0, {0} - {1})",
            r"\max(0, {0} - {1})",
            slope=lambda z, p: (z > p).to(z.dtype),
            parametric=True,
            by_number=lambda z, p: -(z > p).to(z.dtype),
            formula="larger({0} - {1}, 0)",
        ),
        Function(
            "per_cos2",
            lambda z, p: 1 / (1 + p * z.cos().square()),
            "/(1 + {1} cos({0})^2)",
            r"\frac{{1}}{{1 + {1} \cos^2 {0}}}",
            atomic=False,
            slope=lambda z, p: p * (2 * z).sin() / (1 + p * z.cos().square()).square(),
            parametric=True,
            by_number=lambda z, p: -(z.cos() / (1 + p * z.cos().square())).square(),
            formula="1 / (1 + {1} * square(cos({0})))",
        ),
        Function("ahead", lambda a, b: a - b, "({2} - {3})", "({2} - {3})", formula="{0} - {1}"),
        Function(
            "slack",
            lambda a, b, p: a - b - (a - b).clamp(-p, p),
            "slack({0}; {1})",
            r"\operatorname{{slack}}_{{{1}}}({0})",
            parametric=True,
            by_number=lambda a, b, p: (b - a > p).to(a.dtype) - (a - b > p).to(a.dtype),
            formula="larger({0} - {1} - {2}, 0) - larger({1} - {0} - {2}, 0)",
        ),
    )
}


def _turned(plain: Function, name: str, sign: int) -> Function:
    """Return a function of the sum or the difference of two angles, written as one of their sum or difference."""
    word = "+" if sign > 0 else "-"
    slope, by_number, compute = plain.slope, plain.by_number, plain.compute
    assert slope is not None  # of the functions below
    return Function(
        f"{plain.name}_{name}",
        lambda a, b, *p: compute(a + sign * b, *p),
        plain.text.replace("{0}", f"{{2}} {word} {{3}}"),
        plain.latex.replace("{0}", f"({{2}} {word} {{3}})"),
        plain.atomic,
        parametric=plain.parametric,
        by_number=by_number and (lambda a, b, p: by_number(a + sign * b, p)),
        # The number of a parametric function comes after its variables.
        formula=plain.formula.replace("{1}", "{2}").replace("{0}", f"{{0}} {word} {{1}}"),
        slopes=(
            lambda a, b, *p: slope(a + sign * b, *p),
            lambda a, b, *p: sign * slope(a + sign * b, *p),
        ),
    )


for _plain in ("sin", "cos", "per_cos2"):
    for _name, _sign in (("sum", 1), ("gap", -1)):
        _made = _turned(_REGISTRY[_plain], _name, _sign)
        _REGISTRY[_made.name] = _made

QUOTIENTS = ("per_cos2", "per_cos2_sum", "per_cos2_gap")
"""Functions that are written as a division."""
_BUILT_IN = frozenset(_REGISTRY)


def is_registered(name: str) -> bool:
    """Return whether there is a function of that name."""
    return name in _REGISTRY


def unregister_function(name: str) -> None:
    """Forget a function, unless it comes with the package."""
    if name not in _BUILT_IN:
        _REGISTRY.pop(name, None)


def register_function(
    name: str, compute: Callable[..., Tensor], latex: str | None = None, formula: str = ""
) -> Function:
    """Make a torch function available to libraries, saved models and printed equations under a name.

    Args:
        name: a Python identifier; registering a name again replaces it.
        compute: torch function, elementwise in each argument, differentiable by autograd.
        latex: format string, `{0}` standing for the first argument; by default the name in roman type.
        formula: format string in operators and `FORMULA_FUNCTIONS`, e.g. `1 / (1 + square({0}))`, with which the
            model can be exported to C and other languages.

    Raises:
        ValueError: the name is not an identifier, or the formula calls another function.
    """
    if not name.isidentifier():
        raise ValueError(f"register_function got the name {name!r}; allowed is a Python identifier: rename it")
    default = r"\operatorname{{" + name.replace("_", r"\_") + r"}}({0})"
    if other := sorted(set(re.findall(r"[A-Za-z_]\w*", re.sub(r"\d[\w.]*", "", formula))) - {*FORMULA_FUNCTIONS}):
        raise ValueError(
            f"register_function got a formula with {other[0]!r}; allowed are {{0}}, operators, numbers and "
            f"{', '.join(FORMULA_FUNCTIONS)}: write it with these, or leave it out"
        )
    _REGISTRY[name] = Function(name, compute, name + "({0})", latex or default, formula=formula)
    return _REGISTRY[name]


def function(name: str) -> Function:
    """Look up an elementary function.

    Raises:
        ValueError: no function has that name.
    """
    if name not in _REGISTRY:
        raise ValueError(
            f"function {name!r} is not known; allowed are {', '.join(sorted(_REGISTRY))}: write one of your own into "
            f'plant.functions, such as {{{name}: "{{0}} / (1 + fabs({{0}}))"}}, or call register_function in Python '
            "before building or loading"
        )
    return _REGISTRY[name]
