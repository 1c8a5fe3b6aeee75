"""What a fit found, in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.world_models.library import Library
from dynasindy.world_models.regression import RunningSums


@dataclass(frozen=True)
class FitReport:
    """Summarise a fit.

    Attributes:
        samples: number of transitions behind the fit.
        seconds: wall time [s].
        terms: number of non-zero coefficients of each equation.
        residual: unexplained part of each state's rate of change, 2-norm relative to the rate's.
        rank: rank of the library over the data.
        n_features: number of candidate functions.
        condition: condition number of the library over the data, columns scaled to unit norm.
    """

    samples: int
    seconds: float
    terms: dict[str, int]
    residual: dict[str, float]
    rank: int
    n_features: int
    condition: float

    @classmethod
    def of(cls, library: Library, coefficients: Tensor, sums: RunningSums, seconds: float) -> FitReport:
        """Summarise the coefficients of a fit against the sums it was made from."""
        norms = sums.norms()
        relative = sums.residual(coefficients) / norms[sums.n_features :].clamp_min(1e-300)
        scale = torch.where(norms > 0, norms, 1.0)[: sums.n_features]
        singular = torch.linalg.svdvals(sums.theta() / scale)
        rank = int((singular > singular[0] * 1e-10).sum())
        names = library.signature.state_names
        return cls(
            samples=sums.count,
            seconds=seconds,
            terms=dict(zip(names, (coefficients != 0).sum(0).tolist(), strict=True)),
            residual=dict(zip(names, relative.tolist(), strict=True)),
            rank=rank,
            n_features=sums.n_features,
            condition=float(singular[0] / singular[-1].clamp_min(1e-300)),
        )

    def to_text(self) -> str:
        """Write the report in a few lines."""
        lines = [f"fit of {self.samples} samples in {self.seconds:.3g} s"]
        lines += [
            f"  {s}': {self.terms[s]} terms, unexplained {100 * r:.3g} %" for s, r in self.residual.items()
        ]
        return "\n".join(lines)
