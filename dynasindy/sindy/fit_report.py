"""What a refinement found and set aside, and the report of a fit in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.findings import Finding, note
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.library import Library
from dynasindy.sindy.regression import TriangularFactor


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
        library: candidate functions, with the numbers inside fitted factors.
        coefficients: Xi, `(n_features, n_x)`.
        factor: of averaged functions and rates of change.
        seconds: CPU time [s].
        samples: number of transitions behind the fit.
        missed: part of each state's change that predictions of single steps miss, where these were fitted.
        findings: what a reader would not expect.
        dt: time that a transition takes [s].
        covariance: how well the coefficients are known; None where that is not told.
        hidden: states that no sensor sees and that are no rates, of whose functions the samples hold nothing.
    """

    library: Library = field(repr=False)
    coefficients: Tensor = field(repr=False)
    factor: TriangularFactor = field(repr=False)
    seconds: float
    samples: int
    missed: dict[str, float] | None = None
    findings: tuple[Finding, ...] = ()
    dt: float | None = None
    covariance: Covariance | None = field(default=None, repr=False)
    hidden: frozenset[str] = frozenset()

    @property
    def terms(self) -> dict[str, int]:
        """Number of non-zero coefficients of each equation."""
        return dict(zip(self.library.signature.state_names, (self.coefficients != 0).sum(0).tolist(), strict=True))

    @property
    def residual(self) -> dict[str, float]:
        """Unexplained part of each state's rate of change, 2-norm relative to the rate's; or what is `missed`."""
        rates = self.factor.targets().norm(dim=0).clamp_min(1e-300)
        relative = (self.factor.residual(self.coefficients) / rates).tolist()
        return self.missed or dict(zip(self.library.signature.state_names, relative, strict=True))

    @property
    def identifiability(self) -> Finding:
        """How well the samples separate the functions.

        That is the rank of their columns, the condition number of these in unit norm, the functions of the least
        excited direction with their weights in it, heaviest first, and what these read, which may be moved more.
        """
        features = self.library.features
        seen = [k for k, each in enumerate(features) if not each.variables & self.hidden] or range(len(features))
        theta, names = self.factor.theta()[:, seen], [self.library.names[k] for k in seen]
        norms = theta.norm(dim=0)
        _, singular, directions = torch.linalg.svd(theta / torch.where(norms > 0, norms, 1.0))
        rank, weights = int((singular > 1e-10 * singular[0]).sum()), directions[-1].tolist()
        order = sorted(range(len(names)), key=lambda k: -abs(weights[k]))
        weakest = {names[k]: 1.0 for k in (norms == 0).nonzero().flatten().tolist()}
        weakest = weakest or {names[k]: weights[k] for k in order if abs(weights[k]) > 0.2}
        condition = float(singular[0] / singular[-1])
        read = sorted({v for k in seen for v in features[k].variables if self.library.names[k] in weakest})
        found = {"rank": rank, "count": len(names), "condition": condition}
        return note("fit.identifiability", **found, weakest=weakest, read=read)

    def told_apart(self) -> Tensor:
        """Return the part of each function that the others of its equation leave over, 0 to 1, `(n_features, n_x)`.

        Of a function of which they leave over next to nothing, the data do not tell the coefficient: large ones cancel.
        """
        coefficients, scaled, parts = self.coefficients, self.factor.theta(), torch.zeros_like(self.coefficients)
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
        library, shares = self.library, 100 * self.covariance.shares(self.coefficients)
        worst = int(shares.argmax())
        feature, state = int(self.covariance.features[worst]), int(self.covariance.states[worst])
        return [
            note(
                "fit.standard_errors",
                median=float(shares.median()),
                least=f"{library.names[feature]} in {library.change_of(library.signature.state_names[state])}",
                worst=float(shares[worst]),
                of_step=library.step is not None,
            )
        ]

    def to_text(self) -> str:
        """Write the report in a few lines."""
        each = f" of {self.dt:g} s" if self.dt else ""
        lines = [f"fit of {self.samples} transitions{each}, which took {self.seconds:.3g} s of computing"]
        counts = {name: f"{count} term{'s' * (count != 1)}" for name, count in self.terms.items()}
        moves, it = ("'", "it") if self.library.step is None else ("[k+1] - {0}[k]", f"it, {CHANGE},")
        simulated = any(each.code == "fit.trajectories" for each in self.findings)  # then it is noise of single samples
        for state, part in self.residual.items():
            left = f"{100 * part:.3g} % of {it} is left over (RMS), sensor noise included"
            left = f"nothing of {it} is left over" if part <= EXACT else left  # what is not a number is not exact
            missed = "" if simulated else f"; {left}"
            lines.append(f"  {state}{moves.format(state)}: {counts[state]}{missed}")
        lines += [*map(str, self.accuracy), *(each.line() for each in self.findings), str(self.identifiability)]
        return "\n".join(lines)
