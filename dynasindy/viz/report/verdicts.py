"""Verdicts on the paper's statements: each with our numbers, and whether it holds by the thresholds of `paper`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
import torch

from dynasindy.evaluation.statistics import bootstrap_interval, interquartile_mean
from dynasindy.viz.report import paper
from dynasindy.viz.report.document import Finding, Verdict
from dynasindy.viz.report.results import MANY, NONE, SOME
from dynasindy.viz.style import Array

Coefficients = Mapping[str, Mapping[str, float]]
Score = Mapping[str, float | None]


def judge_statement(ours: str, holds: bool | None, better: bool = False) -> Finding:
    """Return the judgement on a statement.

    Args:
        ours: Our numbers.
        holds: Whether ours is as the paper says; None where it is not measured.
        better: Whether ours, though not as the paper says, is better in the sense of the statement.
    """
    if holds is None:
        return Finding(ours)
    return Finding(ours, Verdict.AS if holds else Verdict.BETTER if better else Verdict.SHORT)


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
    return [judge_statement(ours, fallen, bool((error < below).all()))]


def judge_first_model(errors: Mapping[str, float]) -> list[Finding]:
    """Judge the model of the excitation alone by the RMSE of each state [% of its range]."""
    rotors, beam = ({k: v for k, v in errors.items() if k.startswith("omega_") == turning} for turning in (True, False))
    close = paper.CLOSE.value
    difficult = judge_statement(_percent(beam), max(beam.values()) >= close, max(errors.values()) < close)
    return [judge_statement(_percent(rotors), max(rotors.values()) < close), difficult]


def judge_last_model(errors: Mapping[str, float]) -> Finding:
    """Judge the model at the end by the RMSE of each state [% of its range]."""
    return judge_statement(_percent(errors), max(errors.values()) < paper.CLOSE.value)


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


def judge_rewards(
    curves: Mapping[str, Array],
    to_level: Mapping[str, Sequence[float]],
    errors: Mapping[str, Sequence[float]] | None = None,
) -> list[Finding]:
    """Judge the average rewards.

    Args:
        curves: Evaluated return per setting, `(n_seeds, n_evaluations)`.
        to_level: Real episodes to the required level per setting and seed, infinite where never reached; settings that
            have no curve here are other agents without a model, all of which planning has to be ahead of.
        errors: Steady-state error at the end per setting and seed [rad], as far as it is known.
    """
    mean = {name: _middle(returns.T) for name, returns in curves.items()}
    first, last = ({name: float(values[k]) for name, values in mean.items()} for k in (0, -1))
    early = {
        name: float(values[: max(1, int(paper.EARLY.value * len(values)))].mean()) for name, values in mean.items()
    }
    level = {name: float(_middle(values)) for name, values in to_level.items()}
    rise = max(last.values()) - min(first.values())
    planned = [name for name in (SOME, MANY) if name in mean]
    greater = sooner = converges = alike = None
    apart, ends = _compare_ends(errors or {})
    if NONE in mean and planned:
        greater = all(early[name] > early[NONE] for name in planned)
        sooner = max(level[name] for name in planned) < min(level[name] for name in level if name not in planned)
        alike = max(last.values()) - min(last.values()) <= paper.NEAR.value * rise and not apart
    if len(planned) == 2:
        converges = level[MANY] < level[SOME]
    soon = converges is not None and max(level[MANY], level[SOME]) <= paper.SOON.value
    return [
        judge_statement(
            "; ".join(f"{name} {first[name]:.4g} to {last[name]:.4g}" for name in mean),
            all(last[name] > first[name] for name in mean),
        ),
        judge_statement(f"mean of the first {100 * paper.EARLY.value:g} %: {_listed(early)}", greater),
        judge_statement(f"real episodes to the level: {_listed(level)}", sooner),
        judge_statement(
            f"real episodes to the level: {_listed({name: level[name] for name in planned})}", converges, soon
        ),
        judge_statement(f"final return: {_listed(last)}; the rise is {rise:.4g}{ends}", alike),
    ]


def judge_steps(scores: Mapping[str, Score]) -> list[Finding]:
    """Judge step tracking of the three settings by `steady_state_error/<axis>` [rad] and `overshoot/<axis>` [%]."""
    judgements, level = [], paper.LEVEL.value
    for name in paper.AXES:
        error, above = (
            {setting: _number(score[f"{metric}/{name}"]) for setting, score in scores.items()}
            for metric in ("steady_state_error", "overshoot")
        )
        planned, holds = max(error[SOME], error[MANY]), error[SOME] <= level
        defined = bool(np.isfinite([above[SOME], above[NONE]]).all())  # there may be no step
        words = f"steady-state error [rad]: {_listed(error, 'not finite')}"
        judgements += [
            judge_statement(words, level >= planned < error[NONE]),
            judge_statement(
                f"overshoot [%]: {_listed({one: above[one] for one in (NONE, SOME)}, 'not finite')}",
                holds and above[SOME] > above[NONE] if defined else None,
                holds,
            ),
            judge_statement(words, level >= error[MANY] < min(error[NONE], error[SOME]), planned <= paper.FINE.value),
        ]
    return judgements


def judge_sine(time: Array, target: Array, model: Array, direct: Array) -> list[Finding]:
    """Judge a sine, `(T, 2)` each: the reference, and the outputs with and without the model [rad]."""
    late = time >= paper.TRANSIENT.value
    size = np.abs(target).max(0)
    rmse, other = (np.sqrt(np.mean((y - target)[late] ** 2, axis=0)) for y in (model, direct))
    speed = [np.abs(np.diff(y, axis=0)) / np.diff(time)[:, None] for y in (model, direct, target)]
    motion, other_motion = ((one - speed[2])[late[1:]].mean(0) for one in speed[:2])
    judgements = []
    for k in range(len(size)):
        follows, other_follows = (bool(one[k] < paper.FOLLOWS.value * size[k]) for one in (rmse, other))
        extra = f"motion beyond the reference's {other_motion[k]:.3g} against {motion[k]:.3g} rad/s"
        judgements += [
            judge_statement(f"RMSE after {paper.TRANSIENT.value:g} s: {rmse[k]:.3g} rad of {size[k]:.3g} rad", follows),
            judge_statement(f"RMSE {other[k]:.3g} rad; {extra}", other_follows and bool(other_motion[k] > motion[k])),
        ]
    return judgements


def judge_square(time: Array, target: Array, model: Array, direct: Array) -> list[Finding]:
    """Judge a square wave, `(T, 2)` each: the reference, and the outputs with and without the model [rad]."""
    judgements = []
    for k, size in enumerate(np.abs(target).max(0)):
        (error, spike), (other, other_spike) = (_levels(time, target[:, k], y[:, k]) for y in (model, direct))
        holds = bool(error < paper.FOLLOWS.value * size)
        words = f"{error:.3g} rad over the last {paper.SETTLED.value:g} s of each level of {size:.3g} rad"
        beyond = f"beyond the level after a jump {other_spike:.3g} against {spike:.3g} rad"
        larger = holds and other > error
        judgements += [
            judge_statement(words, holds),
            judge_statement(
                f"error {other:.3g} against {error:.3g} rad; {beyond}", larger and other_spike < spike, larger
            ),
        ]
    return judgements


def _compare_ends(errors: Mapping[str, Sequence[float]]) -> tuple[bool, str]:
    """Return whether errors at the end differ, and what is known of them in words.

    They do if no error lies within the 95 % intervals over seeds of all settings.
    """
    finite = {name: values for name, values in errors.items() if np.isfinite(values).all()}
    if not finite:
        return False, ""
    if min(map(len, finite.values())) < paper.SEEDS.value:
        words = ", ".join(f"{name} {' and '.join(f'{v:.3g}' for v in values)}" for name, values in finite.items())
        return False, f"; error at the end [rad]: {words}, too few seeds to tell apart"
    intervals = {
        name: tuple(end.item() for end in bootstrap_interval(torch.tensor(values, dtype=torch.float64).unsqueeze(-1)))
        for name, values in finite.items()
    }
    apart = max(low for low, _ in intervals.values()) > min(high for _, high in intervals.values())
    words = ", ".join(f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in intervals.items())
    return apart, f"; error at the end [rad]: {words}, {'not all of which' if apart else 'which'} overlap"


def _levels(time: Array, target: Array, y: Array) -> tuple[float, float]:
    """Return mean error at the end of each level, and the largest excursion beyond a level, in its jump's sense."""
    errors, spikes = [], [0.0]
    for first, end in pairwise([0, *(np.flatnonzero(np.diff(target)) + 1).tolist(), len(target)]):
        late = np.arange(first, end)[time[first:end] > time[end - 1] - paper.SETTLED.value]
        errors.append(np.abs(y[late] - target[first]).mean())
        spikes.append(np.max(np.sign(target[first] - y[first]) * (y[first:end] - target[first])))
    return float(np.mean(errors)), float(max(spikes))


def _middle(values: Iterable[float] | Array) -> Array:
    """Return the interquartile mean of the last dimension."""
    return interquartile_mean(torch.as_tensor(np.asarray(values, dtype=np.float64))).numpy()


def _listed(values: Mapping[str, float], infinite: str = "never") -> str:
    return ", ".join(f"{name} {infinite if np.isinf(value) else f'{value:.4g}'}" for name, value in values.items())


def _percent(errors: Mapping[str, float]) -> str:
    return "RMSE in % of range: " + ", ".join(f"`{name}` {error:.2g}" for name, error in errors.items())


def _number(value: float | None) -> float:
    return np.inf if value is None else float(value)
