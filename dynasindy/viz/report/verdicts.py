"""Verdicts on the paper's statements: each with our numbers, and whether it holds by the thresholds of `paper`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
import torch

from dynasindy.evaluation.statistics import interquartile_mean
from dynasindy.viz.report import paper
from dynasindy.viz.report.document import Finding, Verdict
from dynasindy.viz.report.results import MANY, NONE, SOME
from dynasindy.viz.style import Array

Coefficients = Mapping[str, Mapping[str, float]]
Score = Mapping[str, float | None]


def judge_statement(ours: str, holds: bool | None, same: bool = False) -> Finding:
    """Return the judgement on a statement.

    Args:
        ours: Our numbers.
        holds: Whether they show what the paper says; None where it is not measured.
        same: Whether, where they do not, what is compared is equally good.
    """
    if holds is None:
        return Finding(ours)
    return Finding(ours, Verdict.HOLDS if holds else Verdict.SAME if same else Verdict.SHORT)


def judge_learning(episode: Array, error: Array, opened: Array, below: float) -> list[Finding]:
    """Judge the course of the reward error of the model.

    Args:
        episode: `(n,)` numbers of the episodes.
        error: `(n,)` reward error per period of each; not finite where the replay ran away, which is not below.
        opened: Episodes in which the model was trusted.
        below: Error at which it becomes trusted.
    """
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    first, last, most = (f"{error[k]:.2g} in episode {episode[k]:.0f}" for k in (0, -1, worst))
    trusted = f"trusted from episode {opened[0]:.0f}" if len(opened) else "never trusted"
    ours = f"per period {first}, {last}, at worst {most}; {trusted}, below {below:g} on held-out windows"
    fallen = bool(error[-1] < paper.FALL.value * error[0] and error[-1] < below)
    return [judge_statement(ours, fallen or bool((error < below).all()))]


def judge_first_model(errors: Mapping[str, float]) -> list[Finding]:
    """Judge the model of the excitation alone by the RMSE of each rotor speed [% of its range]."""
    return [judge_last_model({name: error for name, error in errors.items() if name.startswith("omega_")})]


def judge_last_model(errors: Mapping[str, float]) -> Finding:
    """Judge a model by the RMSE of each state [% of its range]."""
    words = ", ".join(f"`{name}` {error:.2g}" for name, error in errors.items())
    return judge_statement(f"RMSE in % of range: {words}", max(errors.values()) < paper.CLOSE.value)


def judge_coefficients(model: Coefficients, truth: Coefficients) -> list[Finding]:
    """Judge identified coefficients, by equation and function, against published ones."""
    true, ours = (
        {(state, name): value for state, row in one.items() for name, value in row.items()} for one in (truth, model)
    )
    hit, false = [key for key in true if key in ours], [key for key in ours if key not in true]
    worst = 100 * max((abs(ours[key] / true[key] - 1) for key in hit), default=np.inf)
    small = max((abs(model[s][name]) / max(map(abs, model[s].values())) for s, name in false), default=0.0)
    words = f"{len(hit)} of them found, the worst {worst:.2g} % off; {len(false)} functions besides"
    words += f", the largest {small:.1g} of the largest in its equation" if false else ""
    return [judge_statement(words, len(hit) == len(true) and not false and worst < paper.COEFFICIENT.value)]


def judge_rewards(curves: Mapping[str, Array], to_level: Mapping[str, Sequence[float]]) -> list[Finding]:
    """Judge the average rewards.

    Args:
        curves: Evaluated return per setting, `(n_seeds, n_evaluations)`.
        to_level: Real episodes to the required level per setting and seed, infinite where never reached; settings that
            have no curve here are other agents without a model, all of which planning has to be ahead of.
    """
    mean = {name: _middle(returns.T) for name, returns in curves.items()}
    early = {
        name: float(values[: max(1, int(paper.EARLY.value * len(values)))].mean()) for name, values in mean.items()
    }
    level = {name: float(_middle(values)) for name, values in to_level.items()}
    planned = [name for name in (SOME, MANY) if name in mean]
    greater = sooner = converges = None
    soon = max((level[name] for name in planned), default=np.inf) <= paper.SOON.value
    if NONE in mean and planned:
        greater = all(early[name] > early[NONE] for name in planned)
        sooner = max(level[name] for name in planned) < min(level[name] for name in level if name not in planned)
    if len(planned) == 2:
        converges = level[MANY] < level[SOME]
    both = _listed({name: level[name] for name in planned})
    return [
        judge_statement(f"mean of the first {100 * paper.EARLY.value:g} %: {_listed(early)}", greater),
        judge_statement(f"real episodes to the level: {_listed(level)}", sooner),
        judge_statement(f"real episodes to the level: {both}", converges, soon),
    ]


def judge_steps(scores: Mapping[str, Score]) -> list[Finding]:
    """Judge step tracking of the three settings by their `steady_state_error/<axis>` [rad]."""
    judgements, level = [], paper.LEVEL.value
    for name in paper.AXES:
        error = {setting: _number(score[f"steady_state_error/{name}"]) for setting, score in scores.items()}
        planned = max(error[SOME], error[MANY])
        words = f"steady-state error [rad]: {_listed(error, 'not finite')}"
        smallest = level >= error[MANY] < min(error[NONE], error[SOME])
        judgements += [
            judge_statement(words, level >= planned < error[NONE]),
            judge_statement(words, smallest, planned <= paper.FINE.value),
        ]
    return judgements


def judge_sine(time: Array, target: Array, output: Array) -> list[Finding]:
    """Judge a sine, `(T, 2)` each: the reference, and the outputs with the model [rad]."""
    late = time >= paper.TRANSIENT.value
    rmse = np.sqrt(np.mean((output - target)[late] ** 2, axis=0))
    words = f"RMSE after {paper.TRANSIENT.value:g} s: {{:.3g}} rad of {{:.3g}} rad"
    pairs = zip(rmse, np.abs(target).max(0), strict=True)
    return [judge_statement(words.format(one, size), bool(one < paper.FOLLOWS.value * size)) for one, size in pairs]


def judge_square(time: Array, target: Array, output: Array) -> list[Finding]:
    """Judge a square wave, `(T, 2)` each: the reference, and the outputs with the model [rad]."""
    words = f"{{:.3g}} rad over the last {paper.SETTLED.value:g} s of each level of {{:.3g}} rad"
    judgements = []
    for k, size in enumerate(np.abs(target).max(0)):
        error = _at_levels(time, target[:, k], output[:, k])
        judgements.append(judge_statement(words.format(error, size), error < paper.FOLLOWS.value * size))
    return judgements


def _at_levels(time: Array, target: Array, y: Array) -> float:
    """Return the mean error at the end of each level."""
    errors = []
    for first, end in pairwise([0, *(np.flatnonzero(np.diff(target)) + 1).tolist(), len(target)]):
        late = np.arange(first, end)[time[first:end] > time[end - 1] - paper.SETTLED.value]
        errors.append(np.abs(y[late] - target[first]).mean())
    return float(np.mean(errors))


def _middle(values: Iterable[float] | Array) -> Array:
    """Return the interquartile mean of the last dimension."""
    return interquartile_mean(torch.as_tensor(np.asarray(values, dtype=np.float64))).numpy()


def _listed(values: Mapping[str, float], infinite: str = "never") -> str:
    return ", ".join(f"{name} {infinite if np.isinf(value) else f'{value:.4g}'}" for name, value in values.items())


def _number(value: float | None) -> float:
    return np.inf if value is None else float(value)
