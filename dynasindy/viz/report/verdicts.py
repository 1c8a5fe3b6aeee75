"""Verdicts on the paper's statements: each with our numbers, and whether it holds by the thresholds of `paper`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from dynasindy.evaluation.statistics import bootstrap_interval, interquartile_mean
from dynasindy.viz.report import paper
from dynasindy.viz.report.document import Finding, Statement, Verdict
from dynasindy.viz.report.results import MANY, NONE, SOME
from dynasindy.viz.style import Array

Coefficients = Mapping[str, Mapping[str, float]]
Score = Mapping[str, float | None]


def verdict(holds: bool | None, better: bool = False) -> Verdict:
    """Return the verdict on a statement.

    Args:
        holds: Whether ours is as the paper says; None where it is not measured.
        better: Whether ours, though not as the paper says, is better in the sense of the statement.
    """
    if holds is None:
        return Verdict.UNKNOWN
    return Verdict.AS if holds else Verdict.BETTER if better else Verdict.SHORT


def judge_learning(case: str, episode: Array, error: Array, opened: Array, below: float) -> Finding:
    """Judge the course of the reward error of the model.

    Args:
        case: Plant and experiment.
        episode: `(n,)` numbers of the episodes.
        error: `(n,)` reward error per period of each; not finite where the replay ran away, which is not below.
        opened: Episodes in which the model was trusted.
        below: Error at which it becomes trusted.
    """
    trusted = f"trusted from episode {opened[0]:.0f}" if len(opened) else "never trusted"
    fallen = bool(error[-1] < paper.FALL.value * error[0] and error[-1] < below)
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    first, last, most = (
        f"{one:.2g} per period" if np.isfinite(one) else "the model ran away" for one in error[[0, -1, worst]]
    )
    ours = (
        f"{first} in episode 1, {last} in episode {episode[-1]:.0f}, at worst {most} in episode {episode[worst]:.0f}; "
        f"trusted below {below:g} on held-out windows, {trusted}"
    )
    return Finding(paper.FALLS, case, ours, verdict(fallen, bool((error < below).all())))


def judge_first_model(case: str, errors: Mapping[str, float]) -> list[Finding]:
    """Judge the model of the excitation alone by the RMSE of each state [% of its range]."""
    rotors, beam = ({k: v for k, v in errors.items() if k.startswith("omega_") == turning} for turning in (True, False))
    close = paper.CLOSE.value
    not_well = verdict(max(beam.values()) >= close, max(errors.values()) < close)
    return [
        Finding(paper.ROTORS, case, _percent(rotors), verdict(max(rotors.values()) < close)),
        Finding(paper.BEAM, case, _percent(beam), not_well),
    ]


def judge_last_model(case: str, statement: Statement, errors: Mapping[str, float]) -> Finding:
    """Judge the model at the end by the RMSE of each state [% of its range]."""
    return Finding(statement, case, _percent(errors), verdict(max(errors.values()) < paper.CLOSE.value))


def judge_coefficients(case: str, model: Coefficients, truth: Coefficients) -> Finding:
    """Judge identified coefficients, by equation and function, against published ones."""
    true = {(state, name): value for state, row in truth.items() for name, value in row.items()}
    ours = {(state, name): value for state, row in model.items() for name, value in row.items()}
    hit, false = [key for key in true if key in ours], [key for key in ours if key not in true]
    worst = 100 * max((abs(ours[key] / true[key] - 1) for key in hit), default=np.inf)
    small = max((abs(model[s][name]) / max(map(abs, model[s].values())) for s, name in false), default=0.0)
    words = f"{len(hit)} of them found, the worst {worst:.2g} % off; {len(false)} functions besides"
    words += f", the largest {small:.1g} of the largest in its equation" if false else ""
    right = len(hit) == len(true) and not false and worst < paper.COEFFICIENT.value
    return Finding(paper.TABLE_2, case, words, verdict(right))


def judge_rewards(
    case: str,
    curves: Mapping[str, Array],
    to_level: Mapping[str, Sequence[float]],
    errors: Mapping[str, Sequence[float]] | None = None,
) -> list[Finding]:
    """Judge the average rewards.

    Args:
        case: Plant and experiment.
        curves: Evaluated return per setting, `(n_seeds, n_evaluations)`.
        to_level: Real episodes to the required level per setting and seed, infinite where never reached; settings that
            have no curve here are other agents without a model, all of which planning has to be ahead of.
        errors: Steady-state error at the end per setting and seed [rad], as far as it is known.
    """
    mean = {name: _middle(returns.T) for name, returns in curves.items()}
    first = {name: float(values[0]) for name, values in mean.items()}
    last = {name: float(values[-1]) for name, values in mean.items()}
    early = {
        name: float(values[: max(1, int(paper.EARLY.value * len(values)))].mean()) for name, values in mean.items()
    }
    level = {name: float(_middle(np.array(values))) for name, values in to_level.items()}
    rise = max(last.values()) - min(first.values())
    planned = [name for name in (SOME, MANY) if name in mean]
    greater = sooner = converges = alike = None
    apart, ends = _ends(errors or {})
    if NONE in mean and planned:
        greater = all(early[name] > early[NONE] for name in planned)
        model_free = [episodes for name, episodes in level.items() if name not in planned]
        sooner = max(level[name] for name in planned) < min(model_free)
        alike = max(last.values()) - min(last.values()) <= paper.NEAR.value * rise and not apart
    if len(planned) == 2:
        converges = level[MANY] < level[SOME]
    soon = bool(converges is not None and max(level[MANY], level[SOME]) <= paper.SOON.value)
    ours = (
        "; ".join(f"{name} {first[name]:.4g} to {last[name]:.4g}" for name in mean),
        f"mean of the first {100 * paper.EARLY.value:g} %: {_listed(early)}",
        f"real episodes to the level: {_listed(level)}",
        f"real episodes to the level: {_listed({name: level[name] for name in planned})}",
        f"final return: {_listed(last)}; the rise is {rise:.4g}{ends}",
    )
    verdicts = (
        verdict(all(last[name] > first[name] for name in mean)),
        verdict(greater),
        verdict(sooner),
        verdict(converges, soon),
        verdict(alike),
    )
    return [Finding(what, case, words, found) for what, words, found in zip(paper.REWARDS, ours, verdicts, strict=True)]


def judge_steps(case: str, scores: Mapping[str, Score]) -> list[Finding]:
    """Judge step tracking of the three settings by `steady_state_error/<axis>` [rad] and `overshoot/<axis>` [%]."""
    findings = []
    level = paper.LEVEL.value
    for name, axis in paper.AXES.items():
        error = {setting: _number(score[f"steady_state_error/{name}"]) for setting, score in scores.items()}
        above = {setting: _number(score[f"overshoot/{name}"]) for setting, score in scores.items()}
        planned, held = max(error[SOME], error[MANY]), error[SOME] <= level
        defined = bool(np.isfinite([above[SOME], above[NONE]]).all())  # there may be no step
        least = min(error[NONE], error[SOME])
        settles, overshoots, smallest = paper.STEPS[axis]
        both = {setting: above[setting] for setting in (NONE, SOME)}
        findings += [
            Finding(
                settles,
                case,
                f"steady-state error [rad]: {_listed(error, 'not finite')}",
                verdict(level >= planned < error[NONE]),
            ),
            Finding(
                overshoots,
                case,
                f"overshoot [%]: {_listed(both, 'not finite')}; steady-state error with 400 rollouts "
                f"{error[SOME]:.3g} rad",
                verdict(held and above[SOME] > above[NONE] if defined else None, held),
            ),
            Finding(
                smallest,
                case,
                f"{error[MANY]:.3g} rad against {least:.3g} rad",
                verdict(level >= error[MANY] < least, planned <= paper.FINE.value),
            ),
        ]
    return findings


def judge_sine(case: str, time: Array, target: Array, model: Array, direct: Array) -> list[Finding]:
    """Judge a sine, `(T, 2)` each: the reference, and the outputs with and without the model [rad]."""
    late = time >= paper.TRANSIENT.value
    size = paper.FOLLOWS.value * np.abs(target).max(0)
    ours, other = (np.sqrt(np.mean((y - target)[late] ** 2, axis=0)) for y in (model, direct))
    speed = [np.abs(np.diff(y, axis=0)) / np.diff(time)[:, None] for y in (model, direct, target)]
    motion, other_motion = ((one - speed[2])[late[1:]].mean(0) for one in speed[:2])
    findings = []
    for k, axis in enumerate(paper.AXES.values()):
        words = (
            f"RMSE after {paper.TRANSIENT.value:g} s: {ours[k]:.3g} rad of {np.abs(target).max(0)[k]:.3g} rad",
            f"RMSE {other[k]:.3g} rad; motion beyond the reference's {other_motion[k]:.3g} against {motion[k]:.3g} "
            "rad/s",
        )
        holds = (bool(ours[k] < size[k]), bool(other[k] < size[k] and other_motion[k] > motion[k]))
        findings += [Finding(what, case, w, verdict(h)) for what, w, h in zip(paper.SINE[axis], words, holds)]
    return findings


def judge_square(case: str, time: Array, target: Array, model: Array, direct: Array) -> list[Finding]:
    """Judge a square wave, `(T, 2)` each: the reference, and the outputs with and without the model [rad]."""
    findings = []
    size = np.abs(target).max(0)
    for k, axis in enumerate(paper.AXES.values()):
        (error, spike), (other, other_spike) = (_levels(time, target[:, k], y[:, k]) for y in (model, direct))
        held = bool(error < paper.FOLLOWS.value * size[k])
        levels, without = paper.SQUARE[axis]
        words = f"{error:.3g} rad over the last {paper.SETTLED.value:g} s of each level of {size[k]:.3g} rad"
        others = (
            f"error {other:.3g} against {error:.3g} rad; beyond the level after a jump {other_spike:.3g} against "
            f"{spike:.3g} rad"
        )
        larger = held and other > error
        findings += [
            Finding(levels, case, words, verdict(held)),
            Finding(without, case, others, verdict(larger and other_spike < spike, larger)),
        ]
    return findings


def _ends(errors: Mapping[str, Sequence[float]]) -> tuple[bool, str]:
    """Return whether errors at the end differ, and what is known of them in words.

    They do if no error lies within the 95 % intervals over seeds of all settings.
    """
    found = {name: np.array(values) for name, values in errors.items() if np.isfinite(values).all()}
    if not found:
        return False, ""
    if min(map(len, found.values())) < paper.SEEDS.value:
        words = ", ".join(f"{name} {' and '.join(f'{v:.3g}' for v in values)}" for name, values in found.items())
        return False, f"; error at the end [rad]: {words}, too few seeds to tell apart"
    intervals = {
        name: tuple(end.item() for end in bootstrap_interval(torch.as_tensor(values).unsqueeze(-1)))
        for name, values in found.items()
    }
    apart = max(low for low, _ in intervals.values()) > min(high for _, high in intervals.values())
    words = ", ".join(f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in intervals.items())
    return apart, f"; error at the end [rad]: {words}, {'not all of which' if apart else 'which'} overlap"


def _levels(time: Array, target: Array, y: Array) -> tuple[float, float]:
    """Return mean error at the end of each level, and the largest excursion beyond a level, in its jump's sense."""
    starts = [0, *(np.flatnonzero(np.diff(target)) + 1).tolist(), len(target)]
    errors, spikes = [], []
    for first, end in zip(starts, starts[1:], strict=False):
        late = np.arange(first, end)[time[first:end] > time[end - 1] - paper.SETTLED.value]
        errors.append(np.abs(y[late] - target[first]).mean())
        spikes.append(np.max(np.sign(target[first] - y[first]) * (y[first:end] - target[first])))
    return float(np.mean(errors)), float(max(0.0, *spikes))


def _middle(values: Array) -> Array:
    """Return the interquartile mean of the last dimension."""
    return interquartile_mean(torch.as_tensor(np.asarray(values, dtype=np.float64))).numpy()


def _listed(values: Mapping[str, float], infinite: str = "never") -> str:
    return ", ".join(f"{name} {infinite if np.isinf(value) else f'{value:.4g}'}" for name, value in values.items())


def _percent(errors: Mapping[str, float]) -> str:
    return "RMSE in % of range: " + ", ".join(f"`{name}` {error:.2g}" for name, error in errors.items())


def _number(value: float | None) -> float:
    return np.inf if value is None else float(value)
