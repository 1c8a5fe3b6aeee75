"""Predictions of a sparse model together with their derivatives by its coefficients and by the start state.

| name   | symbol                    | shape               |
| ------ | ------------------------- | ------------------- |
| xi     | Xi                        | `(n_features, n_x)` |
| places | (feature, state) of each estimated coefficient, P of them | two `(P,)` |
| shapes | the numbers inside fitted factors, S of them | `(S,)` |
| s      | dx/d(x0, shapes, xi_1 .. xi_P) | `(B, n_x, n_x + S + P)` |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.world_models.libraries.features import Factor
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.writers.fast_slopes import Slopes


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

    def take(self, places: Tensor) -> Parameters:
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
        self.features, self.states = position[parameters.features], parameters.states
        self.n_x, self.shapes = xi.shape[1], tuple(shapes)
        self.slopes = Slopes(library.subset(rows.tolist()), self.shapes)
        self.jacobian = _summed(self.xi, self.slopes.by_state, self.n_x)
        self.of_shapes = _summed(self.xi, self.slopes.by_shape, len(self.shapes))

    def slopes_by_state(self, x: Tensor, u: Tensor) -> Tensor:
        """Return the derivatives of the rates by the states, `(N, n_x, n_x)`."""
        return (self.slopes(x, u)[1] @ self.jacobian).unflatten(-1, (self.n_x, self.n_x))

    def start(self, batch: int) -> Tensor:
        """Return the sensitivities of start states by themselves, the shapes and the coefficients."""
        s = torch.zeros(batch, self.n_x, self.n_x + len(self.shapes) + len(self.features), dtype=torch.float64)
        s[:, :, : self.n_x] = torch.eye(self.n_x, dtype=torch.float64)
        return s

    def _rate(self, x: Tensor, s: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        theta, slopes, by_shape = self.slopes(x, u)
        ds = (slopes @ self.jacobian).unflatten(-1, (self.n_x, self.n_x)) @ s
        if self.shapes:
            ds[:, :, self.n_x : self.n_x + len(self.shapes)] += (by_shape @ self.of_shapes).unflatten(
                -1, (self.n_x, len(self.shapes))
            )
        columns = torch.arange(ds.shape[-1] - len(self.features), ds.shape[-1])
        ds[:, self.states, columns] += theta[:, self.features]
        return theta @ self.xi, ds

    def step(self, x: Tensor, s: Tensor, u: Tensor, h: float) -> tuple[Tensor, Tensor]:
        """Advance by one Runge-Kutta step of length h [s].

        Args:
            x: states, `(B, n_x)`.
            s: sensitivities, `(B, n_x, n_x + S + P)`.
            u: inputs, `(B, n_u)`.
            h: length of the step [s].
        """
        dx1, ds1 = self._rate(x, s, u)
        dx2, ds2 = self._rate(x + h / 2 * dx1, torch.add(s, ds1, alpha=h / 2), u)
        dx3, ds3 = self._rate(x + h / 2 * dx2, torch.add(s, ds2, alpha=h / 2), u)
        dx4, ds4 = self._rate(x + h * dx3, torch.add(s, ds3, alpha=h), u)
        x = x + h / 6 * (dx1 + 2 * dx2 + 2 * dx3 + dx4)
        ds = ds1.add_(ds2, alpha=2.0).add_(ds3, alpha=2.0).add_(ds4)
        return x, torch.add(s, ds, alpha=h / 6)

    def advance(self, x: Tensor, s: Tensor, u: Tensor, dt: float, substeps: int) -> tuple[Tensor, Tensor]:
        """Advance by one sampling interval of length dt [s] in `substeps` steps."""
        for _ in range(substeps):
            x, s = self.step(x, s, u, dt / substeps)
        return x, s


def _summed(xi: Tensor, places: Sequence[tuple[int, int]], width: int) -> Tensor:
    """Return the matrix that turns derivatives of functions into those of the rates, `(n_places, n_x * width)`."""
    matrix = torch.zeros(len(places), xi.shape[1], width, dtype=xi.dtype)
    for row, (feature, column) in enumerate(places):
        matrix[row, :, column] = xi[feature]
    return matrix.flatten(1)
