"""What the paper's control figures show, against ours: each statement with our numbers and whether it holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from dynasindy.evaluation.statistics import bootstrap_interval, interquartile_mean
from dynasindy.viz.report.document import Finding, Statement
from dynasindy.viz.report.sources import SETTINGS
from dynasindy.viz.report.thresholds import (
    EARLY,
    FINE,
    FOLLOWS,
    LEVEL,
    NEAR,
    SEEDS,
    SETTLED,
    SOON,
    TRANSIENT,
    judged,
)
from dynasindy.viz.style import Array

NONE, SOME, MANY = SETTINGS.values()
AXES = ("azimuth", "pitch")
SOONER = "Planning on the model lets the policy learn from fewer real episodes."
EXACT = "With planning the policy holds a reference more exactly than without."
WAVES = "With the model, sines and square waves are followed."
Score = Mapping[str, float | None]
REWARDS = (
    Statement("rewards are low at first and rise"),
    Statement("planning has the greater rewards early", SOONER),
    Statement("planning reaches the required level sooner", SOONER),
    Statement(f"800 rollouts converge sooner than 400, there in about {SOON.value:g} episodes", SOONER),
    Statement(f"all settings end nearly the same (returns within {100 * NEAR.value:g} % of the rise, errors alike)"),
)
STEPS = {
    axis: (
        Statement(f"{axis}: without planning it settles further from the reference than with it{offset}", EXACT),
        Statement(f"{axis}: 400 rollouts overshoot more than no planning"),
        Statement(f"{axis}: 800 rollouts have the smallest steady-state error", EXACT),
    )
    for axis, offset in zip(AXES, (" (there by about 0.08 rad)", ""), strict=True)
}
SINE = {
    axis: (
        Statement(f"{axis}: with the model the sine is followed (RMSE under {100 * FOLLOWS.value:g} % of it)", WAVES),
        Statement(f"{axis}: without the model the sine is followed too, with more oscillation"),
    )
    for axis in AXES
}
SQUARE = {
    axis: (
        Statement(f"{axis}: with the model each level is held with little steady-state error", WAVES),
        Statement(f"{axis}: without the model the steady-state error is larger, and the spikes are smaller"),
    )
    for axis in AXES
}
"""What the figures of the paper show, by axis where they do so of both."""


def rewards_agree(
    case: str,
    curves: Mapping[str, Array],
    to_level: Mapping[str, Sequence[float]],
    errors: Mapping[str, Sequence[float]] | None = None,
) -> list[Finding]:
    """Judge the average rewards.

    Args:
        case: What they are of, in words.
        curves: Evaluated return per setting, `(n_seeds, n_evaluations)`.
        to_level: Real episodes to the required level per setting and seed, infinite where never reached; settings that
            have no curve here are other agents without a model, all of which planning has to be ahead of.
        errors: Steady-state error at the end per setting and seed [rad], as far as it is known.
    """
    mean = {name: _middle(returns.T) for name, returns in curves.items()}
    early = {name: float(values[: max(1, int(EARLY.value * len(values)))].mean()) for name, values in mean.items()}
    ends = {name: (float(values[0]), float(values[-1])) for name, values in mean.items()}
    level = {name: float(_middle(np.array(values))) for name, values in to_level.items()}
    rise = max(last for _, last in ends.values()) - min(first for first, _ in ends.values())
    last = {name: pair[1] for name, pair in ends.items()}
    planned = [name for name in (SOME, MANY) if name in mean]
    both = planned == [SOME, MANY]
    compared = NONE in mean and bool(planned)
    modelless = [episodes for name, episodes in level.items() if name not in planned]
    sooner = compared and max(level[name] for name in planned) < min(modelless)
    apart, told = _ends(errors or {})
    rises, greater, level_sooner, converges, alike = REWARDS
    return [
        rises.of(
            case,
            "; ".join(f"{name} {first:.4g} to {final:.4g}" for name, (first, final) in ends.items()),
            judged(all(final > first for first, final in ends.values())),
        ),
        greater.of(
            case,
            f"mean of the first {100 * EARLY.value:g} %: {_listed(early)}",
            judged(all(early[name] > early[NONE] for name in planned) if compared else None),
        ),
        level_sooner.of(
            case,
            f"real episodes to the level: {_listed(level)}",
            judged(sooner if compared else None),
        ),
        converges.of(
            case,
            f"real episodes to the level: {_listed(level, planned)}",
            judged(level[MANY] < level[SOME], max(level[MANY], level[SOME]) <= SOON.value) if both else judged(None),
        ),
        alike.of(
            case,
            f"final return: {_listed(last)}; the rise is {rise:.4g}{told}",
            judged(max(last.values()) - min(last.values()) <= NEAR.value * rise and not apart if compared else None),
        ),
    ]


def steps_agree(case: str, scores: Mapping[str, Score]) -> list[Finding]:
    """Judge step tracking of the three settings by `steady_state_error/<axis>` [rad] and `overshoot/<axis>` [%]."""
    findings = []
    for axis, name in zip(AXES, ("alpha_a", "alpha_p"), strict=True):
        error = {setting: _number(score[f"steady_state_error/{name}"]) for setting, score in scores.items()}
        above = {setting: _number(score[f"overshoot/{name}"]) for setting, score in scores.items()}
        planned, held = max(error[SOME], error[MANY]), error[SOME] <= LEVEL.value
        defined = bool(np.isfinite([above[SOME], above[NONE]]).all())  # there may be no step
        settles, overshoots, smallest = STEPS[axis]
        findings += [
            settles.of(
                case,
                f"steady-state error [rad]: {_listed(error, none='not finite')}",
                judged(LEVEL.value >= planned < error[NONE]),
            ),
            overshoots.of(
                case,
                f"overshoot [%]: {_listed(above, (NONE, SOME), 'not finite')}; steady-state error with 400 rollouts "
                f"{error[SOME]:.3g} rad",
                judged(held and above[SOME] > above[NONE] if defined else None, held),
            ),
            smallest.of(
                case,
                f"{error[MANY]:.3g} rad against {min(error[NONE], error[SOME]):.3g} rad",
                judged(LEVEL.value >= error[MANY] < min(error[NONE], error[SOME]), planned <= FINE.value),
            ),
        ]
    return findings


def sine_agrees(case: str, time: Array, target: Array, model: Array, direct: Array) -> list[Finding]:
    """Judge a sine, `(T, 2)` each: the reference, and the outputs with and without the model [rad]."""
    late = time >= TRANSIENT.value
    size = np.abs(target).max(0)
    ours, other = (np.sqrt(np.mean((y - target)[late] ** 2, axis=0)) for y in (model, direct))
    sway, other_sway = (_sway(time, y, target)[late[1:]].mean(0) for y in (model, direct))
    findings = []
    for k, axis in enumerate(AXES):
        followed, without = SINE[axis]
        findings += [
            followed.of(
                case,
                f"RMSE after {TRANSIENT.value:g} s: {ours[k]:.3g} rad of {size[k]:.3g} rad",
                judged(bool(ours[k] < FOLLOWS.value * size[k])),
            ),
            without.of(
                case,
                f"RMSE {other[k]:.3g} rad; motion beyond the reference's {other_sway[k]:.3g} against "
                f"{sway[k]:.3g} rad/s",
                judged(bool(other[k] < FOLLOWS.value * size[k] and other_sway[k] > sway[k])),
            ),
        ]
    return findings


def square_agrees(case: str, time: Array, target: Array, model: Array, direct: Array) -> list[Finding]:
    """Judge a square wave, `(T, 2)` each: the reference, and the outputs with and without the model [rad]."""
    findings = []
    size = np.abs(target).max(0)
    for k, axis in enumerate(AXES):
        (error, spike), (other, other_spike) = (_levels(time, target[:, k], y[:, k]) for y in (model, direct))
        held = error < FOLLOWS.value * size[k]
        levels, without = SQUARE[axis]
        findings += [
            levels.of(
                case,
                f"{error:.3g} rad over the last {SETTLED.value:g} s of each level of {size[k]:.3g} rad",
                judged(held),
            ),
            without.of(
                case,
                f"error {other:.3g} against {error:.3g} rad; beyond the level after a jump {other_spike:.3g} against "
                f"{spike:.3g} rad",
                judged(held and other > error and other_spike < spike, held and other > error),
            ),
        ]
    return findings


def _ends(errors: Mapping[str, Sequence[float]]) -> tuple[bool, str]:
    """Return whether errors at the end are told apart, and what is known of them in words.

    They are if no error lies within the 95 % intervals over seeds of all settings.
    """
    found = {name: np.array(values) for name, values in errors.items() if np.isfinite(values).all()}
    if not found:
        return False, ""
    few = min(map(len, found.values())) < SEEDS.value
    if few:
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
        late = np.arange(first, end)[time[first:end] > time[end - 1] - SETTLED.value]
        errors.append(np.abs(y[late] - target[first]).mean())
        spikes.append(np.max(np.sign(target[first] - y[first]) * (y[first:end] - target[first])))
    return float(np.mean(errors)), float(max(0.0, *spikes))


def _sway(time: Array, y: Array, target: Array) -> Array:
    """Return the speed of an output beyond that of its reference, `(T - 1, 2)` [rad/s]."""
    speed, wanted = (np.abs(np.diff(x, axis=0)) / np.diff(time)[:, None] for x in (y, target))
    return speed - wanted


def _middle(values: Array) -> Array:
    """Return the interquartile mean of the last dimension."""
    return interquartile_mean(torch.as_tensor(np.asarray(values, dtype=np.float64))).numpy()


def _listed(values: Mapping[str, float], names: Sequence[str] | None = None, none: str = "never") -> str:
    chosen = {name: values[name] for name in names or values if name in values}
    return ", ".join(f"{name} {none if np.isinf(value) else f'{value:.4g}'}" for name, value in chosen.items())


def _number(value: float | None) -> float:
    return np.inf if value is None else float(value)
