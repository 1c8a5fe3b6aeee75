"""Predictions of a sparse model with their derivatives by its coefficients and by the start state."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.sindy.codegen import Writer, advance
from dynasindy.sindy.functions import function
from dynasindy.sindy.library import Factor, Library
from dynasindy.systems.interpreter import MeasurementUpdate, simulate_program
from dynasindy.systems.steps import Rates


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


def trajectory_sensitivities(
    library: Library,
    xi: Tensor,
    parameters: Parameters,
    x: Tensor,
    u: Tensor,
    dt: float,
    substeps: int,
    u_end: Tensor | None = None,
    update: MeasurementUpdate | None = None,
) -> tuple[Tensor, Tensor]:
    """Return states after intervals that follow each other, and their derivatives by what the first begins with.

    The Runge-Kutta steps are those of the model's own prediction.

    Args:
        library: candidate functions; by the numbers inside its fitted factors is differentiated.
        xi: coefficients, `(n_features, n_x)`.
        parameters: coefficients to differentiate by.
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
    used = (xi != 0).any(-1).index_fill(0, parameters.features, True)
    own, shapes = ((used.cumsum(0) - 1)[parameters.features], parameters.states), library.shapes
    library, xi = library.subset(used.nonzero().flatten().tolist()), xi[used]
    with suppress(ValueError, OSError):  # there is no compiler
        writer = _FunctionWriter(library, shapes)
        program, numbers = writer.program(), [writer.numbers.get(shape) for shape in shapes]
        return simulate_program(program, x, u, dt, substeps, u_end, update, xi, numbers, own)
    fitted = torch.zeros(2, 0).long() if update is None or update.free is None else update.free
    sizes = [x.shape[1], fitted.shape[1], len(shapes), len(parameters)]

    def _ends(changes: Tensor) -> Tensor:
        start, gain, numbers, values = changes.split(sizes)
        moved = xi.index_put(own, values, accumulate=True)

        inside = {shape: shape.frequency + by for shape, by in zip(shapes, numbers, strict=True)}

        def _field(x: Tensor, u: Tensor) -> Tensor:
            return library(x, u, inside) @ moved

        corrected = update
        if update is not None:
            corrected = update._replace(gain=update.gain.index_put(tuple(fitted), gain, accumulate=True))
        return advance(Rates(_field, library.step), x + start, u, dt, substeps, u_end, corrected)

    none = x.new_zeros(sum(sizes))
    found = [torch.func.jvp(_ends, (none,), (unit,)) for unit in torch.eye(len(none), dtype=x.dtype)]
    return found[0][0], torch.stack([each[1] for each in found], -1)


class _FunctionWriter(Writer):
    """Write functions; the number of each of `shapes` is a constant of its own."""

    def __init__(self, library: Library, shapes: Sequence[Factor]) -> None:
        self.shapes, self.numbers = set(shapes), dict[Factor, int]()
        super().__init__(library, torch.eye(len(library)))

    def _scaled(self, factor: Factor) -> list[str]:
        if factor.base not in self.shapes:
            return super()._scaled(factor)
        if factor.base not in self.numbers:
            self.numbers[factor.base] = len(self.constants)
            self._constant(factor.frequency)
        number, args = f"k[{self.numbers[factor.base]}]", [self.variable[v] for v in factor.variables]
        return [*args, number] if function(factor.function).parametric else [f"({a} * {number})" for a in args]


def slopes_by_state(library: Library, xi: Tensor, x: Tensor, u: Tensor) -> Tensor:
    """Return the derivatives of the rates by the states, `(N, n_x, n_x)`: of a step of 1 s by them, less one."""
    n_x, none = xi.shape[1], Parameters.where(torch.zeros_like(xi, dtype=torch.bool))
    slopes = trajectory_sensitivities(library.with_step(1.0), xi, none, x, u.unsqueeze(1), 1.0, 1)[1][:, 0, :, :n_x]
    return slopes - torch.eye(n_x, dtype=slopes.dtype)
