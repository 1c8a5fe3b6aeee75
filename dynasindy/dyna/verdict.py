"""Whether a run has left a usable result and holds its plant, from the figures that it ended with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dynasindy.evaluation.tracking_criteria import LOST, WITHIN, error_reference

HARDLY = 0.01
"""Gain, as a share of the untrained policy's return, below which a policy is said to be hardly better."""


@dataclass(frozen=True)
class RunVerdict:
    """What a run's result is worth; `dataclasses.asdict` gives what `metrics.json` holds.

    Attributes:
        usable: Whether the trained policy is better than the untrained one.
        sentence: Why, in words and with both returns.
        controlled: Whether every output stays as near to its targets as was asked for, and nothing else runs away; None
            where the task names no targets and nothing runs away: a return says nothing of control.
        held: How near, and what runs away, in words.
    """

    usable: bool
    sentence: str
    controlled: bool | None = False
    held: str = ""


def judge_run(metrics: Mapping[str, Any], within: float = WITHIN) -> RunVerdict:
    """Compare the trained policy with the untrained one, and with what was asked for, in the scenario of both.

    Args:
        metrics: What a run ends with: `scenario`, the summaries `untrained` and `evaluation`, each with a
            `return`, None where it is not finite, and `held`, see `evaluation.tracking_criteria`; and the number of its
            `episodes`, without which there is no `gate.csv`.
        within: Mean absolute error at the end that is asked for, in ranges of targets.
    """
    usable, sentence = _compared(metrics)
    controlled, held = _held(metrics["held"], within, usable)
    return RunVerdict(usable, sentence, controlled, held)


def _compared(metrics: Mapping[str, Any]) -> tuple[bool, str]:
    untrained, trained = (_number(metrics[key]["return"]) for key in ("untrained", "evaluation"))
    where = f"in scenario '{metrics['scenario']}'"
    if not (math.isfinite(trained) and math.isfinite(untrained)):
        return False, (
            f"There is no usable result: the return {where} is not finite (trained {trained}, untrained "
            f"{untrained}); check the plant and the task's reward."
        )
    returns = f"its return {where} is {trained:.6g}, the untrained policy's {untrained:.6g}"
    if trained > untrained:
        share = (trained - untrained) / max(abs(untrained), 1e-300)
        word = "better" if share >= HARDLY else f"hardly better, by {100 * share:.2g} %,"
        return True, f"The trained policy is {word} than the untrained one: {returns}."
    how = "worse than" if trained < untrained else "no better than"
    look = (
        ", or look in gate.csv whether the model was trusted" if metrics.get("episodes", 1) else ""
    )  # not written else
    return False, (
        f"There is no usable result: the trained policy is {how} the untrained one: {returns}; train for more "
        f"episodes{look}."
    )


def distrusted(decisions: Sequence[Mapping[str, float | None]], state_error: float = math.inf) -> str:
    """Say that the model was not trusted, in how many episodes and why the last time; empty where it always was.

    Args:
        decisions: Rows of `gate.csv`.
        state_error: State error above which the gate is closed [ranges of the states].
    """
    closed = [row for row in decisions if not row["open"]]
    if not closed:
        return ""
    last, when = closed[-1], f"after {len(closed)} of {len(decisions)} episodes"
    reward, states = (_number(last[f"judged_{what}_error"]) for what in ("reward", "state"))
    opens, closes = _number(last["open_below"]), _number(last["close_above"])
    why = f"the model's reward error on real periods that it was not fitted to was {reward:.2g} per control period, "
    if reward > closes:
        why += f"above gate.close_above={closes:g}"
    elif reward > opens:
        why += f"above gate.open_below={opens:g}, at which a closed gate opens"
    elif states > state_error:
        why = f"its state error was {states:.2g} ranges, above gate.state_error={state_error:g}"
    else:
        why = "its errors on real periods were no numbers"
    return (
        f"The model was not trusted {when}, so nothing was planned on it there: after episode "
        f"{_number(last['episode']):.0f} {why}; gate.csv tells of each."
    )


def _held(held: Mapping[str, Mapping[str, float | None]], within: float, usable: bool) -> tuple[bool | None, str]:
    told, missed = [], False
    for name, given in held["share"].items():
        share, worst = _number(given), _number(held["worst"][name])
        missed |= not (share <= within and worst <= LOST * within)
        range_ = error_reference(name, held.get("turned", ()))
        told.append(f"{name} {_percent(share)} {range_} on average, {_percent(worst)} at worst")
    lines = [f"errors at the end: {'; '.join(told)} ({_percent(within)} is asked for)"]
    if not told:
        lines = [
            "the task names no targets, so nothing is said of control; all that was compared is the mean return of the "
            f"trained policy with that of the untrained one, and it {'grew' if usable else 'did not grow'}"
        ]
    lines += [
        f"{name}, which is not tracked, {_fate(held, name)} in {_percent(_number(share))} of the runs"
        for name, share in held["away"].items()
    ]
    lines += [
        f"{name} runs on in {_percent(_number(share))} of the runs, which nothing depends on"
        for name, share in held["idle"].items()
    ]
    controlled = True if told else None
    if missed or held["away"]:
        controlled = False
    word = {True: "CONTROLLED", False: "NOT CONTROLLED", None: "NOT JUDGED"}[controlled]
    return controlled, f"{word}: {'; '.join(lines)}."


def _fate(held: Mapping[str, Mapping[str, float | None]], name: str) -> str:
    return "does not come to rest" if name in held.get("swings", {}) else "runs away or does not come to rest"


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "no number"
    return f"{float(f'{100 * share:.2g}'):g} %" if share < 10 else f"{float(f'{share:.2g}'):g} times"


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
