"""Refinement of a sparse model on its prediction error."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.constraints import Constraints
from dynasindy.world_models.fast_field import generate
from dynasindy.world_models.library import Library
from dynasindy.world_models.regression import Regression, RunningSums, simpson_form


@dataclass(frozen=True)
class Refinement:
    """Settings of the refinement."""

    rounds: int = 2
    tolerance: float = 1e-6

    def run(
        self, library: Library, coefficients: Tensor, constraints: Constraints, data: Transitions
    ) -> Tensor:
        """Return refined coefficients, `(n_features, n_x)`."""
        regression = Regression(method="bic", tolerance=self.tolerance)
        for _ in range(self.rounds):
            sums = RunningSums(len(library), library.signature.n_x)
            sums.add(simpson_form(library, generate(library, coefficients), data))
            coefficients = regression.solve(sums, constraints.free, constraints.offset)
        return coefficients
