"""Turn a library into torch code for its functions and their derivatives, those that are not zero alone.

A fit to trajectories evaluates both some thousand times in batches of a few dozen states, where the cost is that of
starting small operations: common products are computed once, and derivatives that are zero are not computed at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import torch
from torch import Tensor

from dynasindy.world_models.libraries.features import Factor, Feature
from dynasindy.world_models.libraries.functions import function
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.writers.fast_field import Constants, Writer

Values = tuple[Tensor, Tensor, Tensor]


class Slopes:
    """Evaluate the functions of a library and their derivatives.

    Args:
        library: candidate functions.
        shapes: factors by whose numbers to differentiate too.

    Attributes:
        by_state: (feature, state) of each derivative that is not zero.
        by_shape: (feature, shape) of each derivative by a number inside a factor.
    """

    def __init__(self, library: Library, shapes: Sequence[Factor] = ()) -> None:
        writer = _SlopeWriter(library)
        theta = [writer.feature(f) for f in library.features]
        self.by_state: list[tuple[int, int]] = []
        self.by_shape: list[tuple[int, int]] = []
        slopes, numbers = [], []
        for k, feature in enumerate(library.features):
            for state, name in enumerate(library.signature.state_names):
                if written := writer.slope(feature, name):
                    self.by_state.append((k, state))
                    slopes.append(written)
            for j, shape in enumerate(shapes):
                if written := writer.shape_slope(feature, shape):
                    self.by_shape.append((k, j))
                    numbers.append(written)
        body = "".join(f"    {line}\n" for line in writer.lines)
        results = ", ".join(_stacked(names) for names in (theta, slopes, numbers))
        source = (
            "def slopes(x, u):\n    k, z = constants(x), (*x.unbind(-1), *u.to(x.dtype).unbind(-1))\n"
            f"    ones, none = torch.ones_like(z[0]), x[..., :0]\n{body}    return {results}\n"
        )
        scope: dict[str, object] = {"torch": torch, "constants": Constants(writer.constants), **writer.functions}
        exec(compile(source, "<slopes of a library>", "exec"), scope)
        self._compute = cast(Callable[[Tensor, Tensor], Values], scope["slopes"])

    def __call__(self, x: Tensor, u: Tensor) -> Values:
        """Return the functions, `(B, n_features)`, and the derivatives of `by_state` and of `by_shape`, `(B, ...)`."""
        return self._compute(x, u)


def _stacked(names: Sequence[str]) -> str:
    return f"torch.stack(({', '.join(names)},), -1)" if names else "none"


class _SlopeWriter(Writer):
    """Write functions and their derivatives, each once."""

    def __init__(self, library: Library) -> None:
        super().__init__(library.signature)

    def feature(self, feature: Feature) -> str:
        """Write a function."""
        return self._product({f.base: f.power for f in feature.factors}) or "ones"

    def slope(self, feature: Feature, name: str) -> str:
        """Write the derivative by a state, "" where there is none."""
        return self._chain(feature, lambda factor: self._derivative(factor, name))

    def shape_slope(self, feature: Feature, shape: Factor) -> str:
        """Write the derivative by the number inside a factor, "" where the function has no such factor."""
        return self._chain(feature, lambda factor: self._by_number(factor) if factor.base == shape else "")

    def _chain(self, feature: Feature, derivative: Callable[[Factor], str]) -> str:
        total = ""
        for k, factor in enumerate(feature.factors):
            if not (inner := derivative(factor)):
                continue
            powers = {f.base: f.power for f in (*feature.factors[:k], *feature.factors[k + 1 :])}
            if factor.power != 1:
                powers[factor.base] = factor.power - 1
                inner = self._line((inner, factor.power), f"{inner} * {float(factor.power)!r}")
            rest = self._product(powers)
            term = self._line((inner, "*", rest), f"{inner} * {rest}") if rest else inner
            total = self._line((total, "+", term), f"{total} + {term}") if total else term
        return total

    def _derivative(self, factor: Factor, name: str) -> str:
        """Write the derivative of a factor, its power left out, by a variable."""
        if name not in factor.variables:
            return ""
        base, slope = factor.base, function(factor.function).slope
        if factor.function == "id":
            return (
                self._line(("id", factor.frequency), f"ones * {factor.frequency!r}")
                if factor.frequency != 1
                else "ones"
            )
        arguments = ", ".join(self.variable[v] for v in factor.variables)
        if slope is not None and len(factor.variables) == 1 and function(factor.function).parametric:
            self.functions[f"s_{factor.function}"] = slope
            written = f"s_{factor.function}({arguments}, {factor.frequency!r})"
            return self._line((base, "slope"), written)
        slopes = function(factor.function).slopes
        if slopes and (function(factor.function).parametric or factor.frequency == 1):
            place = factor.variables.index(name)
            number = f", {factor.frequency!r}" if function(factor.function).parametric else ""
            self.functions[f"s{place}_{factor.function}"] = slopes[place]
            return self._line((base, "by", name), f"s{place}_{factor.function}({arguments}{number})")
        if slope is None or len(factor.variables) > 1:
            key = f"d{len(self.functions)}_{factor.function}"
            self.functions[key] = _tangent(base, factor.variables.index(name))
            return self._line((base, "by", name), f"{key}({arguments})")
        self.functions[f"s_{factor.function}"] = slope
        inner = self._scaled(factor)[0]
        written = self._line((base, "slope"), f"s_{factor.function}({inner})")
        if factor.frequency == 1:
            return written
        return self._line((base, "scaled slope"), f"{written} * {factor.frequency!r}")

    def _by_number(self, factor: Factor) -> str:
        key = f"n{len(self.functions)}_{factor.function}"
        self.functions[key] = factor.base.slope
        return self._line((factor.base, "by number"), f"{key}({', '.join(self.variable[v] for v in factor.variables)})")


def _tangent(factor: Factor, argument: int) -> Callable[..., Tensor]:
    """Return the derivative of an elementwise function by one argument: its tangent along ones."""

    def _compute(*args: Tensor) -> Tensor:
        along = tuple(torch.ones_like(a) if j == argument else torch.zeros_like(a) for j, a in enumerate(args))
        return cast(Tensor, torch.func.jvp(factor.compute(), args, along)[1])

    return _compute
