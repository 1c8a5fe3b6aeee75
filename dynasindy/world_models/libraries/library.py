"""Library of candidate functions Theta(x, u): an ordered set of features over a signature."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import islice
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.world_models.libraries.features import Factor, Feature

LARGEST = 10_000
"""Number of functions beyond which a library is taken for a mistake; the largest of a plant here has 159."""


def bounded(features: Iterable[Feature]) -> list[Feature]:
    """Return features, unless there are more than a library may hold; they are not counted to their end.

    Raises:
        ValueError: there are more.
    """
    first = list(islice(features, LARGEST + 1))
    if len(first) > LARGEST:
        raise ValueError(
            f"the library has more than {LARGEST} functions; lower its degree or order, or choose another list in "
            "plant.library"
        )
    return first


class _Plan(NamedTuple):
    """Hold how a library is computed.

    Attributes:
        products: places of the values whose product each feature is.
        steps: factors, each with the places of what it reads; its value has the next place after all earlier ones, of
            which the first are the states and inputs.
    """

    products: list[tuple[int, ...]]
    steps: list[tuple[Factor, tuple[int, ...]]]


class Library:
    """Evaluate candidate functions of states and inputs, Theta(x, u) of the paper, eq. (library).

    `a + b` holds the functions of both, `a * b` all products of a function of one with a function of the other.

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
        self.features: tuple[Feature, ...] = tuple({f.key: f for f in bounded(features)}.values())
        self._index = {n: i for i, n in enumerate((*signature.state_names, *signature.input_names))}
        wrong = sorted(set().union(*(f.variables for f in self.features)) - set(self._index))
        if wrong:
            raise ValueError(
                f"plant.library names {', '.join(wrong)}, which is no state and no input; allowed are "
                f"{', '.join(self._index)}: correct the name"
            )
        if not self.features:
            raise ValueError(
                "plant.library is empty; allowed is one function or more, or the name of a list: add some there, or in "
                "the file of the plant"
            )
        self.names = tuple(f.name() for f in self.features)
        self._plan: _Plan | None = None
        self.allowed: dict[str, tuple[str, ...]] = {}
        for state, group in (allowed or {}).items():
            signature.state_index(state)
            keys = {f.key for f in group}
            self.allowed[state] = tuple(f.name() for f in self.features if f.key in keys)

    def __len__(self) -> int:
        """Count the features."""
        return len(self.features)

    def __add__(self, other: Library) -> Library:
        """Unite two libraries; what was allowed where is forgotten."""
        return Library(self.signature, self.features + other.features)

    def __mul__(self, other: Library) -> Library:
        """Multiply every feature of one library with every feature of the other; `allowed` is forgotten."""
        return Library(self.signature, (a * b for b in other.features for a in self.features))

    def subset(self, indices: Sequence[int]) -> Library:
        """Keep the features at the given positions."""
        return Library(self.signature, [self.features[i] for i in indices], step=self.step)

    def index(self, name: str) -> int:
        """Find a feature by its readable name.

        Raises:
            ValueError: no feature has that name.
        """
        if name not in self.names:
            near = get_close_matches(name, self.names, 3, 0.0)
            raise ValueError(
                f"function {name!r} is not among the {len(self)} candidate functions, such as {', '.join(near)}: "
                "correct it, or add it to plant.library"
            )
        return self.names.index(name)

    def __call__(self, x: Tensor, u: Tensor) -> Tensor:
        """Evaluate all features.

        Args:
            x: states, `(*batch, n_x)`.
            u: inputs, `(*batch, n_u)`.

        Returns:
            Theta, `(*batch, n_features)`, in the dtype of `x`.
        """
        if self._plan is None:
            self._plan = self._planned()
        values = [*x.unbind(-1), *u.to(x.dtype).unbind(-1)]
        for factor, places in self._plan.steps:
            args = [values[place] for place in places]
            values.append(factor.compute()(*args) if factor.power == 1 else args[0] ** factor.power)
        columns = []
        for places in self._plan.products:
            column = values[places[0]] if places else torch.ones_like(values[0])
            for place in places[1:]:
                column = column * values[place]
            columns.append(column)
        return torch.stack(columns, -1)

    def _planned(self) -> _Plan:
        """Return what there is to compute, each factor once."""
        steps: list[tuple[Factor, tuple[int, ...]]] = []
        known: dict[Factor, int] = {}

        def _place(factor: Factor) -> int:
            if factor not in known:
                read = tuple(self._index[v] for v in factor.variables)
                steps.append((factor, read if factor.power == 1 else (_place(factor.base),)))
                known[factor] = len(self._index) + len(steps) - 1
            return known[factor]

        return _Plan([tuple(_place(factor) for factor in f.factors) for f in self.features], steps)

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
        names = dict(zip(self.names, (f.name() for f in features), strict=True))
        changed = Library(self.signature, features, step=self.step)
        changed.allowed = {state: tuple(names[n] for n in group) for state, group in self.allowed.items()}
        return changed

    def with_step(self, step: float | None) -> Library:
        """Return the library as one of a difference equation with that step [s], or of a differential equation."""
        changed = copy.copy(self)
        changed.step = step
        return changed

    def by_shapes(self, x: Tensor, u: Tensor, shapes: Sequence[Factor]) -> Tensor:
        """Evaluate the derivatives of all features by the numbers inside some factors.

        Args:
            x: states, `(*batch, n_x)`.
            u: inputs, `(*batch, n_u)`.
            shapes: factors to the power of one.

        Returns:
            `(*batch, n_features, n_shapes)`.
        """
        columns = (*x.unbind(-1), *u.to(x.dtype).unbind(-1))
        values: dict[Factor, Tensor] = {}
        ones = torch.ones_like(columns[0])
        slopes = torch.zeros(*x.shape[:-1], len(self.features), len(shapes), dtype=x.dtype, device=x.device)
        for j, shape in enumerate(shapes):
            slope = shape.slope(*(columns[self._index[v]] for v in shape.variables))
            for i, feature in enumerate(self.features):
                for k, factor in enumerate(feature.factors):
                    if factor.base == shape:
                        lower = (replace(factor, power=factor.power - 1),) if factor.power != 1 else ()
                        rest = feature.factors[:k] + lower + feature.factors[k + 1 :]
                        slopes[..., i, j] = slope * factor.power * self._product(rest, columns, values, ones)
        return slopes

    def _product(
        self, factors: Iterable[Factor], columns: Sequence[Tensor], values: dict[Factor, Tensor], ones: Tensor
    ) -> Tensor:
        product: Tensor | None = None
        for factor in factors:
            value = self._value(factor, columns, values)
            product = value if product is None else product * value
        return ones if product is None else product

    def _value(self, factor: Factor, columns: Sequence[Tensor], values: dict[Factor, Tensor]) -> Tensor:
        if factor not in values:
            if factor.power != 1:
                values[factor] = self._value(factor.base, columns, values) ** factor.power
            else:
                values[factor] = factor.compute()(*(columns[self._index[v]] for v in factor.variables))
        return values[factor]
