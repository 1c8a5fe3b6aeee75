"""What a fit found, in figures and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.refinement.refined import Refined
from dynasindy.world_models.regression.covariance import Covariance
from dynasindy.world_models.regression.identifiability import Identifiability
from dynasindy.world_models.regression.regression import RunningSums
from dynasindy.world_models.writers.tables import change_of

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
        notes: sentences on what a reader would not expect.
        dt: time that a transition takes [s].
        unmeasured: states whose rates of change were not measured, or are functions of what was not: of an estimate
            that nobody measured a part that stays unexplained says nothing.
        in_pieces: whether simulations meet the log in pieces only, which begin anew: something is lacking.
        covariance: how well the coefficients are known; None where that is not told.
        delay_at_end: whether the delay of the inputs is the longest that was tried.
        aside: what the fit by one simulation through all samples found, where it was set aside for one in pieces.
    """

    samples: int
    seconds: float
    terms: dict[str, int]
    residual: dict[str, float]
    _source: tuple[Library, Tensor, RunningSums] = field(repr=False)
    notes: tuple[str, ...] = ()
    dt: float | None = None
    in_pieces: bool = False
    covariance: Covariance | None = None
    unmeasured: frozenset[str] = frozenset()
    delay_at_end: bool = False
    aside: Refined | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        library: Library,
        coefficients: Tensor,
        sums: RunningSums,
        seconds: float,
        notes: Sequence[str] = (),
        dt: float | None = None,
    ) -> FitReport:
        """Summarise the coefficients of a fit against the sums it was made from."""
        relative = sums.residual(coefficients) / sums.norms()[sums.n_features :].clamp_min(1e-300)
        names = library.signature.state_names
        return cls(
            samples=sums.count,
            seconds=seconds,
            terms=dict(zip(names, (coefficients != 0).sum(0).tolist(), strict=True)),
            residual=dict(zip(names, relative.tolist(), strict=True)),
            _source=(library, coefficients.clone(), sums.copy()),
            notes=tuple(notes),
            dt=dt,
        )

    def told_apart(self) -> Tensor:
        """Return the part of each function that the others of its equation leave over, 0 to 1, `(n_features, n_x)`.

        Of a function of which they leave over next to nothing, the data do not tell the coefficient: large ones cancel.
        """
        _, coefficients, sums = self._source
        scaled, parts = sums.theta(), torch.zeros_like(coefficients)
        scaled = scaled / scaled.norm(dim=0).clamp_min(1e-300)
        for i in range(coefficients.shape[1]):
            active = coefficients[:, i].nonzero().flatten()
            parts[active, i] = 1 / torch.linalg.pinv(scaled[:, active]).norm(dim=1).clamp_min(1.0)
        return parts

    @cached_property
    def identifiability(self) -> Identifiability:
        """Judge what the samples can tell; computed when first asked for."""
        library, _, sums = self._source
        return Identifiability.of(library, sums)

    @property
    def known(self) -> str:
        """Say how well the coefficients are known; nothing where that is not told."""
        if self.covariance is None:
            return ""
        library, xi, _ = self._source
        shares = 100 * self.covariance.shares(xi)
        worst = int(shares.argmax())
        feature, state = int(self.covariance.features[worst]), int(self.covariance.states[worst])
        place = f"that of {library.names[feature]} in {change_of(library, library.signature.state_names[state])}"
        whose = "" if library.step is None else f" of {CHANGE}"
        return (
            f"coefficients{whose} are known within {float(shares.median()):.2g} % of themselves in the median, and "
            f"{place}, the least of all, within {float(shares[worst]):.2g} % (standard errors)"
        )

    def to_text(self) -> str:
        """Write the report in a few lines."""
        each = f" of {self.dt:g} s" if self.dt else ""
        lines = [f"fit of {self.samples} transitions{each}, which took {self.seconds:.3g} s"]
        counts = {name: f"{count} term{'s' * (count != 1)}" for name, count in self.terms.items()}
        moves, it = ("'", "it") if self._source[0].step is None else ("[k+1] - {0}[k]", f"it, {CHANGE},")
        for state, part in self.residual.items():
            left = f"{100 * part:.3g} % of {it} stays unexplained (RMS)"
            left = f"nothing of {it} stays unexplained" if part <= EXACT else left  # what is not a number is not exact
            missed = "" if state in self.unmeasured else f"; {left}"
            lines.append(f"  {state}{moves.format(state)}: {counts[state]}{missed}")
        told = [*filter(None, [self.known]), *(f"note: {note}" for note in self.notes)]
        return "\n".join([*lines, *told, self.identifiability.to_text()])


def unmeasured(library: Library, coefficients: Tensor, data: Transitions) -> frozenset[str]:
    """Return the states that no sensor saw, and those whose equations read one.

    Args:
        library: candidate functions.
        coefficients: Xi, `(n_features, n_x)`.
        data: the log, NaN where a state was not measured.
    """
    names, blind = library.signature.state_names, data.x.isnan().all(0).tolist()
    unseen = {name for name, never in zip(names, blind, strict=True) if never}
    read = [
        {v for k in column.nonzero().flatten().tolist() for v in library.features[k].variables}
        for column in coefficients.unbind(-1)
    ]
    return frozenset(name for name, own in zip(names, read, strict=True) if name in unseen or own & unseen)
