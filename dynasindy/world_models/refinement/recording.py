"""A recording as a fit reads it, under inputs that act later than they were given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.refinement.delay import delayed, known_inputs
from dynasindy.world_models.refinement.measured import Seen, reconstruct
from dynasindy.world_models.refinement.windows import ENOUGH, spread

BRIEF = 2 * ENOUGH
"""Rows of a recording by which regressions choose functions, delays and numbers inside functions."""


@dataclass(frozen=True)
class Recording:
    """Hold a recording, to be read under inputs that act later than they were given.

    Attributes:
        data: transitions, NaN where a state was not measured.
        guess: the same, the states that were not measured guessed.
        rates: which state is the rate of which other one, `{rate: state}`.
        known: rows whose inputs are known however late they act, bool `(N,)`.
        noisy: whether states that were all measured are noisy: `guess` holds them smoothed then.
    """

    data: Transitions
    guess: Transitions
    rates: Mapping[int, int]
    known: Tensor
    noisy: bool = False

    @classmethod
    def of(cls, data: Transitions, guess: Transitions, rates: Mapping[int, int], longest: float) -> Recording:
        """Leave out the rows whose inputs of up to `longest` seconds before are not known."""
        return cls(data, guess, rates, known_inputs(data, longest))

    def brief(self, longest: float) -> Recording:
        """Return stretches of a long recording, enough for a regression; all of a short one.

        Args:
            longest: time before a row at which its inputs are to be known [s].
        """
        rows = spread(len(self.data), BRIEF)
        if bool(rows.all()):
            return self
        part = Recording.of(self.data.select(rows), self.guess.select(rows), self.rates, longest)
        return replace(part, noisy=self.noisy)

    def smoothed(self, step: float | None = None) -> Recording:
        """Return the recording as one whose samples are noisy, wherever it is read from now on.

        Args:
            step: of the difference equation that is fitted [s]: it may jump from sample to sample, and no cubic tells
                that from noise, so that the recording stays as it is; None of a differential equation.
        """
        if step is not None:
            return self
        return replace(self, guess=reconstruct(self.data, self.rates, True), noisy=True)

    def measured(self, delay: float) -> Transitions:
        """Return what was measured, under inputs that act `delay` seconds later."""
        return delayed(self.data, delay).select(self.known)

    def guessed(self, delay: float) -> Transitions:
        """Return the same with a guess of every state."""
        return delayed(self.guess, delay).select(self.known)

    def seen(self, delay: float) -> Seen:
        """Return what regressions read, under inputs that act `delay` seconds later."""
        return Seen.of(self.guessed(delay), self.measured(delay), self.rates, self.noisy)
