"""The verdicts on the paper's statements, and every number that one of them depends on."""

from __future__ import annotations

from dataclasses import dataclass

from dynasindy.evaluation.ablation import Level
from dynasindy.evaluation.table import FEWEST
from dynasindy.viz.report.document import Verdict


@dataclass(frozen=True)
class Threshold:
    """A number that decides a verdict.

    Attributes:
        value: The number.
        unit: Its unit.
        words: What it decides, a sentence.
    """

    value: float
    unit: str
    words: str


LASTS = Threshold(0.1, "s", "The excitation lasts as long as the paper's 10 s if it differs by less than this.")
SAMPLES = Threshold(1000, "samples", "The first model is fitted to as much data as the paper's: exactly this many.")
FALL = Threshold(
    0.1,
    "of the first error",
    "The reward error of the model has fallen if that of the last episode is less than this part of the first, and "
    "below `gate.open_below` of the run, at which the model is trusted; one that is below it in every episode, none of "
    "them left out, is better than the paper's.",
)
CLOSE = Threshold(
    5.0,
    "% of the state's range",
    "A state is predicted well if its RMSE is less. Where the paper's model has difficulty, one that predicts every "
    "state well is better.",
)
COEFFICIENT = Threshold(1.0, "%", "A coefficient is found if its error is less; no other function may be in the model.")
EARLY = Threshold(0.25, "of the evaluations", "The first part, over which early rewards are averaged.")
NEAR = Threshold(
    0.05,
    "of the rise",
    "Final returns are nearly the same if they differ by at most this. Settings end alike only if the 95 % intervals "
    "of their errors at the end overlap as well.",
)
SEEDS = Threshold(
    float(FEWEST),
    "seeds",
    "Errors at the end are told apart by their intervals if there are as many seeds of each setting; of fewer "
    "there is no interval, and returns alone decide.",
)
SOON = Threshold(
    180,
    "real episodes",
    "Where 800 rollouts do not reach the level sooner than 400, both are better than the paper if they reach it within "
    "the episodes that the paper's 800 rollouts take.",
)
LEVEL = Threshold(
    Level().error,
    "rad",
    "The required level. A statement on steps is as in the paper only if the policies with planning that it names hold "
    "their references: steady-state errors of at most this. 400 rollouts that do, and overshoot no more than no "
    "planning, are better.",
)
FINE = Threshold(
    0.01,
    "rad",
    "Where 800 rollouts do not have the smallest steady-state error, it is better than the paper if 400 and 800 both "
    "have at most this: more rollouts have nothing left to add.",
)
FOLLOWS = Threshold(
    0.1,
    "of the amplitude",
    "A wave is followed if the RMSE, a level held if the error at its end, is less. That the error without the model "
    "is larger is as in the paper, or better, only if with the model the levels are held.",
)
TRANSIENT = Threshold(10.0, "s", "Left out at the start of a sine.")
SETTLED = Threshold(5.0, "s", "The end of each level of a square wave, at which its error is taken.")
THRESHOLDS = {name: value for name, value in globals().items() if isinstance(value, Threshold)}
"""All of them by name."""


def judged(holds: bool | None, better: bool = False) -> Verdict:
    """Return the verdict on a statement.

    Args:
        holds: Whether ours is as the paper says; None where it is not measured.
        better: Whether ours, though not as the paper says, is better in the sense of the statement.
    """
    if holds is None:
        return Verdict.UNKNOWN
    return Verdict.AS if holds else Verdict.BETTER if better else Verdict.SHORT
