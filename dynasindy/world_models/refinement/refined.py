"""What a refinement found, and what it set aside."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.regression.covariance import Covariance


class Refined(NamedTuple):
    """Hold what a refinement found.

    Attributes:
        library: candidate functions, with the numbers inside fitted factors.
        coefficients: Xi, `(n_features, n_x)`.
        delay: time between an input and its effect [s].
        notes: sentences on what was chosen, and by what.
        in_pieces: whether `auto` found that the log is met in pieces only, which begin anew: something is lacking.
        covariance: how well the coefficients are known; None where that is not told.
        delay_at_end: whether the delay is the longest that was tried.
        missed: part of each state's change that predictions of single steps miss, where these were fitted.
        aside: the fit by one simulation through all samples, where `auto` has set it aside for one in pieces: parts of
            the log that no fit has seen tell which of the two predicts better. None where there is no such choice.
    """

    library: Library
    coefficients: Tensor
    delay: float = 0.0
    notes: tuple[str, ...] = ()
    in_pieces: bool = False
    covariance: Covariance | None = None
    delay_at_end: bool = False
    missed: dict[str, float] | None = None
    aside: Refined | None = None

    def with_notes(self, notes: tuple[str, ...], longest: float, dt: float) -> Refined:
        """Return it with notes before its own, the same of what was set aside, and with a note on a delay at its end.

        Args:
            notes: sentences on what was chosen before.
            longest: longest delay of the inputs that was looked for [s].
            dt: sampling time [s].
        """
        aside = self.aside and self.aside.with_notes(notes, longest, dt)
        notes, at_end = notes + self.notes, bool(self.delay) and self.delay > longest - 0.5 * dt
        if at_end:
            notes += (
                f"the best delay of the inputs is the longest that was tried, {longest:g} s; it may be "
                f"longer: give longest_delay={2 * longest:g}, or 0 where it stands for what the equations lack. "
                "Coefficients may be further off than their standard errors say, which take the delay as right",
            )
        return self._replace(notes=notes, delay_at_end=at_end, aside=aside)
