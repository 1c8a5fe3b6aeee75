"""Which episode of an evaluation is drawn, saved over time and animated, and how it stands among the others."""

from __future__ import annotations

from dataclasses import dataclass

from dynasindy.evaluation.scenarios import Evaluation


@dataclass(frozen=True)
class Drawn:
    """One episode of many.

    Attributes:
        row: Its row in the evaluation.
        words: Which it is, why this one, and how many did better; empty of the only one.
    """

    row: int
    words: str


def drawn(evaluation: Evaluation) -> Drawn:
    """Choose the episode to be drawn, by nothing that a controller does: figures of several show the same one.

    Where all episodes begin in one state it is the first one of the scenario. Where they do not, it is the one that
    begins farthest from its reference, in target ranges, as a pendulum that hangs and is to stand; of a task
    without references, the one that earns least in its first period.
    """
    number = len(evaluation.inputs)
    if number == 1:
        return Drawn(0, "")
    starts = evaluation.trajectory["state"][:, 0]
    row, why = 0, "the same for every controller"
    if bool((starts != starts[0]).any()):
        row, why = _farthest(evaluation)
    return Drawn(row, f"episode {row + 1} of {number}, {why}; {_better(evaluation, row)}")


def _farthest(evaluation: Evaluation) -> tuple[int, str]:
    if not evaluation.columns:
        first = evaluation.trajectory["next", "reward"][:, 0].flatten()
        return int(first.argmin()), "the one that starts where least is earned"
    return int(evaluation.errors[:, 0].amax(-1).argmax()), "the one that starts farthest from its target"


def _better(evaluation: Evaluation, row: int) -> str:
    """Say how many episodes did better."""
    if not evaluation.columns:
        return f"{int((evaluation.returns > evaluation.returns[row]).sum())} others earn more"
    errors = evaluation.errors.mean(1).amax(-1)
    return f"{int((errors < errors[row]).sum())} others have a smaller error"
