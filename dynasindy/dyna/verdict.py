"""Whether a run has left a usable result and holds its plant, from the figures that it ended with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dynasindy.evaluation.tracking_criteria import WITHIN, TrackingCriteria, judge_control
from dynasindy.findings import Finding, note, weak, wrong

HARDLY = 0.01
"""Gain, as a share of the untrained policy's return, below which a policy is said to be hardly better."""


class RunVerdict(NamedTuple):
    """What a run's result is worth: whether the policy is better than the untrained one, and as `judge_control`."""

    usable: bool
    controlled: bool | None
    findings: tuple[Finding, ...]


def judge_run(metrics: Mapping[str, Any], within: float = WITHIN) -> RunVerdict:
    """Compare the trained policy with the untrained one, and with what was asked for, in the scenario of both.

    Args:
        metrics: What a run ends with: `scenario`, the summaries `untrained` and `evaluation`, each with a
            `return`, None where it is not finite, and `held`, see `evaluation.tracking_criteria`; and the number of its
            `episodes`, without which there is no `gate.csv`.
        within: Mean absolute error at the end that is asked for, in ranges of targets.
    """
    untrained, trained = (_number(metrics[key]["return"]) for key in ("untrained", "evaluation"))
    finite = math.isfinite(trained) and math.isfinite(untrained)
    facts: dict[str, Any] = {"scenario": metrics["scenario"], "trained": trained, "untrained": untrained}
    if usable := finite and trained > untrained:
        share = (trained - untrained) / max(abs(untrained), 1e-300)
        hardly = share < HARDLY
        compared = (weak if hardly else note)("run.better", **facts, percent=100 * share, hardly=hardly)
    else:
        compared = wrong("run.no_better", **facts, episodes=bool(metrics.get("episodes", 1)))
    controlled, tracked = judge_control([TrackingCriteria(**metrics["held"])], within, grew=usable)
    return RunVerdict(usable, controlled, (compared, tracked))


def distrusted(decisions: Sequence[Mapping[str, float | None]]) -> Finding | None:
    """Return in how many episodes the model was not trusted, and why the last time; None where it always was.

    Args:
        decisions: Rows of `gate.csv`.
    """
    closed = [row for row in decisions if not row["open"]]
    if not closed:
        return None
    last = {key: _number(value) for key, value in closed[-1].items()}
    counts = {"closed": len(closed), "episodes": len(decisions), "episode": int(last["episode"])}
    limits = {key: last[key] for key in ("open_below", "close_above")}
    return weak("run.gate_closed", **counts, error=last["judged_reward_error"], **limits)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
