"""Whether a run has left a usable result, from the figures that it ended with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Verdict:
    """What a run's result is worth; `dataclasses.asdict` gives what `metrics.json` holds.

    Attributes:
        usable: Whether the trained policy is better than the untrained one.
        sentence: Why, in words and with both returns.
    """

    usable: bool
    sentence: str


def judge(metrics: Mapping[str, Any]) -> Verdict:
    """Compare the trained policy with the untrained one in the scenario in which both were evaluated.

    Args:
        metrics: What a run ends with: `scenario`, and the summaries `untrained` and `evaluation`, each with a
            `return`, None where it is not finite.
    """
    untrained, trained = (_number(metrics[key]["return"]) for key in ("untrained", "evaluation"))
    where = f"in scenario '{metrics['scenario']}'"
    if not (math.isfinite(trained) and math.isfinite(untrained)):
        return Verdict(
            False,
            f"There is no usable result: the return {where} is not finite (trained {trained}, untrained "
            f"{untrained}); check the plant and the task's reward.",
        )
    returns = f"its return {where} is {trained:.6g}, the untrained policy's {untrained:.6g}"
    if trained > untrained:
        return Verdict(True, f"The trained policy is better than the untrained one: {returns}.")
    how = "worse than" if trained < untrained else "no better than"
    return Verdict(
        False,
        f"There is no usable result: the trained policy is {how} the untrained one: {returns}; train for more "
        "episodes, or look in gate.csv whether the model was trusted.",
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
