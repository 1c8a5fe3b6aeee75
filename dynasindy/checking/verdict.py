"""What was found, in words: one line per finding, its threshold beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from dynasindy.checking.check import Check
from dynasindy.checking.findings import Finding
from dynasindy.checking.flights import TOLERANCE
from dynasindy.checking.flown import GAINS, LATEST, Flown
from dynasindy.checking.margins import Margins
from dynasindy.checking.record import number
from dynasindy.checking.uncertainty import SHARE
from dynasindy.durations import in_words


@dataclass(frozen=True)
class Thresholds:
    """Where a finding begins to be a weak one.

    Attributes:
        gain: Least gain margin upwards; downwards it is the inverse.
        phase: Least phase margin [deg].
        delay: Least delay margin [control periods].
        disk: Least disk margin.
        swing: Largest swing to either side where the loop is not stable [typical sizes of the outputs].
        error: Largest steady error [typical sizes of the outputs].
        recovered: Least share of initial errors from which the plant comes back.
        noise: Largest standard deviation of an input under the noise of the sensors.
        slew: Largest change of an input in a control period.
        saturated: Largest share of a step at the limit of an input.
    """

    gain: float = 2.0
    phase: float = 30.0
    delay: float = 1.0
    disk: float = 0.5
    swing: float = 0.01
    error: float = TOLERANCE
    recovered: float = 0.9
    noise: float = 0.05
    slew: float = 1.0
    saturated: float = 0.2


def lost(found: Check, thresholds: Thresholds | None = None) -> torch.Tensor:
    """Return at which targets a loop that is not stable leaves them, or swings more than is allowed, `(n_targets,)`."""
    limits, size = thresholds or Thresholds(), _sizes(found)
    small = (found.swings.outputs <= limits.swing * size) & (found.swings.error <= limits.error * size)
    return ~found.stable & ~small.all(-1)


def in_short(found: Check, findings: Sequence[Finding], thresholds: Thresholds | None = None) -> str:
    """Return one line that sums up the findings.

    Args:
        found: What was looked at.
        findings: What `verdict` said of it.
        thresholds: Those of the findings.
    """
    count, good = len(found.targets), int(found.stable.sum())
    weak = [each.name for each in findings if each.weak]
    unknown = [each.name for each in findings if each.good is None]
    if left := int(lost(found, thresholds).sum()):
        return f"In short: NOT stable at {left} of {count} targets. Do not fly it as it is."
    rest = f"weak in {len(weak)} of {len(findings)} findings: {', '.join(weak)}" if weak else "no finding is weak"
    rest += f"; not known: {', '.join(unknown)}" if unknown else ""
    if good < count:
        swing = f"at {count - good} it goes on swinging, by {_swing(found)[0]}"
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
        lines += [*_margins(found, limits), *_flown(found, limits), _noise(found, limits)]
    if len(found.steps.x):
        lines += _flights(found, limits)
    lines += _changes(found, limits)
    return [*lines, _recovery(found, limits)] if found.planes else lines


def _stability(found: Check, limits: Thresholds) -> Finding:
    count, good, dt = len(found.targets), int(found.stable.sum()), found.loop.dt
    grid = f"{count} target{'s' * (count > 1)} of {' and '.join(found.loop.task.output_names)}"
    if good < count:
        bad = ~found.stable
        k = int(bad.nonzero()[0])
        restless = int((~found.rest.still).sum())
        more = f"; at {restless} of these targets there is no rest" if restless else ""
        _, error, output = _error(found, found.swings.error[bad])
        which = ("such as " if count - good > 1 else "") + _place(found, k)
        words = (
            f"NOT stable at {count - good} of {grid}, {which}{more}; flown there for "
            f"{in_words(found.swings.seconds)}, {_name(found, output)} ends within {error} of its target, and "
            f"{_circling(found)}; thresholds: spectral radius < 1 at all, swings of {100 * limits.swing:g} %"
        )
        return Finding("stability", False, words)
    k = int(np.argmax(found.rest.linear.radius))
    radius = float(found.rest.linear.radius[k])
    slowest = -dt / math.log(radius) if radius else 0.0
    words = (
        f"stable at {'all ' * (count > 1)}{grid}; largest spectral radius {radius:.4f} at {_place(found, k)}: "
        f"there the slowest part of plant and controller together dies out with a time constant of "
        f"{in_words(slowest, digits=2)}, which is -dt / ln(radius) with the control period dt = "
        f"{in_words(dt, digits=2)}; threshold: < 1"
    )
    return Finding("stability", True, words)


def _circling(found: Check) -> str:
    """Return how the loop swings where it is not stable."""
    word, output, share = _swing(found)
    if share == math.inf:
        return f"{_name(found, output)} runs away, or its swings still grow"
    moved = found.swings.inputs.amax(0)
    i = int(moved.argmax())
    name = found.loop.signature.input_names[i]
    return (
        f"the loop goes on swinging, by {word}, {100 * share:.2g} % of its typical size, and {name} by {moved[i]:.2g}"
    )


def _swing(found: Check) -> tuple[str, int, float]:
    """Return the largest swing of an output where the loop is not stable, in words, its output, and typical sizes."""
    share, word, output = _error(found, found.swings.outputs)
    return f"{word} of {_name(found, output)} to either side", output, share


def _margins(found: Check, limits: Thresholds) -> list[Finding]:
    dt, names = found.loop.dt, found.loop.signature.input_names
    rows = [(k, i, m) for k, target in enumerate(found.margins) for i, m in enumerate(target)]

    slow = "" if found.flown is None else ", in movements so small that dry friction damps them"

    def _least(values: Sequence[float]) -> tuple[float, str]:
        place = int(np.argmin(values))
        k, i, _ = rows[place]
        return values[place], f"of {names[i]} at {_place(found, k)}{slow}"

    def _all(read: object) -> list[float]:
        assert callable(read)
        return [float(read(m)) for _, _, m in rows]

    def _wider(margin: Margins) -> float:
        return 1 / margin.lower if margin.lower else math.inf

    up, where_up = _least(_all(lambda m: m.gain))
    down, where_down = _least(_all(_wider))
    phase, where_phase = _least(_all(lambda m: m.phase))
    delay, where_delay = _least([d / dt for d in _all(lambda m: m.delay)])
    disk, where_disk = _least(_all(lambda m: m.disk))
    return [
        Finding(
            "gain margin",
            up >= limits.gain,
            f"the least is {_factor(up)} {where_up}; threshold: {limits.gain:g} ({_db(limits.gain):.0f} dB)",
        ),
        Finding(
            "gain reduction",
            down >= limits.gain,
            f"{'may fall to nothing' if down == math.inf else f'may fall to {1 / down:.2f}'} {where_down}; "
            f"threshold: {1 / limits.gain:g}",
        ),
        Finding(
            "phase margin",
            phase >= limits.phase,
            f"the least is {phase:.0f} deg {where_phase}; threshold: {limits.phase:g} deg",
        ),
        Finding(
            "delay margin",
            delay >= limits.delay,
            f"the least is {delay:.2f} control periods, {1000 * delay * dt:.0f} ms, {where_delay}; "
            f"threshold: {limits.delay:g} control period{'s' if limits.delay != 1 else ''}",
        ),
        Finding(
            "disk margin", disk >= limits.disk, f"the least is {disk:.2f} {where_disk}; threshold: {limits.disk:g}"
        ),
    ]


def _flown(found: Check, limits: Thresholds) -> list[Finding]:
    name, margins, dt = "large movements", found.flown, found.loop.dt
    if margins is None:
        return []
    if not margins.gain:
        return [Finding(name, False, "flown from target to target, the plant does not come to rest")]
    stronger, later = (
        f"{'at least ' if value >= most else ''}{value:.3g}"
        for value, most in ((margins.gain, float(GAINS[-1])), (margins.delay, LATEST))
    )
    words = (
        f"flown from target to target, the inputs may act {stronger} times as strongly, or {later} control periods, "
        f"{1000 * margins.delay * dt:.0f} ms, later{_counting(found, margins)}; thresholds: {limits.gain:g} and "
        f"{limits.delay:g}"
    )
    return [Finding(name, margins.gain >= limits.gain and margins.delay >= limits.delay, words)]


def _counting(found: Check, flown: Flown) -> str:
    """Say which margins count where those of flights disagree with those of small movements."""
    small = [margin for target in found.margins for margin in target]
    gain, delay = (  # as far as was tried is no end
        value if value < most else math.inf for value, most in ((flown.gain, float(GAINS[-1])), (flown.delay, LATEST))
    )
    pairs = {
        "gain": (gain, min(margin.gain for margin in small)),
        "delay": (delay, min(margin.delay for margin in small) / found.loop.dt),
    }
    less = [name for name, (large, little) in pairs.items() if large < little]
    if not less:
        return ". The margins above are less than these, and count"
    both = " and the ".join(f"{name} margin" for name in less)
    return f". This is less than the {both} above, so this line counts for {'both' if less[1:] else 'that'}"


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
    words = f"noise of the sensors moves {name} by {worst[i]:.3g} (standard deviation)"
    return Finding("noise", bool(worst[i] <= limits.noise), f"{words}; threshold: {limits.noise:g}")


def _flights(found: Check, limits: Thresholds) -> list[Finding]:
    names, steps = found.loop.signature.input_names, found.steps
    error, word, output = _error(found, steps.steady_error)
    slew, saturated = steps.slew.nan_to_num(torch.inf).amax(0), steps.saturated.amax(0)
    i, j = int(slew.argmax()), int(saturated.argmax())
    return [
        Finding(
            "steady error",
            error <= limits.error,
            f"in steps from {found.beginning()} at most {word} of {_name(found, output)}"
            f"{_below(found, error, output)}; threshold: {_allowed(found, limits, output)}",
        ),
        Finding(
            "slew",
            float(slew[i]) <= limits.slew,
            f"in a step {names[i]} changes by up to {slew[i]:.2f} in a control period; threshold: {limits.slew:g}",
        ),
        Finding(
            "saturation",
            float(saturated[j]) <= limits.saturated,
            f"in a step {names[j]} is at its limit for up to {100 * saturated[j]:.0f} % of "
            f"{in_words(found.seconds)}; threshold: {100 * limits.saturated:.0f} %",
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
        far = "no rest" if radius[k].isinf() else f"spectral radius {radius[k]:.4f}"
        error, told, output = 0.0, "no steady error, as none comes to rest", 0
        if unstable < len(labels):
            error, word, output = _error(found, others.farthest[rows][rests])
            told = f"steady error at most {word} of {_name(found, output)}{_below(found, error, output)}"
            if unstable:
                do, are = ("does", "is") if unstable == 1 else ("do", "are")
                told += f", of which {unstable} of {len(labels)} {are} left out that {do} not come to rest"
        away = found.ran_away if name == "all coefficients" else 0
        if away:
            told += f"; {away} run{'s' * (away == 1)} away in the step of steps.png"
        lines.append(
            Finding(
                name,
                not (unstable or away) and error <= limits.error,
                f"{words}, {where}: {stays} of these {len(labels)} plants, worst {labels[k]} ({far}), {told}; "
                f"threshold: stable, {_allowed(found, limits, output)}",
            )
        )
    return lines


def _recovery(found: Check, limits: Thresholds) -> Finding:
    shares = [plane.share for plane in found.planes]
    words = ", ".join(f"{100 * plane.share:.0f} % in {plane.names[0]} and {plane.names[1]}" for plane in found.planes)
    least, tried = min(shares), found.planes[0].back.numel()
    error, left, output = _error(found, found.planes[0].steady_error.unsqueeze(0))
    return Finding(
        "recovery",
        least >= limits.recovered,
        f"comes back from errors of up to {found.settings.reach:g} times the typical size of each state: "
        f"{words}, of {tried} errors in each such plane; the error that stays where it rests is {left} of "
        f"{_name(found, output)}{_below(found, error, output)}; threshold: {100 * limits.recovered:.0f} %",
    )


def _error(found: Check, error: torch.Tensor) -> tuple[float, str, int]:
    """Return the largest steady error of `(rows, n_r)` in typical sizes, in words, and the number of its output."""
    signature, outputs = found.loop.signature, found.loop.task.outputs
    ranged = (error / _sizes(found)).amax(0)
    i = int(ranged.argmax())
    value = float(error[:, i].amax())
    word = "no bound" if value == math.inf else f"{value:.3g} {signature.state_units[outputs[i]]}"
    return float(ranged[i]), word, i


def _below(found: Check, error: float, output: int) -> str:
    """Say that no measurement can show an error [typical sizes] of an output which its sensor does not resolve."""
    signature, state = found.loop.signature, found.loop.task.outputs[output]
    finest = float(found.resolution[state])
    if error * signature.x_scale[state] >= finest:
        return ""
    return f" (the sensor cannot show it, which resolves {finest:.3g} {signature.state_units[state]})"


def _sizes(found: Check) -> torch.Tensor:
    """Return the typical sizes of the outputs, `(n_r,)`."""
    scale = found.loop.signature.x_scale
    return torch.tensor([scale[i] for i in found.loop.task.outputs], dtype=torch.float64)


def _name(found: Check, output: int) -> str:
    return found.loop.signature.state_names[found.loop.task.outputs[output]]


def _allowed(found: Check, limits: Thresholds, output: int) -> str:
    """Return the steady error that an output may have, in its unit and as a share of its typical size."""
    signature, state = found.loop.signature, found.loop.task.outputs[output]
    most = limits.error * signature.x_scale[state]
    unit, size = signature.state_units[state], signature.x_scale[state]
    return (
        f"{most:.3g} {unit}, {100 * limits.error:g} % of {size:.3g} {unit}, the typical size of {_name(found, output)}"
    )


def _place(found: Check, k: int) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in found.targets[k].tolist()) + ")"


def _factor(value: float) -> str:
    return "without limit" if value == math.inf else f"{value:.2f} ({_db(value):.1f} dB)"


def _db(value: float) -> float:
    return 20 * math.log10(value)
