"""Candidate functions as data, the library Theta(x, u) of them, products of powers of functions, and its equations."""

from __future__ import annotations

import copy
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property, reduce
from itertools import islice

import torch
from torch import Tensor

from dynasindy.sentences import setting
from dynasindy.sindy.functions import QUOTIENTS, function
from dynasindy.systems.base import Diverged, Signature

FARTHEST = 30.0
"""Factor between the first guess of a number inside a function and what is fitted, either way."""
LARGEST_POWER = 100
"""Power beyond which a function of a file or of words is taken for a mistake."""
CANCELLED = 1e-9
"""Part of its own change that is left of a state, below which nothing is."""


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

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest number that a fit may put inside."""
        low, high = sorted((self.fitted / FARTHEST, self.fitted * FARTHEST))
        return low, high

    def with_number(self, number: float) -> Factor:
        """Return the factor with another number inside, within its `limits`.

        A number that is not finite, of a step that led nowhere, changes nothing.
        """
        low, high = self.limits
        return replace(self, frequency=min(max(number, low), high)) if math.isfinite(number) else self

    def of(self, columns: Mapping[str, Tensor], number: Tensor | float | None = None) -> Tensor:
        """Return its value, the power left out, at states and inputs by name; `number` stands for its own, if given."""
        known, inside = function(self.function), self.frequency if number is None else number
        args = [columns[name] for name in self.variables]
        if known.parametric:
            return known.compute(*args, inside)
        return known.compute(*(args if isinstance(inside, float) and inside == 1 else [inside * a for a in args]))

    @property
    def base(self) -> Factor:
        """Return the same factor to the power of one."""
        return self if self.power == 1 else replace(self, power=1)

    def text(self) -> str:
        """Write the factor as a reader would."""
        known, number = function(self.function), f"{self.frequency:g}"
        scale = "" if self.frequency == 1 or known.parametric else f"{number} "
        names = [scale + v for v in self.variables]
        written = known.text.format(", ".join(names), number, *names).replace("+ -", "- ").replace("- -", "+ ")
        return written if self.power == 1 else f"{written}^{self.power}"


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

    @property
    def complexity(self) -> float:
        """Return the sum of its powers; half a step more for one function that is not the identity, as a sine."""
        size = sum(abs(factor.power) for factor in self.factors)
        return size if size != 1 or self.factors[0].function == "id" else 1.5

    def renamed(self, names: Mapping[str, str]) -> Feature:
        """Return the same function of other states and inputs; those that are not named stay."""
        factors = (replace(f, variables=tuple(names.get(v, v) for v in f.variables)) for f in self.factors)
        return Feature(tuple(factors))

    def name(self) -> str:
        """Write the feature in the names of states and inputs, e.g. `Omega_a^2 sin(alpha_p)`."""
        return self._name

    @cached_property
    def _name(self) -> str:
        """The name, which a library asks for again whenever numbers inside its functions move."""
        return " ".join(f.text() for f in self.factors) or "1"

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
    known = function(factor.function)
    if len(factor.variables) != known.n_variables:
        raise ValueError(
            f"function {known.name!r} has {len(factor.variables)} arguments; its formula, {known.formula!r}, takes "
            f"{known.n_variables}: correct one of them"
        )
    return factor


def variable(name: str, power: int = 1) -> Feature:
    """Return a power of a state or an input as a feature."""
    return Feature((Factor((name,), "id", power),))


def of(function_name: str, *variables: str, power: int = 1, frequency: float = 1.0, fitted: bool = False) -> Feature:
    """Return a function of states or inputs as a feature, e.g. `of("sin", "alpha_p")`."""
    guess = frequency if fitted else 0.0
    return Feature((_checked(Factor(variables, function(function_name).name, power, frequency, guess)),))


_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NAME = r"[A-Za-z_]\w*"
_SPELLINGS = {
    r"exp\(-\(([^()]+)\)\^2\)": r" bell(\1)",
    r"/\(1 - (?=[\d.])": "/(1 + -",
    r"(max\(0, |sqrt\()([^()]+) \+ (?=[\d.])": r"\1\2 - -",
    rf"/\(1 \+ ({_NUMBER}) cos\(([^()]+)\)\^2\)": r" per_cos2(\2; \1)",
    rf"max\(0, ([^()]+) - ({_NUMBER})\)": r" hinge(\2 \1)",
    rf"sqrt\(([^()]+) - ({_NUMBER})\)": r" root(\2 \1)",
    rf"(?<!\w)\(({_NAME}) - ({_NAME})\)": r" ahead(\1, \2)",
    r"\|([^|]+)\|": r" abs(\1)",
}
"""How functions are written that have a sign or a formula of their own, and as a name with arguments."""
_TWO = re.compile(rf"\s*({_NAME})\s*([+-])\s*({_NAME})\s*")
_TOKEN = re.compile(rf"\s*(?:1|(?P<name>{_NAME})(?:\((?P<args>[^()]*)\))?)(?:\^(?P<power>\d+))?\s*\*?")
_ARGUMENT = re.compile(rf"\s*(?:(?P<fitted>~?)(?P<number>{_NUMBER})[ *]+)?(?P<name>{_NAME})\s*")


def parse(text: str) -> Feature:
    """Read a feature from its name, e.g. `omega_a |omega_a|`, `Omega_a^2 sin(2 alpha_p)`, `1`.

    Raises:
        ValueError: the text is no product of states, inputs and known functions, or a power is too large.
    """
    factors, place, plain = [], 0, text.rstrip()
    for spelling, call in _SPELLINGS.items():
        plain = re.sub(spelling, call, plain)
    while place < len(plain):
        token = _TOKEN.match(plain, place)
        if token is None:
            raise ValueError(
                f"function {text!r} of {setting('plant.library')} cannot be read at {plain[place:]!r}; allowed are "
                "products such as 'Omega_a^2 sin(alpha_p)': separate factors by spaces"
            )
        place = token.end()
        power = int((token["power"] or "1")[:9])  # more digits than that are refused below, whatever they are
        if token["args"] is not None:
            factors.append(_written(token["name"], token["args"], power))
        elif token["name"]:
            factors.append(Factor((token["name"],), "id", power))
    return Feature.of(map(_checked, factors))


def _written(name: str, arguments: str, power: int) -> Factor:
    """Read arguments of a function: `a`, `2 a`, `~2 a` whose number is fitted, or `a, b; 2` if it multiplies none."""
    names, semicolon, last = (part.strip() for part in arguments.partition(";"))
    if (two := _TWO.fullmatch(names)) and re.fullmatch(_NUMBER, last or "1"):
        return Factor((two[1], two[3]), function(name).of_two(two[2]), power, float(last or 1))
    each = [f"{last} {argument}" if semicolon else argument for argument in names.split(",")]
    found = [match for match in map(_ARGUMENT.fullmatch, each) if match is not None]
    numbers = {(bool(match["fitted"]), float(match["number"] or 1)) for match in found}
    if len(found) < len(each) or len(numbers) > 1 or (True, 0.0) in numbers:
        raise ValueError(
            f"function {name}({arguments}) of {setting('plant.library')} cannot be read; allowed are 'name', 'name - "
            f"other', "
            "'name, other' for a function of two arguments, '2 name', or '~2 name' for a first guess that is not 0, "
            "the same number before each name of a state or an input: correct it"
        )
    fitted, number = numbers.pop()
    return Factor(tuple(m["name"] for m in found), function(name).name, power, number, number if fitted else 0.0)


CONSTANT: Feature = Feature()
"""The function 1."""


LARGEST = 10_000
"""Number of functions beyond which a library is taken for a mistake; the largest of a plant here has 159."""


class Library:
    """Evaluate candidate functions of states and inputs, Theta(x, u) of the paper, eq. (library).

    Args:
        signature: names of the states and inputs the features read.
        features: candidate functions; repeated ones are kept once.
        allowed: features that may occur in a state's equation, by state; all where a state is not named.
        step: of the difference equation that the functions make up [s], see `systems.steps`; None of a
            differential equation.

    Raises:
        ValueError: a feature reads a state or an input that does not exist.
        ValueError: `allowed` names a state that does not exist.
        ValueError: there is no feature, or more than `LARGEST`.
    """

    def __init__(
        self,
        signature: Signature,
        features: Iterable[Feature],
        allowed: Mapping[str, Iterable[Feature]] | None = None,
        step: float | None = None,
    ) -> None:
        self.signature, self.step = signature, step
        first = [*islice(features, LARGEST + 1)]  # they are not counted to their end
        if len(first) > LARGEST:
            raise ValueError(
                f"the library has more than {LARGEST} functions; lower its degree or order, or choose another list in "
                f"{setting('plant.library')}"
            )
        self.features: tuple[Feature, ...] = tuple({f.key: f for f in first}.values())
        self._index = {n: i for i, n in enumerate((*signature.state_names, *signature.input_names))}
        wrong = sorted(set().union(*(f.variables for f in self.features)) - set(self._index))
        if wrong:
            raise ValueError(
                f"{setting('plant.library')} names {', '.join(wrong)}, which is no state and no input; allowed are "
                f"{', '.join(self._index)}: correct the name"
            )
        if not self.features:
            raise ValueError(
                f"{setting('plant.library')} is empty; allowed is one function or more, or the name of a list: add "
                "some there, or in the file of the plant"
            )
        self.names = tuple(f.name() for f in self.features)
        self.allowed: dict[str, tuple[str, ...]] = {}
        for state, group in (allowed or {}).items():
            signature.state_index(state)
            keys = {f.key for f in group}
            self.allowed[state] = tuple(f.name() for f in self.features if f.key in keys)

    def __len__(self) -> int:
        """Count the features."""
        return len(self.features)

    def left_side(self, state: str) -> str:
        """Return the left side of a state's equation: its rate, or its next value."""
        return f"{state}'" if self.step is None else f"{state}[k+1]"

    def change_of(self, state: str) -> str:
        """Return what the coefficients of a state are those of: its rate, or its change in a step of the equation."""
        return self.left_side(state) if self.step is None else f"the change of {state}"

    def mapping(self, coefficients: Tensor) -> tuple[Library, Tensor]:
        """Return what stands on the right of the equations: of a difference equation x[k] + step Xi' Theta, as one sum.

        Args:
            coefficients: Xi, `(n_features, n_x)`: rates of change.

        Returns:
            The library, with the states themselves where it is one of a difference equation, and the coefficients of
            the right sides.
        """
        step = self.step
        if step is None:
            return self, coefficients
        names = self.signature.state_names
        whole = Library(self.signature, [*map(variable, names), *self.features], step=step)
        table = torch.zeros(len(whole), len(names), dtype=coefficients.dtype)
        place = {feature.key: k for k, feature in enumerate(whole.features)}
        rows = [place[feature.key] for feature in self.features]
        table[rows] = step * coefficients
        for i, name in enumerate(names):
            own = place[variable(name).key]
            rate = float(table[own, i])
            table[own, i] = 1 + rate if abs(1 + rate) > CANCELLED * abs(rate) else 0.0
        return whole, table

    def require_finite(self, coefficients: Tensor, source: str = "model") -> Tensor:
        """Return coefficients, `(n_features, n_x)`, as they are; `source` is what found them, for the message.

        Raises:
            Diverged: one of them is not finite.
        """
        if len(wrong := (~coefficients.isfinite()).nonzero()):
            k, i = wrong[0].tolist()
            place = f"{self.names[k]} in {self.change_of(self.signature.state_names[i])}"
            raise Diverged(
                f"model learning: the {source} has {len(wrong)} coefficients that are not finite, such as "
                f"{coefficients[k, i].item()} of {place}; leave that function out of the library, or check the "
                "data's units"
            )
        return coefficients

    def subset(self, indices: Sequence[int]) -> Library:
        """Keep the features at the given positions."""
        return Library(self.signature, [self.features[i] for i in indices], step=self.step)

    def aligned(self, library: Library, values: Tensor) -> Tensor:
        """Return values of another library's functions, `(n, n_x)`, at the places of those of this one; 0 of others.

        Functions are the same whatever the numbers inside them were fitted to, states where they have one name.
        """

        def _key(feature: Feature) -> frozenset[Factor]:
            return frozenset(replace(f, frequency=f.fitted) if f.fitted else f for f in feature.factors)

        places, names = {_key(each): k for k, each in enumerate(self.features)}, self.signature.state_names
        pairs = [(i, names.index(name)) for i, name in enumerate(library.signature.state_names) if name in names]
        theirs, mine = map(list, zip(*pairs))
        found = values.new_zeros(len(self), len(names))
        for feature, row in zip(library.features, values, strict=True):
            if (place := places.get(_key(feature))) is not None:
                found[place, mine] = row[theirs]
        return found

    def index(self, name: str) -> int:
        """Find a feature by its readable name.

        Raises:
            ValueError: no feature has that name.
        """
        if name not in self.names:
            near = get_close_matches(name, self.names, 3, 0.0)
            raise ValueError(
                f"function {name!r} is not among the {len(self)} candidate functions, such as {', '.join(near)}: "
                f"correct it, or add it to {setting('plant.library')}"
            )
        return self.names.index(name)

    def __call__(self, x: Tensor, u: Tensor, numbers: Mapping[Factor, Tensor] | None = None) -> Tensor:
        """Evaluate all features, each factor computed once.

        Args:
            x: states, `(*batch, n_x)`.
            u: inputs, `(*batch, n_u)`.
            numbers: other numbers inside some of `shapes`.

        Returns:
            Theta, `(*batch, n_features)`, in the dtype of `x`.
        """
        columns = dict(zip(self._index, (*x.unbind(-1), *u.to(x.dtype).unbind(-1)), strict=True))
        known = {factor: factor.of(columns, number) for factor, number in (numbers or {}).items()}

        def _value(factor: Factor) -> Tensor:
            if factor not in known:
                plain = factor.power == 1
                known[factor] = factor.of(columns) if plain else _value(factor.base) ** factor.power
            return known[factor]

        one = torch.ones_like(x[..., 0])
        values = [reduce(operator.mul, map(_value, each.factors)) if each.factors else one for each in self.features]
        return torch.stack(values, -1)

    @property
    def shapes(self) -> tuple[Factor, ...]:
        """Return the factors whose number is fitted, each once, to the power of one."""
        return tuple({f.base: None for feature in self.features for f in feature.factors if f.fitted})

    def with_shapes(self, numbers: Sequence[float]) -> Library:
        """Return the library with other numbers inside its fitted factors, in the order of `shapes`."""
        new = {s: s.with_number(number).frequency for s, number in zip(self.shapes, numbers, strict=True)}
        features = [
            Feature(tuple(replace(f, frequency=new.get(f.base, f.frequency)) for f in feature.factors))
            if any(f.fitted for f in feature.factors)
            else feature
            for feature in self.features
        ]
        return Library(self.signature, features, step=self.step)

    def with_step(self, step: float | None) -> Library:
        """Return the library as one of a difference equation with that step [s], or of a differential equation."""
        changed = copy.copy(self)
        changed.step = step
        return changed


@dataclass(frozen=True)
class Constraints:
    """Hold prior knowledge as tensors.

    Attributes:
        free: coefficients to estimate, bool `(n_features, n_x)`.
        offset: coefficients that are given, float64 `(n_features, n_x)`, zero where free.
    """

    free: Tensor
    offset: Tensor

    @classmethod
    def build(
        cls,
        library: Library,
        known: Mapping[str, str],
        allowed: Mapping[str, Sequence[str]],
        fixed: Mapping[str, Mapping[str, float]],
        stated_in: str = "world_model.fixed",
    ) -> Constraints:
        """Translate names into tensors.

        Args:
            library: candidate functions.
            known: state to the function that is its rate, coefficient 1, e.g. `{"alpha_a": "Omega_a"}`.
            allowed: state to the functions that may occur in its equation; it goes before the library's own.
            fixed: state to functions with given coefficients.
            stated_in: key of the settings in which `fixed` stands, for messages.

        Raises:
            ValueError: a state or a function does not exist.
        """
        signature = library.signature
        if own := [state for state, function in known.items() if state == function]:
            raise ValueError(
                f"plant.known says that the rate of '{own[0]}' is '{own[0]}' itself; name the state that is its rate, "
                "or leave it out"
            )

        def _place(find: Callable[[str], int], name: str, key: str) -> int:
            try:
                return find(name)
            except ValueError as error:
                raise ValueError(f"{key}: {error}") from error

        free = torch.ones(len(library), signature.n_x, dtype=torch.bool)
        offset = torch.zeros(len(library), signature.n_x, dtype=torch.float64)
        for state, names in {**library.allowed, **allowed}.items():
            i = _place(signature.state_index, str(state), "world_model.allowed")
            free[:, i] = False
            for name in names:
                free[_place(library.index, name, f"world_model.allowed.{state}"), i] = True
        rates = {state: {name: 1.0} for state, name in known.items()}
        for key, table in ((stated_in, fixed), ("world_model.known", rates)):
            for state, given in table.items():
                i = _place(signature.state_index, str(state), key)
                if table is rates:
                    free[:, i], offset[:, i] = False, 0.0
                for name, value in given.items():
                    k = _place(library.index, name, f"{key}.{state}")
                    free[k, i], offset[k, i] = False, float(value)
        return cls(free, offset)


NEAR = 0.5
"""Part of the smaller of two numbers below which their sum shows that they nearly cancel."""


def equations(library: Library, coefficients: Tensor, digits: int = 4) -> list[str]:
    """Write one equation per state.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`.
        digits: significant digits.

    Returns:
        Lines such as `Omega_p' = -0.414 Omega_p + 0.0013 omega_p`; of a difference equation such as
        `p[k+1] = p + v + 0.0015 force`, all on the right at k.
    """
    library, coefficients = library.mapping(coefficients)
    lines = []
    for i, state in enumerate(library.signature.state_names):
        groups: dict[str, list[tuple[str, float]]] = {}
        for feature, value in _without_cancelling(
            dict(zip(library.features, coefficients[:, i].tolist(), strict=True))
        ):
            if value:
                quotient = " ".join(f.text() for f in feature.factors if f.function in QUOTIENTS)
                above = " ".join(f.text() for f in feature.factors if f.function not in QUOTIENTS) or "1"
                groups.setdefault(quotient, []).append((above if quotient else feature.name(), value))
        written = format_sum(groups.pop("", []), digits)
        for quotient, terms in groups.items():
            # What is divided by the same is written over it once.
            above, sign = format_sum(terms, digits), ""
            if len(terms) > 1:
                above = f"({above})"
            elif above.startswith("-"):
                above, sign = above[1:], "-"
            joint = (" - " if sign else " + ") if written else sign
            written += f"{joint}{above} {quotient}"
        lines.append(f"{library.left_side(state)} = {written or '0'}")
    return lines


def _without_cancelling(terms: dict[Feature, float]) -> list[tuple[Feature, float]]:
    """Return terms of which none outside of a quotient nearly cancels one within: both as one, over the quotient.

    With q = 1 + k cos^2 a sum c f + d f / q is ((c + d) f + c k f cos^2) / q.
    """
    for feature, within in [*terms.items()]:
        for factor in [f for f in feature.factors if f.function in QUOTIENTS and f.power == 1]:
            rest = Feature(tuple(f for f in feature.factors if f != factor))
            outside = terms.get(rest, 0.0)
            if abs(within + outside) < NEAR * min(abs(within), abs(outside)):
                cosine = of(factor.function.replace("per_cos2", "cos"), *factor.variables, power=2)
                more = rest * cosine * Feature((factor,))
                terms |= {rest: 0.0, feature: within + outside}
                terms[more] = terms.get(more, 0.0) + outside * factor.frequency
    return [*terms.items()]


def format_sum(terms: Sequence[tuple[str, float]], digits: int) -> str:
    """Write coefficients and functions as a sum."""
    written = ""
    for name, value in terms:
        sign = (" - " if written else "-") if value < 0 else (" + " if written else "")
        size = f"{abs(value):.{digits}g}"
        written += sign + (size if name == "1" else name if size == "1" else f"{size} {name}")
    return written
