"""Predictions of a sparse model with their derivatives by its coefficients and by the start state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from dynasindy.sindy.codegen import write_functions
from dynasindy.sindy.library import Factor, Library
from dynasindy.systems.compiler import compiler
from dynasindy.systems.interpreter import MeasurementUpdate, Slopes
from dynasindy.systems.steps import between, steps_of

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

    def _by_state(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Return the functions, `(B, n_features)`, and the derivatives of the rates by the states, `(B, n_x, n_x)`."""
        units = torch.eye(self.n_x, dtype=x.dtype).unbind()
        found = [torch.func.jvp(lambda z: self._library(z, u), (x,), (unit.expand_as(x),)) for unit in units]
        return found[0][0], torch.stack([each[1] @ self.xi for each in found], -1)

    def slopes_by_state(self, x: Tensor, u: Tensor) -> Tensor:
        """Return the derivatives of the rates by the states, `(N, n_x, n_x)`."""
        if self._code and x.dtype == u.dtype == torch.float64:
            return self._code.rates_by_state(self.xi, x, u)
        return self._by_state(x, u)[1]

    def transfer(
        self, x: Tensor, u: Tensor, dt: float, substeps: int, u_end: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the states one sampling interval later, and their derivatives by what the interval begins with.

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
        stages = 4 * substeps * (len(self.xi) + self.n_x**2 + self.n_x * len(self.shapes))
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
        (h, count, difference), none = steps_of(self.step, dt, substeps), len(self.shapes) + len(self._own[0])
        s = torch.nn.functional.pad(torch.eye(self.n_x, dtype=x.dtype), (0, none)).expand(len(x), -1, -1)
        parts = [(0.0, h)] if difference else [(0.0, h / 6), (h / 2, h / 3), (h / 2, h / 3), (h, h / 6)]
        for k in range(count):
            dx, ds, total, moved = torch.zeros_like(x), torch.zeros_like(s), x, s
            for ahead, weight in parts:
                at = x + ahead * dx, between(u, u_end, (k + ahead / h) / count)
                dx, ds = self._rates(*at, s + ahead * ds)
                total, moved = total + weight * dx, moved + weight * ds
            x, s = total, moved
        return x, s

    def _rates(self, x: Tensor, u: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return the rates of states and of their derivatives `(B, n_x, n_x + S + P)`."""
        theta, by_state = self._by_state(x, u)
        features, states = self._own
        own = x.new_zeros(len(x), self.n_x, len(features))
        own[:, states, torch.arange(len(features))] = theta[:, features]
        by_shape = (self._library.by_shapes(x, u, self.shapes).mT @ self.xi).mT
        ds = by_state @ s
        ds[..., self.n_x :] += torch.cat([by_shape, own], -1)
        return theta @ self.xi, ds


def _chained(moved: Tensor, s: Tensor) -> Tensor:
    """Return the sensitivities after an interval of those before it, both `(B, n_x, n_x + S + P)`."""
    n_x = moved.shape[1]
    after = moved[..., :n_x] @ s
    after[..., n_x:] += moved[..., n_x:]
    return after
