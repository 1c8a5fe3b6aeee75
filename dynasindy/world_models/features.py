"""Candidate functions as data: products of powers of elementary functions of states and inputs.

A feature that is data can be named, printed as LaTeX, saved, multiplied, differentiated and turned into code.

| name              | meaning                                         | example                         |
| ----------------- | ----------------------------------------------- | ------------------------------- |
| Function          | elementary function of one variable or more      | `sin`                           |
| Factor            | function of `frequency * variable`, to a power   | `cos(2 alpha_p)^3`              |
| shape             | a factor whose frequency is fitted with the rest | `tanh(~20 Omega_a)`             |
| Feature           | product of factors; `1` is the empty product      | `omega_a |omega_a| cos(alpha_p)` |
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Function:
    """Describe an elementary function.

    Attributes:
        name: name in tables and files, e.g. `sin`.
        compute: torch function, elementwise in every argument.
        text: format string of its value, e.g. `sin({0})`.
        latex: format string for LaTeX.
        atomic: whether its LaTeX needs no brackets before a power.
        slope: its derivative, where it is known; found by automatic differentiation where not.
        parametric: whether the number of a factor is the last argument, and not what the others are multiplied by.
        by_number: derivative of a parametric function by its number, where it is known.
        formula: format string of its value in operators, numbers and `FORMULA_FUNCTIONS`, which other languages than
            torch are written from; empty where there is none.
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


FORMULA_FUNCTIONS = ("sin", "cos", "exp", "tanh", "sqrt", "fabs", "sign", "square", "larger")
"""What a formula may call: functions of C's <math.h>, and the sign, the square, and the larger one of two."""
SMALLEST_ROOT = 1e-3
"""Number below which `sqrt` is that of this one, so that its slope stays finite at zero and roots of less are none."""
FARTHEST = 30.0
"""Factor between the first guess of a number inside a function and what is fitted, either way."""
LARGEST_POWER = 100
"""Power beyond which a function of a file or of words is taken for a mistake."""

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
            f"function {name!r} is not known; allowed are {', '.join(sorted(_REGISTRY))}: "
            "call register_function for your own before building or loading"
        )
    return _REGISTRY[name]


@dataclass(frozen=True, order=True)
class Factor:
    """Raise `function(frequency * variables)`, or `function(variables, frequency)`, to a power.

    Attributes:
        variables: states and inputs.
        function: name of an elementary function.
        power: whole number.
        frequency: the number inside the function: a frequency, the inverse of a width, an offset.
        fitted: first guess of that number if it is fitted with the coefficients, 0 if it is given.
    """

    variables: tuple[str, ...]
    function: str = "id"
    power: int = 1
    frequency: float = 1.0
    fitted: float = 0.0

    def with_number(self, number: float) -> Factor:
        """Return the factor with another number inside, not farther from its first guess than `FARTHEST` allows.

        A number that is not finite, of a step that led nowhere, changes nothing.
        """
        if not math.isfinite(number):
            return self
        low, high = sorted((self.fitted / FARTHEST, self.fitted * FARTHEST))
        return replace(self, frequency=min(max(number, low), high))

    def compute(self) -> Callable[..., Tensor]:
        """Return the function of the variables alone, its power left out."""
        known = function(self.function)
        if known.parametric:
            return lambda *args: known.compute(*args, self.frequency)
        if self.frequency == 1:
            return known.compute
        return lambda *args: known.compute(*(self.frequency * a for a in args))

    def slope(self, *args: Tensor) -> Tensor:
        """Return the derivative of the function of some variables by the number inside it."""
        known = function(self.function)
        if known.parametric and known.by_number is not None:
            return known.by_number(*args, self.frequency)
        if not known.parametric and known.slope is not None and len(args) == 1:
            return args[0] * known.slope(self.frequency * args[0])
        p = torch.full_like(args[0], self.frequency)
        inside = (
            known.compute if known.parametric else lambda *given: known.compute(*(given[-1] * a for a in given[:-1]))
        )
        derivative: Tensor = torch.func.jvp(lambda q: inside(*args, q), (p,), (torch.ones_like(p),))[1]
        return derivative

    @property
    def base(self) -> Factor:
        """Return the same factor to the power of one."""
        return replace(self, power=1)

    def text(self, latex: bool = False) -> str:
        """Write the factor as a reader would."""
        known = function(self.function)
        form = known.latex if latex else known.text
        number = f"{self.frequency:g}"
        scale = "" if self.frequency == 1 or known.parametric else f"{number} "
        names = [scale + (latex_name(v) if latex else v) for v in self.variables]
        written = form.format(", ".join(names), number)
        if self.power == 1:
            return written
        if latex and self.function in ("sin", "cos", "tanh", "sign"):
            return form.replace(" {0}", f"^{{{{{self.power}}}}} {{0}}").format(", ".join(names), number)
        if latex and not known.atomic:
            written = rf"\left({written}\right)"
        return f"{written}^{{{self.power}}}" if latex else f"{written}^{self.power}"


@dataclass(frozen=True)
class Feature:
    """Multiply factors; no factor is the constant 1."""

    factors: tuple[Factor, ...] = ()

    @classmethod
    def of(cls, factors: Iterable[Factor]) -> Feature:
        """Multiply factors, joining powers of the same function of the same variable."""
        powers: dict[Factor, int] = {}
        for factor in factors:
            powers[factor.base] = powers.get(factor.base, 0) + factor.power
        return cls(tuple(replace(base, power=p) for base, p in powers.items() if p))

    def __mul__(self, other: Feature) -> Feature:
        """Multiply two features."""
        return Feature.of(self.factors + other.factors)

    @property
    def key(self) -> frozenset[Factor]:
        """Return what makes two features the same function, whatever the order of factors."""
        return frozenset(self.factors)

    @property
    def variables(self) -> set[str]:
        """Collect the states and inputs it reads."""
        return {v for factor in self.factors for v in factor.variables}

    def name(self) -> str:
        """Write the feature in the names of states and inputs, e.g. `Omega_a^2 sin(alpha_p)`."""
        return " ".join(f.text() for f in self.factors) or "1"

    def latex(self) -> str:
        """Write the feature as LaTeX."""
        return r" \, ".join(f.text(latex=True) for f in self.factors) or "1"

    def to_list(self) -> list[list]:
        """Return plain lists for JSON."""
        return [
            [list(f.variables), f.function, f.power, f.frequency, *([f.fitted] if f.fitted else [])]
            for f in self.factors
        ]

    @classmethod
    def from_list(cls, data: list[list]) -> Feature:
        """Read what `to_list` wrote.

        Raises:
            ValueError: a function is not known (user functions are registered before loading).
            ValueError: a power is not whole or larger than `LARGEST_POWER`, or a frequency is not finite.
        """
        return cls(
            tuple(
                _checked(Factor(tuple(v), function(f).name, p, float(w), *map(float, fit))) for v, f, p, w, *fit in data
            )
        )


def _checked(factor: Factor) -> Factor:
    """Return a factor from a file or from words if its numbers are those of a function."""
    if type(factor.power) is not int or abs(factor.power) > LARGEST_POWER:
        shown = str(factor.power)[:20] if abs(factor.power) < 10**20 else "a number of more than 20 digits"
        raise ValueError(f"a function has the power {shown}; allowed are whole ones up to {LARGEST_POWER}: correct it")
    if not (math.isfinite(factor.frequency) and math.isfinite(factor.fitted)):
        raise ValueError(f"a function has the frequency {factor.frequency}; allowed are finite ones: correct it")
    if factor.function == "id" and len(factor.variables) != 1:
        raise ValueError(f"a product has a factor of {len(factor.variables)} variables; allowed is one: correct it")
    return factor


def variable(name: str, power: int = 1) -> Feature:
    """Return a power of a state or an input as a feature."""
    return Feature((Factor((name,), "id", power),))


def of(function_name: str, *variables: str, power: int = 1, frequency: float = 1.0, fitted: bool = False) -> Feature:
    """Return a function of states or inputs as a feature, e.g. `of("sin", "alpha_p")`."""
    guess = frequency if fitted else 0.0
    return Feature((Factor(variables, function(function_name).name, power, frequency, guess),))


_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TOKEN = re.compile(
    rf"\s*(?:\|(?P<abs>[^|]+)\||/\(1 \+ (?P<per>{_NUMBER}) cos\((?P<angle>[^()]+)\)\^2\)|"
    rf"max\(0, (?P<over>[^()]+) - (?P<edge>{_NUMBER})\)|sqrt\((?P<under>[^()]+) - (?P<start>{_NUMBER})\)|"
    r"exp\(-\((?P<bell>[^()]+)\)\^2\)|(?P<function>[A-Za-z_]\w*)\((?P<args>[^()]*)\)|(?P<name>[A-Za-z_]\w*)|(?P<one>1))"
    r"(?:\^(?P<power>\d+))?\s*\*?"
)
_ARGUMENT = re.compile(rf"\s*(?:(?P<fitted>~?)(?P<number>{_NUMBER})[ *]+)?(?P<name>[A-Za-z_]\w*)\s*")


def parse(text: str) -> Feature:
    """Read a feature from its name, e.g. `omega_a |omega_a|`, `Omega_a^2 sin(2 alpha_p)`, `1`.

    Raises:
        ValueError: the text is no product of states, inputs and known functions, or a power is too large.
    """
    factors, place = [], 0
    while place < len(text.rstrip()):
        token = _TOKEN.match(text, place)
        if token is None:
            raise ValueError(
                f"feature {text!r} cannot be read at {text[place:]!r}; allowed are products such as "
                "'Omega_a^2 sin(alpha_p)': separate factors by spaces"
            )
        place = token.end()
        power = int((token["power"] or "1")[:9])  # more digits than that are refused below, whatever they are
        if token["per"]:
            factors.append(Factor((token["angle"].strip(),), "per_cos2", power, float(token["per"])))
        elif token["edge"]:
            factors.append(Factor((token["over"].strip(),), "hinge", power, float(token["edge"])))
        elif token["start"]:
            factors.append(Factor((token["under"].strip(),), "root", power, float(token["start"])))
        elif token["bell"]:
            factors.append(_written("bell", token["bell"], power))
        elif token["abs"]:
            factors.append(_written("abs", token["abs"], power))
        elif token["function"]:
            factors.append(_written(token["function"], token["args"], power))
        elif token["name"]:
            factors.append(Factor((token["name"],), "id", power))
    return Feature.of(map(_checked, factors))


def _written(name: str, arguments: str, power: int) -> Factor:
    """Read the arguments of a function: `alpha_p`, `2 alpha_p`, or `~2 alpha_p` whose number is to be fitted.

    A number that multiplies no argument comes last: `a, b; 2` or `a, b; ~2`.
    """
    arguments, semicolon, last = arguments.partition(";")
    if semicolon:
        arguments = ",".join(f"{last.strip()} {argument}" for argument in arguments.split(","))
    read = [_ARGUMENT.fullmatch(argument) for argument in arguments.split(",")]
    found = [match for match in read if match is not None]
    numbers = {(bool(match["fitted"]), float(match["number"] or 1)) for match in found}
    if len(found) < len(read) or len(numbers) > 1 or (True, 0.0) in numbers:
        raise ValueError(
            f"{name}({arguments}) cannot be read; allowed are 'name', '2 name', or '~2 name' for a first guess that is "
            "not 0, the same number before each name: correct it"
        )
    fitted, number = numbers.pop()
    return Factor(tuple(m["name"] for m in found), function(name).name, power, number, number if fitted else 0.0)


_GREEK = ("alpha", "beta", "gamma", "delta", "theta", "phi", "psi", "omega", "Omega", "Theta", "Phi", "Psi")


def latex_name(name: str) -> str:
    r"""Write a state or input name as LaTeX, e.g. `Omega_a` as `\Omega_{a}`."""
    head, _, tail = name.partition("_")
    number = re.fullmatch(r"([A-Za-z]+?)(\d+)", head)
    if number and not tail:
        head, tail = number.groups()
    head = "\\" + head if head in _GREEK else (head if len(head) == 1 else rf"\mathrm{{{head}}}")
    # A second subscript within the first is an error of LaTeX.
    return f"{head}_{{{tail}}}".replace("_", r"\_").replace(r"\_{", "_{", 1) if tail else head


CONSTANT: Feature = Feature()
"""The function 1."""
