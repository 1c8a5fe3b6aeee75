"""Turn a sparse model into torch code that computes active functions only, row by row.

Rows are state-major, `(n_x, batch)` in memory: at batch 4096 an elementwise operation then reads and writes
contiguous memory. Products shared by several terms are computed once. The code is plain torch: it is differentiable,
runs on any device and keeps the dtype of `x`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import torch
from torch import Tensor

from dynasindy.world_models.features import Factor, Feature, function
from dynasindy.world_models.library import Library

Field = Callable[[Tensor, Tensor], Tensor]


def generate(library: Library, coefficients: Tensor) -> Field:
    """Write and compile dx = Xi' Theta(x, u).

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`; zeros cost nothing.

    Returns:
        `(x, u) -> dx`, `(*batch, n_x)`.
    """
    writer = _Writer(library, coefficients)
    scope: dict[str, object] = {"torch": torch, **writer.functions}
    exec(compile(writer.source(), "<sparse model>", "exec"), scope)
    field: Field = scope["field"]  # type: ignore[assignment]
    field.__doc__ = writer.source()
    return field


class _Writer:
    """Collect lines of code; every value is written once."""

    def __init__(self, library: Library, coefficients: Tensor) -> None:
        self.library = library
        self.lines: list[str] = []
        self.written: dict[object, str] = {}
        self.functions: dict[str, object] = {}
        names = (*library.signature.state_names, *library.signature.input_names)
        self.variable = {n: f"z[{i}]" for i, n in enumerate(names)}
        table = coefficients.tolist()
        rows = [
            [(f, table[k][i]) for k, f in enumerate(library.features) if table[k][i]]
            for i in range(library.signature.n_x)
        ]
        self.uses = Counter(p for row in rows for f, _ in row for p in self._pairs(f))
        self.results = [self._row(row) for row in rows]

    def source(self) -> str:
        """Return the text of the function."""
        body = "\n    ".join(self.lines)
        return (
            "def field(x, u):\n    z = (*x.unbind(-1), *u.to(x.dtype).unbind(-1))\n    "
            f"{body}\n    return torch.stack(torch.broadcast_tensors({', '.join(self.results)}), 0).movedim(0, -1)\n"
        )

    def _line(self, key: object, expression: str) -> str:
        if key not in self.written:
            self.written[key] = f"v{len(self.written)}"
            self.lines.append(f"{self.written[key]} = {expression}")
        return self.written[key]

    def _row(self, row: list[tuple[Feature, float]]) -> str:
        """Sum the terms of one state; terms with a common factor are summed before they are multiplied by it."""
        if not row:
            return self._line("zeros", "torch.zeros_like(z[0])")
        constant = sum(c for f, c in row if not f.factors)
        groups: dict[Factor | None, list[tuple[Feature, float]]] = {}
        shared = Counter(p for f, _ in row for p in f.factors)
        for feature, c in row:
            common = [p for p in feature.factors if shared[p] > 1]
            if feature.factors:
                groups.setdefault(max(common, key=lambda p: shared[p]) if common else None, []).append((feature, c))
        total = self._sum([(self._product(f.factors), c) for f, c in groups.pop(None, [])], constant)
        for factor, members in groups.items():
            if factor is None:
                continue
            rests = [(tuple(p for p in f.factors if p != factor), c) for f, c in members]
            inner = self._sum([(self._product(f), c) for f, c in rests if f], sum(c for f, c in rests if not f))
            product = (
                f"torch.addcmul({total}, {inner}, {self._factor(factor)})"
                if total
                else f"{inner} * {self._factor(factor)}"
            )
            total = self._line(("sum", len(self.lines)), product)
        return total

    def _sum(self, terms: list[tuple[str, float]], constant: float) -> str:
        if not terms:
            return self._line(("constant", constant), f"torch.full_like(z[0], {constant!r})") if constant else ""
        value, c = terms[0]
        total = value if c == 1 else self._line((value, c), f"{value} * {c!r}")
        if constant:
            total = self._line((total, "+", constant), f"{total} + {constant!r}")
        for value, c in terms[1:]:
            total = self._line((total, value, c), f"torch.add({total}, {value}, alpha={c!r})")
        return total

    @staticmethod
    def _pairs(feature: Feature) -> list[frozenset[Factor]]:
        return [frozenset((a, b)) for i, a in enumerate(feature.factors) for b in feature.factors[:i]]

    def _product(self, factors: tuple[Factor, ...]) -> str:
        """Multiply factors, beginning with the pair that most terms share."""
        if len(factors) == 1:
            return self._factor(factors[0])
        pairs = self._pairs(Feature(factors))
        first = max(pairs, key=lambda p: self.uses[p])
        ordered = sorted(factors, key=lambda f: f not in first)
        value, key = self._factor(ordered[0]), frozenset(ordered[:1])
        for factor in ordered[1:]:
            key = key | {factor}
            value = self._line(key, f"{value} * {self._factor(factor)}")
        return value

    def _factor(self, factor: Factor) -> str:
        if factor.power > 1:
            half = self._factor(Factor(factor.variables, factor.function, factor.power - 1, factor.frequency))
            return self._line(factor, f"{half} * {self._factor(factor.base)}")
        args = [self.variable[v] for v in factor.variables]
        if factor.frequency != 1:
            args = [self._line((a, factor.frequency), f"{a} * {factor.frequency!r}") for a in args]
        if factor.function == "id":
            return args[0]
        self.functions[f"f_{factor.function}"] = function(factor.function).compute
        return self._line(factor, f"f_{factor.function}({', '.join(args)})")
