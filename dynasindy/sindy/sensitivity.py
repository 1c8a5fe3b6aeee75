"""Predictions of a sparse model with their derivatives by its coefficients and by the start state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import torch
from torch import Tensor

from dynasindy.sindy.codegen import Writer, write_functions
from dynasindy.sindy.functions import function
from dynasindy.sindy.library import Factor, Feature, Library
from dynasindy.systems.compiler import compiler
from dynasindy.systems.interpreter import MeasurementUpdate, Slopes
from dynasindy.systems.steps import between, steps_of

Values = tuple[Tensor, Tensor, Tensor]


class TorchSlopes:
    """Evaluate the functions of a library and their derivatives.

    Args:
        library: candidate functions.
        shapes: factors by whose numbers to differentiate too.

    Attributes:
        by_state: (feature, state) of each derivative that is not zero.
        by_shape: (feature, shape) of each derivative by a number inside a factor.
    """

    def __init__(self, library: Library, shapes: Sequence[Factor] = ()) -> None:
        writer = _SlopeWriter(library.signature)
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
        self._compute: Callable[[Tensor, Tensor], Values] = writer.compiled("slopes", source)

    def __call__(self, x: Tensor, u: Tensor) -> Values:
        """Return the functions, `(B, n_features)`, and the derivatives of `by_state` and of `by_shape`, `(B, ...)`."""
        return self._compute(x, u)


def _stacked(names: Sequence[str]) -> str:
    return f"torch.stack(({', '.join(names)},), -1)" if names else "none"


class _SlopeWriter(Writer):
    """Write functions and their derivatives, each once."""

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
        known, base, place = function(factor.function), factor.base, factor.variables.index(name)
        if factor.function == "id":
            return (
                "ones"
                if factor.frequency == 1
                else self._line(("id", factor.frequency), f"ones * {factor.frequency!r}")
            )
        slopes = known.slopes or ((known.slope,) if known.slope and len(factor.variables) == 1 else ())
        arguments = [self.variable[v] for v in factor.variables]
        if not slopes:
            key = f"d{len(self.functions)}_{factor.function}"
            self.functions[key] = _tangent(base, place)
            return self._line((base, "by", name), f"{key}({', '.join(arguments)})")
        arguments = [*arguments, repr(factor.frequency)] if known.parametric else self._scaled(factor)
        self.functions[f"s{place}_{factor.function}"] = slopes[place]
        written = self._line((base, "by", name), f"s{place}_{factor.function}({', '.join(arguments)})")
        if known.parametric or factor.frequency == 1:
            return written
        return self._line((base, "scaled by", name), f"{written} * {factor.frequency!r}")

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


MOST = 2_000_000
"""Numbers of functions and slopes, about, that are kept at a time, so that they stay in fast memory."""


@dataclass(frozen=True)
class Parameters:
    """Name the coefficients that are estimated.

    Attributes:
        features: row of each in Xi, `(P,)`.
        states: column of each in Xi, `(P,)`.
    """

    features: Tensor
    states: Tensor

    @classmethod
    def where(cls, support: Tensor) -> Parameters:
        """Take the coefficients where `support` `(n_features, n_x)` is true, state by state."""
        states, features = support.mT.nonzero(as_tuple=True)
        return cls(features, states)

    def __add__(self, other: Parameters) -> Parameters:
        """Name these coefficients, then the others."""
        return Parameters(torch.cat([self.features, other.features]), torch.cat([self.states, other.states]))

    def take(self, places: Tensor | slice) -> Parameters:
        """Return those at the given places."""
        return Parameters(self.features[places], self.states[places])

    def __len__(self) -> int:
        """Count the coefficients."""
        return len(self.features)

    def best_of_each_state(self, gain: Tensor, limit: float) -> Tensor:
        """Return, for each state, the place of the coefficient of largest gain, if that is above the limit."""
        best: list[int] = []
        for state in self.states.unique().tolist():
            mine = (self.states == state).nonzero().flatten()
            first = mine[gain[mine].argmax()]
            best += [int(first)] if float(gain[first]) > limit else []
        return torch.tensor(best, dtype=torch.int64)

    def read(self, xi: Tensor) -> Tensor:
        """Return their values, `(P,)`."""
        return xi[self.features, self.states]

    def write(self, xi: Tensor, values: Tensor) -> Tensor:
        """Return Xi with their values replaced."""
        changed = xi.clone()
        changed[self.features, self.states] = values
        return changed

    def support(self, shape: torch.Size) -> Tensor:
        """Return where they are, bool of the given shape."""
        mask = torch.zeros(shape, dtype=torch.bool)
        mask[self.features, self.states] = True
        return mask


class Propagator:
    """Integrate states and sensitivities by the same Runge-Kutta steps as the model's own prediction.

    Args:
        library: candidate functions.
        xi: coefficients, `(n_features, n_x)`.
        parameters: coefficients to differentiate by.
        shapes: factors by whose numbers to differentiate.
    """

    def __init__(self, library: Library, xi: Tensor, parameters: Parameters, shapes: Sequence[Factor] = ()) -> None:
        used = (xi != 0).any(-1)
        used[parameters.features] = True
        rows = used.nonzero().squeeze(-1)
        self.xi = xi[rows]
        position = torch.zeros(len(used), dtype=torch.int64)
        position[rows] = torch.arange(len(rows))
        self._own = position[parameters.features], parameters.states
        self.n_x, self.shapes, self.step = xi.shape[1], tuple(shapes), library.step
        self._library = library.subset(rows.tolist())

    @cached_property
    def _code(self) -> Slopes | None:
        """The functions as instructions; None where one of them has no formula, or nothing compiles these."""
        if compiler() is None:
            return None
        try:
            return Slopes(*write_functions(self._library, self.shapes))
        except (ValueError, OSError):
            return None

    @cached_property
    def slopes(self) -> TorchSlopes:
        """The functions and their slopes as torch code."""
        return TorchSlopes(self._library, self.shapes)

    @cached_property
    def jacobian(self) -> Tensor:
        """The matrix by which slopes of functions by the states become those of the rates."""
        return _summed(self.xi, self.slopes.by_state, self.n_x)

    @cached_property
    def of_shapes(self) -> Tensor:
        """The same of slopes by the shapes."""
        return _summed(self.xi, self.slopes.by_shape, len(self.shapes))

    def slopes_by_state(self, x: Tensor, u: Tensor) -> Tensor:
        """Return the derivatives of the rates by the states, `(N, n_x, n_x)`."""
        if self._code and x.dtype == u.dtype == torch.float64:
            return self._code.rates_by_state(self.xi, x, u)
        return (self.slopes(x, u)[1] @ self.jacobian).unflatten(-1, (self.n_x, self.n_x))

    def transfer(
        self, x: Tensor, u: Tensor, dt: float, substeps: int, u_end: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the states one sampling interval later, and their derivatives by what the interval begins with.

        A step k1 .. k4 of h moves an error of its end by a4 = h/6, a3 = h/3 + h a4 J4, a2 = h/3 + h/2 a3 J3 and
        a1 = h/6 + h/2 a2 J2 times the errors of its four rates, where J are the slopes of the rates by the states. So
        the functions themselves need no sensitivities of their own: each is weighed, once. A step of a difference
        equation has one rate, whose error moves the end by h of itself.

        Args:
            x: states, `(B, n_x)`.
            u: inputs at the start of the interval, `(B, n_u)`.
            dt: length of the interval [s].
            substeps: Runge-Kutta steps in it; a difference equation has its own.
            u_end: inputs at its end, see `Transitions`.

        Returns:
            States, `(B, n_x)`, and derivatives by the states before, the shapes and the coefficients,
            `(B, n_x, n_x + S + P)`.
        """
        if self._code:
            last = None if u_end is None else u_end.unsqueeze(1)
            ends, slopes = self._code.trajectories(self.xi, self._own, x, u.unsqueeze(1), dt, substeps, last)
            return ends[:, 0], slopes[:, 0]
        stages = 4 * substeps * (len(self.xi) + len(self.jacobian) + self.n_x)
        length = max(1, MOST // stages)
        parts = zip(x.split(length), u.split(length), (u if u_end is None else u_end).split(length), strict=True)
        found = [self._transfer(a, b, dt, substeps, None if u_end is None else c) for a, b, c in parts]
        return torch.cat([end for end, _ in found]), torch.cat([slopes for _, slopes in found])

    def trajectories(
        self,
        x: Tensor,
        u: Tensor,
        dt: float,
        substeps: int,
        u_end: Tensor | None = None,
        update: MeasurementUpdate | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return states after intervals that follow each other, and their derivatives by what the first begins with.

        Args:
            x: states at the start, `(W, n_x)`.
            u: inputs at the start of each interval, `(W, L, n_u)`.
            dt: length of an interval [s].
            substeps: Runge-Kutta steps in it; a difference equation has its own.
            u_end: inputs at its end, see `Transitions`.
            update: what corrects the states after each interval.

        Returns:
            States, `(W, L, n_x)`, and derivatives by the states x, the fitted elements of the gain, the shapes and the
            coefficients, `(W, L, n_x, n_x + G + S + P)`.
        """
        if self._code:
            return self._code.trajectories(self.xi, self._own, x, u, dt, substeps, u_end, update)
        ends, slopes, before = [], list[Tensor](), x
        fitted = None if update is None else update.free
        for k in range(u.shape[1]):
            x, moved = self.transfer(x, u[:, k], dt, substeps, None if u_end is None else u_end[:, k])
            if fitted is not None:
                none = moved.new_zeros(*moved.shape[:2], fitted.shape[1])
                moved = torch.cat([moved[..., : self.n_x], none, moved[..., self.n_x :]], -1)
            ends.append(x)
            slopes.append(_chained(moved, before) if slopes else moved)
            before = slopes[-1]
            if update is not None:
                missed, there = (update.measured[:, k] - x).nan_to_num(), update.measured[:, k].isfinite()
                x = update.corrected(x, k)
                before = before - (update.gain * there.unsqueeze(-2)) @ before
                for column, (i, j) in enumerate([] if fitted is None else fitted.mT.tolist()):
                    before[:, i, self.n_x + column] += missed[:, j]
        return torch.stack(ends, 1), torch.stack(slopes, 1)

    def _transfer(self, x: Tensor, u: Tensor, dt: float, substeps: int, u_end: Tensor | None) -> tuple[Tensor, Tensor]:
        (h, count, difference), stages = steps_of(self.step, dt, substeps), []
        parts = [(0.0, h)] if difference else [(0.0, h / 6), (h / 2, h / 3), (h / 2, h / 3), (h, h / 6)]
        for k in range(count):
            dx, total = torch.zeros_like(x), torch.zeros_like(x)
            for ahead, weight in parts:
                values = self.slopes(x + ahead * dx, between(u, u_end, (k + ahead / h) / count))
                dx = values[0] @ self.xi
                total = total + weight * dx
                stages.append(values)
            x = x + total
        unit = torch.eye(self.n_x, dtype=x.dtype)
        after, weights = unit.expand(len(x), -1, -1), []
        for k in range(count - 1, -1, -1):
            mine = (slopes @ self.jacobian for _, slopes, _ in stages[len(parts) * k : len(parts) * (k + 1)])
            jacobians = [slopes.unflatten(-1, (self.n_x, self.n_x)) for slopes in mine]
            if difference:
                weights.append(h * after)
                after = after + weights[-1] @ jacobians[0]
                continue
            a4 = h / 6 * after
            a3 = 2 * a4 + h * (p4 := a4 @ jacobians[3])
            a2 = 2 * a4 + h / 2 * (p3 := a3 @ jacobians[2])
            a1 = a4 + h / 2 * (p2 := a2 @ jacobians[1])
            after = after + a1 @ jacobians[0] + p2 + p3 + p4
            weights += [a4, a3, a2, a1]
        moved = torch.stack(weights[::-1], -1)  # (B, n_x, n_x, stages): of the end, by the rate of each state
        theta = torch.stack([values[0] for values in stages], 1)
        columns = [after]
        if self.shapes:
            by_shape = torch.stack([by_shape @ self.of_shapes for _, _, by_shape in stages], 1)
            by_shape = by_shape.unflatten(-1, (self.n_x, len(self.shapes)))
            columns.append(torch.einsum("bxyq,bqys->bxs", moved, by_shape))
        features, states = self._own
        own = x.new_empty(len(x), self.n_x, len(features))
        for state in states.unique().tolist():
            mine = states == state
            own[:, :, mine] = moved[:, :, state] @ theta[:, :, features[mine]]
        return x, torch.cat([*columns, own], -1)


def _chained(moved: Tensor, s: Tensor) -> Tensor:
    """Return the sensitivities after an interval of those before it, both `(B, n_x, n_x + S + P)`."""
    n_x = moved.shape[1]
    after = moved[..., :n_x] @ s
    after[..., n_x:] += moved[..., n_x:]
    return after


def _summed(xi: Tensor, places: Sequence[tuple[int, int]], width: int) -> Tensor:
    """Return the matrix that turns derivatives of functions into those of the rates, `(n_places, n_x * width)`."""
    matrix = torch.zeros(len(places), xi.shape[1], width, dtype=xi.dtype)
    for row, (feature, column) in enumerate(places):
        matrix[row, :, column] = xi[feature]
    return matrix.flatten(1)
