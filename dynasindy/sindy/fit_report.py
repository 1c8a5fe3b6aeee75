"""What a refinement found and set aside, and the report of a fit in figures and in words."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from dynasindy.findings import Finding, note
from dynasindy.sentences import line
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.equations import change_of
from dynasindy.sindy.library import Library
from dynasindy.sindy.regression import TriangularFactor

CLEAR = 1e6
"""Condition number below which functions are well apart."""


@dataclass(frozen=True)
class Identifiability:
    """Describe how well the samples separate the candidate functions.

    Attributes:
        rank: number of independent directions among the functions.
        n_features: number of functions.
        condition: largest over smallest singular value, columns scaled to unit norm.
        weakest: functions in the least excited direction, with their weight in it, heaviest first.
    """

    rank: int
    n_features: int
    condition: float
    weakest: tuple[tuple[str, float], ...]

    @classmethod
    def of(cls, library: Library, factor: TriangularFactor) -> Identifiability:
        """Judge the samples behind a regression.

        Args:
            library: candidate functions.
            factor: the samples.
        """
        norms = factor.norms()[: factor.n_features]
        scaled = factor.theta() / torch.where(norms > 0, norms, 1.0)
        _, singular, directions = torch.linalg.svd(scaled)
        rank = int((singular > 1e-10 * singular[0]).sum())
        weights = directions[-1]
        order = weights.abs().argsort(descending=True)
        weakest = [(library.names[k], float(weights[k])) for k in order.tolist() if abs(float(weights[k])) > 0.2]
        if bool((norms == 0).any()):
            weakest = [(library.names[k], 1.0) for k in (norms == 0).nonzero().flatten().tolist()]
        condition = float(singular[0] / singular[-1]) if float(singular[-1]) > 0 else float("inf")
        return cls(rank, factor.n_features, condition, tuple(weakest))

    def to_text(self) -> str:
        """Write which functions the data can tell apart, in one line."""
        count, names = self.n_features, ", ".join(name for name, _ in self.weakest)
        condition = f"condition number {self.condition:.2g}"
        if self.rank < count:
            which = f"{count - self.rank} of {count} candidate functions"
            return f"{which} cannot be told apart from others by these data: excite {names} more, or otherwise"
        if self.condition < CLEAR:
            told = f"the data can tell all {count} candidate functions apart"
            return f"{told} ({condition}; below {CLEAR:,.0f} is good)"
        return f"these of {count} candidate functions can hardly be told apart by these data ({condition}): {names}"


class Refined(NamedTuple):
    """Hold what a refinement found.

    Attributes:
        library: candidate functions, with the numbers inside fitted factors.
        coefficients: Xi, `(n_features, n_x)`.
        delay: time between an input and its effect [s].
        findings: what was chosen, and by what.
        covariance: how well the coefficients are known; None where that is not told.
        missed: part of each state's change that predictions of single steps miss, where these were fitted.
    """

    library: Library
    coefficients: Tensor
    delay: float = 0.0
    findings: tuple[Finding, ...] = ()
    covariance: Covariance | None = None
    missed: dict[str, float] | None = None


CHANGE = "the change over a step"
"""What percentages of a difference equation are of."""
EXACT = 1e-6
"""Part of a rate of change that may stay unexplained where a fit is called exact; digits of the data end there."""


@dataclass(frozen=True)
class FitReport:
    """Summarise a fit.

    Attributes:
        samples: number of transitions behind the fit.
        seconds: wall time [s].
        terms: number of non-zero coefficients of each equation.
        residual: unexplained part of each state's rate of change, 2-norm relative to the rate's; where single steps
            were fitted, that of its change in a step.
        findings: what a reader would not expect.
        dt: time that a transition takes [s].
        covariance: how well the coefficients are known; None where that is not told.
    """

    samples: int
    seconds: float
    terms: dict[str, int]
    residual: dict[str, float]
    _source: tuple[Library, Tensor, TriangularFactor] = field(repr=False)
    findings: tuple[Finding, ...] = ()
    dt: float | None = None
    covariance: Covariance | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        library: Library,
        coefficients: Tensor,
        factor: TriangularFactor,
        seconds: float,
        residual: dict[str, float] | None = None,
        **more: Any,
    ) -> FitReport:
        """Summarise the coefficients of a fit against the factor it was made from, but for what is given."""
        relative = factor.residual(coefficients) / factor.norms()[factor.n_features :].clamp_min(1e-300)
        names, source = library.signature.state_names, (library, coefficients.clone(), copy(factor))
        terms = dict(zip(names, (coefficients != 0).sum(0).tolist(), strict=True))
        residual = residual or dict(zip(names, relative.tolist(), strict=True))
        return cls(**{"samples": factor.count} | more, seconds=seconds, terms=terms, residual=residual, _source=source)

    def told_apart(self) -> Tensor:
        """Return the part of each function that the others of its equation leave over, 0 to 1, `(n_features, n_x)`.

        Of a function of which they leave over next to nothing, the data do not tell the coefficient: large ones cancel.
        """
        _, coefficients, factor = self._source
        scaled, parts = factor.theta(), torch.zeros_like(coefficients)
        scaled = scaled / scaled.norm(dim=0).clamp_min(1e-300)
        for i in range(coefficients.shape[1]):
            active = coefficients[:, i].nonzero().flatten()
            parts[active, i] = 1 / torch.linalg.pinv(scaled[:, active]).norm(dim=1).clamp_min(1.0)
        return parts

    @property
    def accuracy(self) -> list[Finding]:
        """How well the coefficients are known; nothing where that is not told."""
        if self.covariance is None:
            return []
        library, xi, _ = self._source
        shares = 100 * self.covariance.shares(xi)
        worst = int(shares.argmax())
        feature, state = int(self.covariance.features[worst]), int(self.covariance.states[worst])
        return [
            note(
                "fit.standard_errors",
                median=float(shares.median()),
                least=f"{library.names[feature]} in {change_of(library, library.signature.state_names[state])}",
                worst=float(shares[worst]),
                of_step=library.step is not None,
            )
        ]

    def to_text(self) -> str:
        """Write the report in a few lines."""
        each = f" of {self.dt:g} s" if self.dt else ""
        lines = [f"fit of {self.samples} transitions{each}, which took {self.seconds:.3g} s"]
        counts = {name: f"{count} term{'s' * (count != 1)}" for name, count in self.terms.items()}
        library, _, factor = self._source
        moves, it = ("'", "it") if library.step is None else ("[k+1] - {0}[k]", f"it, {CHANGE},")
        simulated = any(each.code == "fit.trajectories" for each in self.findings)  # then it is noise of single samples
        for state, part in self.residual.items():
            left = f"{100 * part:.3g} % of {it} stays unexplained (RMS), noise of the samples included"
            left = f"nothing of {it} stays unexplained" if part <= EXACT else left  # what is not a number is not exact
            missed = "" if simulated else f"; {left}"
            lines.append(f"  {state}{moves.format(state)}: {counts[state]}{missed}")
        known = [str(each) for each in self.accuracy]
        findings = map(line, self.findings)
        return "\n".join([*lines, *known, *findings, Identifiability.of(library, factor).to_text()])
