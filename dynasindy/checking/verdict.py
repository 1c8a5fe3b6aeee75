"""What was found, in words: one line per finding, its threshold beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from dynasindy.checking.bearing import in_flight, margins_kept
from dynasindy.checking.check import Check
from dynasindy.checking.findings import Finding, Thresholds
from dynasindy.checking.record import number
from dynasindy.checking.settling import CLOSED, LONGEST
from dynasindy.checking.uncertainty import SHARE
from dynasindy.checking.words import below, error, least, most, name_of, place, sizes
from dynasindy.text import format_duration


def lost(found: Check, thresholds: Thresholds | None = None) -> torch.Tensor:
    """Return at which targets a loop that is not stable leaves them, or swings more than is allowed, `(n_targets,)`."""
    limits, size = thresholds or Thresholds(), sizes(found)
    small = (found.swings.outputs <= limits.swing * size) & (found.swings.error <= limits.error * size)
    return ~found.stable & ~small.all(-1)


def in_short(found: Check, findings: Sequence[Finding], thresholds: Thresholds | None = None) -> str:
    """Return one line that sums up the findings.

    Args:
        found: What was looked at.
        findings: What `verdict` said of it.
        thresholds: Those of the findings.
    """
    count, good, limits = len(found.targets), int(found.stable.sum()), thresholds or Thresholds()
    weak = [each.name for each in findings if each.weak]
    unknown = [each.name for each in findings if each.good is None]
    if left := int(lost(found, limits).sum()):
        return f"In short: NOT stable at {left} of {count} targets. Do not fly it as it is."
    rest = f"weak in {len(weak)} of {len(findings)} findings: {', '.join(weak)}" if weak else "no finding is weak"
    rest += f"; not known: {', '.join(unknown)}" if unknown else ""
    if good < count:
        swing = f"at {count - good} it goes on swinging, by {_swing(found, limits)[0]}"
        return f"In short: stable at {good} of {count} targets; {swing}; {rest}."
    whole = f"all {count} targets" if count > 1 else "the one target"
    return f"In short: stable at {whole}, and {rest}."


def in_figures(found: Check, findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the main figures, as `metrics.json` of a run holds them; null stands for what is infinite.

    Args:
        found: What was looked at.
        findings: What `verdict` said of it.
    """
    least: dict[str, dict[str, float | None]] = {}
    for i, name in enumerate(found.loop.signature.input_names):
        if at_targets := [each[i] for each in found.margins if each]:
            worst = {key: min(getattr(m, key) for m in at_targets) for key in ("gain", "phase", "delay", "disk")}
            worst["lower"] = max(m.lower for m in at_targets)
            least[name] = {key: number(value) for key, value in worst.items()}
    return {
        "verdict": in_short(found, findings),
        "stable": bool(found.stable.all()),
        "weak": [each.name for each in findings if each.weak],
        "unknown": [each.name for each in findings if each.good is None],
        "margins": least,
        "recovered": {" and ".join(plane.names): plane.share for plane in found.planes},
        "low": list(found.settings.low),
        "high": list(found.settings.high),
    }


def verdict(found: Check, thresholds: Thresholds | None = None) -> list[Finding]:
    """Return what was found, the stability first; an unstable loop has no margins and no noise."""
    limits = thresholds or Thresholds()
    lines = [_stability(found, limits)]
    if any(found.margins):
        lines += [*margins_kept(found, limits), *in_flight(found, limits), _noise(found, limits)]
    if len(found.steps.x):
        lines += _flights(found, limits)
    lines += [*_changes(found, limits), *_settling(found, limits)]
    return [*lines, _recovery(found, limits)] if found.planes else lines


def _stability(found: Check, limits: Thresholds) -> Finding:
    count, good, dt = len(found.targets), int(found.stable.sum()), found.loop.dt
    grid = f"{count} target{'s' * (count > 1)} of {' and '.join(found.loop.task.output_names)}"
    if good < count:
        bad = ~found.stable
        k = int(bad.nonzero()[0])
        restless = int((~found.rest.still).sum())
        more = f"; at {restless} of these targets there is no rest" if restless else ""
        _, word, output, _ = error(found, found.swings.error[bad], limits)
        which = ("such as " if count - good > 1 else "") + place(found, k)
        words = (
            f"NOT stable at {count - good} of {grid}, {which}{more}; flown there for "
            f"{format_duration(found.swings.seconds)}, {name_of(found, output)} ends within {word} of its target, and "
            f"{_circling(found, limits)}; thresholds: spectral radius < 1 at all, swings of {100 * limits.swing:g} %"
        )
        return Finding("stability", False, words)
    k = int(np.argmax(found.rest.linear.radius))
    radius = float(found.rest.linear.radius[k])
    slowest = -dt / math.log(radius) if radius else 0.0
    shown, _ = least(radius, 1.0, 4)  # of which 1 itself is not stable
    words = (
        f"stable at {'all ' * (count > 1)}{grid}; largest spectral radius {shown} at {place(found, k)}: "
        f"there the slowest part of plant and controller together dies out with a time constant of "
        f"{format_duration(slowest, digits=2)}, which is -dt / ln(radius) with the control period dt = "
        f"{format_duration(dt, digits=2)}; threshold: < 1"
    )
    return Finding("stability", True, words)


def _circling(found: Check, limits: Thresholds) -> str:
    """Return how the loop swings where it is not stable."""
    word, output, share = _swing(found, limits)
    if share == math.inf:
        return f"{name_of(found, output)} runs away, or its swings still grow"
    moved = found.swings.inputs.amax(0)
    i = int(moved.argmax())
    name = found.loop.signature.input_names[i]
    shown, _ = most(100 * share, 100 * limits.swing, 2, "g")
    return f"the loop goes on swinging, by {word}, {shown} % of its typical size, and {name} by {moved[i]:.2g}"


def _swing(found: Check, limits: Thresholds) -> tuple[str, int, float]:
    """Return the largest swing of an output where the loop is not stable, in words, its output, and typical sizes."""
    share, word, output, _ = error(found, found.swings.outputs, limits)
    return f"{word} of {name_of(found, output)} to either side", output, share


def _noise(found: Check, limits: Thresholds) -> Finding:
    spreads = [np.sqrt((gain**2) @ found.sensors**2) for gain in found.noise if gain is not None]
    worst = np.max(spreads, axis=0)
    i = int(worst.argmax())
    if not found.sensors.any():
        words = (
            "not known, as the controller's file states no noise of sensors; check.json has what a unit of it would "
            "do, and a run with sensors=bench, or on a log, states it"
        )
        return Finding("noise", None, words)
    name = found.loop.signature.input_names[i]
    moved, allowed = most(float(worst[i]), limits.noise, 3, "g")
    words = f"noise of the sensors moves {name} by {moved} (standard deviation); threshold: {allowed}"
    return Finding("noise", bool(worst[i] <= limits.noise), words)


def _flights(found: Check, limits: Thresholds) -> list[Finding]:
    names, steps, begun = found.loop.signature.input_names, found.steps, f"in steps from {found.beginning()}"
    largest, word, output, allowed = error(found, steps.steady_error, limits)
    slew, saturated = steps.slew.nan_to_num(torch.inf).amax(0), steps.saturated.amax(0)
    i, j = int(slew.argmax()), int(saturated.argmax())
    changes, most_change = most(float(slew[i]), limits.slew, 2)
    shares, most_shares = most(100 * float(saturated[j]), 100 * limits.saturated, 0)
    return [
        Finding(
            "steady error",
            largest <= limits.error,
            f"{begun} at most {word} of {name_of(found, output)}{below(found, largest, output)}; threshold: {allowed}",
        ),
        Finding(
            "slew",
            float(slew[i]) <= limits.slew,
            f"{begun} {names[i]} changes by up to {changes} in a control period; threshold: {most_change}",
        ),
        Finding(
            "saturation",
            float(saturated[j]) <= limits.saturated,
            f"{begun} {names[j]} is at its limit for up to {shares} % of "
            f"{format_duration(found.seconds)}; threshold: {most_shares} %",
        ),
    ]


def _changes(found: Check, limits: Thresholds) -> list[Finding]:
    others, lines, held = found.spread, [], len(found.spread.radius)
    single = len(others.labels) - others.draws
    moved = f"{single // 2} coefficient{'s' * (single > 2)}, {100 * SHARE:.0f} % up and down, one at a time"
    where = f"at the {held} target{'s' * (held > 1)} where the model itself is stable"
    for name, rows, words in (
        ("one coefficient", slice(others.draws, None), f"{single} plants from {moved}"),
        (
            "all coefficients",
            slice(0, others.draws),
            f"{others.draws} plants with all coefficients drawn, {others.how.words}",
        ),
    ):
        radius, labels = others.worst[rows], others.labels[rows]
        if not len(labels) or not held:
            continue
        rests = radius < 1
        unstable, k = int((~rests).sum()), int(radius.argmax())
        stays = "stable with all" if not unstable else f"NOT stable with {unstable}"
        far = "no rest" if radius[k].isinf() else f"spectral radius {least(float(radius[k]), 1.0, 4)[0]}"
        told, some = "no steady error, as none comes to rest", others.farthest[rows][rests]
        largest, word, output, allowed = error(found, some if len(some) else 0 * found.targets[:1], limits)
        if len(some):
            told = f"steady error at most {word} of {name_of(found, output)}{below(found, largest, output)}"
            if unstable:
                do, are = ("does", "is") if unstable == 1 else ("do", "are")
                told += f", of which {unstable} of {len(labels)} {are} left out that {do} not come to rest"
        away = found.ran_away if name == "all coefficients" else 0
        if away:
            told += f"; {away} run{'s' * (away == 1)} away in the step of steps.png"
        lines.append(
            Finding(
                name,
                not (unstable or away) and largest <= limits.error,
                f"{words}, {where}: {stays} of these {len(labels)} plants, worst {labels[k]} ({far}), {told}; "
                f"threshold: stable, {allowed}",
            )
        )
    return lines


def _settling(found: Check, limits: Thresholds) -> list[Finding]:
    times, stays = found.spread.settling, found.spread.worst < 1  # what is not stable has no end of a step
    if times is None or not bool(stays.any()):
        return []
    others = times[:, :-1].amax(0).where(stays, -1.0)
    slowest, own = float(others.amax()), float(times[:, -1].amax())
    label, count = found.spread.labels[int(others.argmax())], int(stays.sum())
    left = "" if bool(stays.all()) else " that are stable"
    end = f"more than {format_duration(LONGEST * found.seconds, digits=2)}"
    shown, model = (format_duration(time, digits=3) if time < math.inf else end for time in (slowest, own))
    words = (
        f"between opposite targets, limits of inputs apart, all but {100 * CLOSED:g} % of the way is done after "
        f"{model} with the model, and after {shown} with the slowest of {count} plants with other "
        f"coefficients{left}, {label}; threshold: {format_duration(limits.settled * found.seconds, digits=3)}"
    )
    return [Finding("settling", slowest <= limits.settled * found.seconds, words)]


def _recovery(found: Check, limits: Thresholds) -> Finding:
    shares = [plane.share for plane in found.planes]
    pairs = [least(100 * share, 100 * limits.recovered, 0) for share in shares]
    names = [f"{plane.names[0]} and {plane.names[1]}" for plane in found.planes]
    words = ", ".join(f"{share} % in {both}" for (share, _), both in zip(pairs, names, strict=True))
    worst, tried = shares.index(min(shares)), found.planes[0].back.numel()
    stays, left, output, _ = error(found, found.planes[0].steady_error.unsqueeze(0), limits)
    return Finding(
        "recovery",
        shares[worst] >= limits.recovered,
        f"comes back from errors of up to {found.settings.reach:g} times the typical size of each state: "
        f"{words}, of {tried} errors in each such plane; the error that stays where it rests is {left} of "
        f"{name_of(found, output)}{below(found, stays, output)}; threshold: {pairs[worst][1]} %",
    )
