"""What was found, in words: one line per finding, its threshold beside it."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from dynasindy.checking.check import Check
from dynasindy.checking.linear_loop import CLOSED, LONGEST, Margins
from dynasindy.checking.simulation import GAINS, LATEST, TOLERANCE, LargeSignalMargins
from dynasindy.checking.uncertainty import SHARE
from dynasindy.text import format_duration

GENTLE = "Where plant.rates names rates, try task.reward.rate_weight=10, by which quick movements cost more than by 0.1"
CAREFUL = (
    f"{GENTLE}. On any plant, try planning.gain_range=0.5 with planning.randomization.parameters=0.2, by which "
    "training varies the plant more"
)
VARIED = (
    "Where a plant is not stable, try planning.randomization.parameters=0.2, by which training varies the plant by up "
    "to that share; where only the steady error is too large, give the controller integral action, as the page on "
    "checks shows"
)
REMEDIES = {
    "stability": "To mend it, narrow the targets, or excite the plant near these targets and train anew",
    **dict.fromkeys(
        ("gain margin", "gain reduction", "phase margin", "delay margin", "disk margin", "large movements"), CAREFUL
    ),
    "noise": f"{GENTLE}, or mend the sensor",
    "steady error": "See steps.png. If outputs still move at its end, give a longer flight by seconds=; if they rest "
    "beside their targets, narrow the targets",
    "slew": GENTLE,
    "saturation": "To mend it, narrow the targets, for these steps ask for more than the actuator has",
    "one coefficient": f"The size of these changes is fixed, so longer data do not help. {VARIED}",
    "all coefficients": VARIED,
    "settling": "For a plant that is not as the model says, try planning.randomization.parameters=0.2, or give the "
    "controller integral action, as the page on checks shows",
    "recovery": "Switch the controller on near the middle of the targets, or give plant.start the range from which it "
    "is to come back, and train anew",
}
"""What may mend a finding that is weak, by its name."""


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
        settled: Longest time in which the end of a step is closed, whatever coefficient is wrong [flights].
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
    settled: float = 1.0


@dataclass(frozen=True)
class CheckFinding:
    """One finding.

    Attributes:
        name: What it is about.
        good: Whether it keeps its threshold; None where that is not known.
        words: The finding.
    """

    name: str
    good: bool | None
    words: str

    @property
    def weak(self) -> bool:
        """Whether it does not keep its threshold."""
        return self.good is False

    @property
    def mend(self) -> str:
        """What may mend it; empty where it is not weak, or nothing is known."""
        return "" if not self.weak else REMEDIES.get(self.name, "")

    def __str__(self) -> str:
        """Return it as a line, where it is weak with what may mend it."""
        mark = "?" if self.good is None else "WEAK" if self.weak else "ok"
        return f"{mark:<4}  {self.name}: {self.words}{'. ' * bool(self.mend)}{self.mend}"


def in_lines(findings: Sequence[CheckFinding]) -> list[str]:
    """Return a line per finding; what may mend several of them stands behind the first one that is weak."""
    lines, said = [], set[str]()
    for each in findings:
        lines.append(str(each).removesuffix(f". {each.mend}") if each.mend in said else str(each))
        said.add(each.mend)
    return lines


def check_record(found: Check, findings: Sequence[CheckFinding] = ()) -> dict[str, Any]:
    """Return all figures as plain numbers, findings first; null stands for what is infinite or does not exist."""
    words = [{"finding": each.name, "good": each.good, "words": each.words} for each in findings]
    signature, outputs = found.loop.signature, found.loop.task.output_names
    names, eigenvalues = signature.input_names, found.rest.linear.eigenvalues
    targets = []
    for k, target in enumerate(found.targets.tolist()):
        gain = found.noise[k]
        targets.append(
            {
                "target": dict(zip(outputs, target, strict=True)),
                "rests": bool(found.rest.still[k]),
                "stable": bool(found.stable[k]),
                "spectral_radius": _plain_number(found.rest.linear.radius[k]),
                "eigenvalues": [
                    [_plain_number(v.real), _plain_number(v.imag)] for v in eigenvalues[k] if abs(v) > 1e-6
                ],
                "steady_error": _at(found, outputs, found.steps.steady_error, k),
                "swing": None
                if bool(found.stable[k])
                else _named((*outputs, *names), torch.cat([found.swings.outputs[k], found.swings.inputs[k]])),
                "margins": {
                    name: {key: _plain_number(value) for key, value in vars(margin).items()}
                    for name, margin in zip(names, found.margins[k], strict=False)
                },
                "noise_to_input": {
                    name: _named(signature.state_names, row) for name, row in zip(names, gain, strict=True)
                }
                if gain is not None
                else None,
                "slew": _at(found, names, found.steps.slew, k),
                "saturated": _at(found, names, found.steps.saturated, k),
            }
        )
    others = found.spread
    changes = [
        {
            "change": label,
            "spectral_radius": _plain_number(float(others.worst[k])),
            "steady_error": _named(outputs, others.farthest[k]),
            "settling": None
            if others.settling is None or others.worst[k] >= 1
            else _plain_number(float(others.settling[:, k].amax())),
        }
        for k, label in enumerate(others.labels)
    ]
    planes = [
        {"states": plane.names, "share": plane.share, "steady_error": _named(outputs, plane.steady_error)}
        for plane in found.planes
    ]
    settings = {name: list(v) if isinstance(v, tuple) else v for name, v in vars(found.settings).items()}
    flights = None if found.flown is None else vars(found.flown)
    parts = {
        "verdict": words,
        "settings": settings,
        "targets": targets,
        "flown": flights,
        "changes": changes,
        "recovery": planes,
    }
    return {**parts, "left": list(found.left)}


def _plain_number(value: float) -> float | None:
    """Return a number as JSON can hold it: None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def _named(names: Any, values: Any) -> dict[str, float | None]:
    return {name: _plain_number(float(value)) for name, value in zip(names, values, strict=True)}


def _at(found: Check, names: Any, values: Tensor, target: int) -> dict[str, float | None] | None:
    """Return figures of the step to a target; None where it was not flown yet."""
    return _named(names, values[target]) if len(found.steps.x) else None


MORE = 12
"""Digits that a figure gets more at most to tell it from its threshold."""


def least(value: float, limit: float, digits: int, kind: str = "f", of_limit: int = 6) -> tuple[str, str]:
    """Return a figure and the least that it may be, with as many more digits as the text takes to say which is less.

    Args:
        value: The figure.
        limit: Its threshold.
        digits: Digits of the figure, as the format counts them.
        kind: Letter of the format of the figure, `f` or `g`.
        of_limit: Digits of the threshold that count.
    """
    return _apart(value, limit, digits, kind, of_limit, operator.lt)


def most(value: float, limit: float, digits: int, kind: str = "f", of_limit: int = 6) -> tuple[str, str]:
    """Return a figure and the most that it may be, as `least` does."""
    return _apart(value, limit, digits, kind, of_limit, operator.gt)


def _apart(
    value: float, limit: float, digits: int, kind: str, of_limit: int, weak: Callable[[float, float], bool]
) -> tuple[str, str]:
    for more in range(MORE):
        pair = f"{value:.{digits + more}{kind}}", f"{limit:.{of_limit + more}g}"
        if weak(float(pair[0]), float(pair[1])) == weak(value, limit):
            break
    return pair


class Error(NamedTuple):
    """The largest error of an output.

    Attributes:
        share: In typical sizes of the output.
        word: In words, with its unit.
        output: Number of the output.
        allowed: What it may be, in its unit and as a share of its typical size.
    """

    share: float
    word: str
    output: int
    allowed: str


def error(found: Check, errors: torch.Tensor, limits: Thresholds) -> Error:
    """Return the largest of steady errors `(rows, n_r)`, counted in typical sizes, beside what it may be."""
    signature, outputs = found.loop.signature, found.loop.task.outputs
    ranged = (errors / _sizes(found)).amax(0)
    i = int(ranged.argmax())
    value, size, unit = float(errors[:, i].amax()), signature.x_scale[outputs[i]], signature.state_units[outputs[i]]
    shown, bound = most(value, limits.error * size, 3, "g", 3)
    word = "no bound" if value == math.inf else f"{shown} {unit}"
    allowed = f"{bound} {unit}, {100 * limits.error:g} % of {size:.3g} {unit}, the typical size of {_name_of(found, i)}"
    return Error(float(ranged[i]), word, i, allowed)


def below(found: Check, error: float, output: int) -> str:
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


def _name_of(found: Check, output: int) -> str:
    """Return the name of an output."""
    return found.loop.signature.state_names[found.loop.task.outputs[output]]


def place(found: Check, k: int) -> str:
    """Return the numbers of a target in brackets."""
    return "(" + ", ".join(f"{value:.3g}" for value in found.targets[k].tolist()) + ")"


def _margin_findings(found: Check, limits: Thresholds) -> list[CheckFinding]:
    """Return the least margins at rest, over inputs and targets."""
    dt, names = found.loop.dt, found.loop.signature.input_names
    rows = [(k, i, m) for k, target in enumerate(found.margins) for i, m in enumerate(target)]

    slow = "" if found.flown is None else ", in movements so small that dry friction damps them"

    def _worst(values: Sequence[float]) -> tuple[float, str]:
        row = int(np.argmin(values))
        k, i, _ = rows[row]
        return values[row], f"of {names[i]} at {place(found, k)}{slow}"

    def _all(read: object) -> list[float]:
        assert callable(read)
        return [float(read(m)) for _, _, m in rows]

    def _wider(margin: Margins) -> float:
        return 1 / margin.lower if margin.lower else math.inf

    up, where_up = _worst(_all(lambda m: m.gain))
    down, where_down = _worst(_all(_wider))
    phase, where_phase = _worst(_all(lambda m: m.phase))
    delay, where_delay = _worst([d / dt for d in _all(lambda m: m.delay)])
    disk, where_disk = _worst(_all(lambda m: m.disk))
    factor, reduced = least(up, limits.gain, 2), most(1 / down, 1 / limits.gain, 2)
    angle, periods, size = least(phase, limits.phase, 0), least(delay, limits.delay, 2), least(disk, limits.disk, 2)
    decibel = least(_db(up), _db(limits.gain), 1, of_limit=2)
    upwards = "without limit" if up == math.inf else f"{factor[0]} ({decibel[0]} dB)"
    downwards = "may fall to nothing" if down == math.inf else f"may fall to {reduced[0]}"
    return [
        CheckFinding(
            "gain margin",
            up >= limits.gain,
            f"the least is {upwards} {where_up}; threshold: {factor[1]} ({decibel[1]} dB)",
        ),
        CheckFinding("gain reduction", down >= limits.gain, f"{downwards} {where_down}; threshold: {reduced[1]}"),
        CheckFinding(
            "phase margin",
            phase >= limits.phase,
            f"the least is {angle[0]} deg {where_phase}; threshold: {angle[1]} deg",
        ),
        CheckFinding(
            "delay margin",
            delay >= limits.delay,
            f"the least is {periods[0]} control periods, {1000 * delay * dt:.0f} ms, {where_delay}; "
            f"threshold: {periods[1]} control period{'s' if limits.delay != 1 else ''}",
        ),
        CheckFinding("disk margin", disk >= limits.disk, f"the least is {size[0]} {where_disk}; threshold: {size[1]}"),
    ]


def _large_signal_findings(found: Check, limits: Thresholds) -> list[CheckFinding]:
    """Return the margins of large movements; none of a plant without dry friction."""
    name, margins, dt = "large movements", found.flown, found.loop.dt
    if margins is None:
        return []
    if not margins.gain:
        return [CheckFinding(name, False, "flown from target to target, the plant does not come to rest")]
    stronger, later = (
        f"{'at least ' if value >= end else ''}{least(value, limit, 3, 'g')[0]}"
        for value, limit, end in ((margins.gain, limits.gain, float(GAINS[-1])), (margins.delay, limits.delay, LATEST))
    )
    words = (
        f"flown from target to target, the inputs may act {stronger} times as strongly, or {later} control periods, "
        f"{1000 * margins.delay * dt:.0f} ms, later{_counting(found, margins)}; thresholds: {limits.gain:g} and "
        f"{limits.delay:g}"
    )
    return [CheckFinding(name, margins.gain >= limits.gain and margins.delay >= limits.delay, words)]


def _counting(found: Check, flown: LargeSignalMargins) -> str:
    """Say which margins count where those of flights disagree with those of small movements."""
    small = [margin for target in found.margins for margin in target]
    gain, delay = (  # as far as was tried is no end
        value if value < end else math.inf for value, end in ((flown.gain, float(GAINS[-1])), (flown.delay, LATEST))
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


def _db(value: float) -> float:
    return 20 * math.log10(value)


def unstable_targets(found: Check, thresholds: Thresholds | None = None) -> torch.Tensor:
    """Return at which targets a loop that is not stable leaves them, or swings more than is allowed, `(n_targets,)`."""
    limits, size = thresholds or Thresholds(), _sizes(found)
    small = (found.swings.outputs <= limits.swing * size) & (found.swings.error <= limits.error * size)
    return ~found.stable & ~small.all(-1)


def in_short(found: Check, findings: Sequence[CheckFinding], thresholds: Thresholds | None = None) -> str:
    """Return one line that sums up the findings.

    Args:
        found: What was looked at.
        findings: What `check_verdict` said of it.
        thresholds: Those of the findings.
    """
    count, good, limits = len(found.targets), int(found.stable.sum()), thresholds or Thresholds()
    weak = [each.name for each in findings if each.weak]
    unknown = [each.name for each in findings if each.good is None]
    if left := int(unstable_targets(found, limits).sum()):
        return f"In short: NOT stable at {left} of {count} targets. Do not fly it as it is."
    rest = f"weak in {len(weak)} of {len(findings)} findings: {', '.join(weak)}" if weak else "no finding is weak"
    rest += f"; not known: {', '.join(unknown)}" if unknown else ""
    if good < count:
        swing = f"at {count - good} it goes on swinging, by {_swing(found, limits)[0]}"
        return f"In short: stable at {good} of {count} targets; {swing}; {rest}."
    whole = f"all {count} targets" if count > 1 else "the one target"
    return f"In short: stable at {whole}, and {rest}."


def in_figures(found: Check, findings: Sequence[CheckFinding]) -> dict[str, Any]:
    """Return the main figures, as `metrics.json` of a run holds them; null stands for what is infinite.

    Args:
        found: What was looked at.
        findings: What `check_verdict` said of it.
    """
    least: dict[str, dict[str, float | None]] = {}
    for i, name in enumerate(found.loop.signature.input_names):
        if at_targets := [each[i] for each in found.margins if each]:
            worst = {key: min(getattr(m, key) for m in at_targets) for key in ("gain", "phase", "delay", "disk")}
            worst["lower"] = max(m.lower for m in at_targets)
            least[name] = {key: _plain_number(value) for key, value in worst.items()}
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


def check_verdict(found: Check, thresholds: Thresholds | None = None) -> list[CheckFinding]:
    """Return what was found, the stability first; an unstable loop has no margins and no noise."""
    limits = thresholds or Thresholds()
    lines = [_stability(found, limits)]
    if any(found.margins):
        lines += [*_margin_findings(found, limits), *_large_signal_findings(found, limits), _noise(found, limits)]
    if len(found.steps.x):
        lines += _flights(found, limits)
    lines += [*_changes(found, limits), *_settling(found, limits)]
    return [*lines, _recovery(found, limits)] if found.planes else lines


def _stability(found: Check, limits: Thresholds) -> CheckFinding:
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
            f"{format_duration(found.swings.seconds)}, {_name_of(found, output)} ends within {word} of its target, and "
            f"{_circling(found, limits)}; thresholds: spectral radius < 1 at all, swings of {100 * limits.swing:g} %"
        )
        return CheckFinding("stability", False, words)
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
    return CheckFinding("stability", True, words)


def _circling(found: Check, limits: Thresholds) -> str:
    """Return how the loop swings where it is not stable."""
    word, output, share = _swing(found, limits)
    if share == math.inf:
        return f"{_name_of(found, output)} runs away, or its swings still grow"
    moved = found.swings.inputs.amax(0)
    i = int(moved.argmax())
    name = found.loop.signature.input_names[i]
    shown, _ = most(100 * share, 100 * limits.swing, 2, "g")
    return f"the loop goes on swinging, by {word}, {shown} % of its typical size, and {name} by {moved[i]:.2g}"


def _swing(found: Check, limits: Thresholds) -> tuple[str, int, float]:
    """Return the largest swing of an output where the loop is not stable, in words, its output, and typical sizes."""
    share, word, output, _ = error(found, found.swings.outputs, limits)
    return f"{word} of {_name_of(found, output)} to either side", output, share


def _noise(found: Check, limits: Thresholds) -> CheckFinding:
    spreads = [np.sqrt((gain**2) @ found.sensors**2) for gain in found.noise if gain is not None]
    worst = np.max(spreads, axis=0)
    i = int(worst.argmax())
    if not found.sensors.any():
        words = (
            "not known, as the controller's file states no noise of sensors; check.json has what a unit of it would "
            "do, and a run with sensors=bench, or on a log, states it"
        )
        return CheckFinding("noise", None, words)
    name = found.loop.signature.input_names[i]
    moved, allowed = most(float(worst[i]), limits.noise, 3, "g")
    words = f"noise of the sensors moves {name} by {moved} (standard deviation); threshold: {allowed}"
    return CheckFinding("noise", bool(worst[i] <= limits.noise), words)


def _flights(found: Check, limits: Thresholds) -> list[CheckFinding]:
    names, steps, begun = found.loop.signature.input_names, found.steps, f"in steps from {found.beginning()}"
    largest, word, output, allowed = error(found, steps.steady_error, limits)
    slew, saturated = steps.slew.nan_to_num(torch.inf).amax(0), steps.saturated.amax(0)
    i, j = int(slew.argmax()), int(saturated.argmax())
    changes, most_change = most(float(slew[i]), limits.slew, 2)
    shares, most_shares = most(100 * float(saturated[j]), 100 * limits.saturated, 0)
    return [
        CheckFinding(
            "steady error",
            largest <= limits.error,
            f"{begun} at most {word} of {_name_of(found, output)}{below(found, largest, output)}; threshold: {allowed}",
        ),
        CheckFinding(
            "slew",
            float(slew[i]) <= limits.slew,
            f"{begun} {names[i]} changes by up to {changes} in a control period; threshold: {most_change}",
        ),
        CheckFinding(
            "saturation",
            float(saturated[j]) <= limits.saturated,
            f"{begun} {names[j]} is at its limit for up to {shares} % of "
            f"{format_duration(found.seconds)}; threshold: {most_shares} %",
        ),
    ]


def _changes(found: Check, limits: Thresholds) -> list[CheckFinding]:
    others, lines, held = found.spread, [], len(found.spread.radius)
    single = len(others.labels) - others.draws
    moved = f"{single // 2} coefficient{'s' * (single > 2)}, {100 * SHARE:.0f} % up and down, one at a time"
    where = f"at the {held} target{'s' * (held > 1)} where the model itself is stable"
    for name, rows, words in (
        ("one coefficient", slice(others.draws, None), f"{single} plants from {moved}"),
        (
            "all coefficients",
            slice(0, others.draws),
            f"{others.draws} plants with all coefficients drawn, {others.how.summary()}",
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
            told = f"steady error at most {word} of {_name_of(found, output)}{below(found, largest, output)}"
            if unstable:
                do, are = ("does", "is") if unstable == 1 else ("do", "are")
                told += f", of which {unstable} of {len(labels)} {are} left out that {do} not come to rest"
        away = found.ran_away if name == "all coefficients" else 0
        if away:
            told += f"; {away} run{'s' * (away == 1)} away in the step of steps.png"
        lines.append(
            CheckFinding(
                name,
                not (unstable or away) and largest <= limits.error,
                f"{words}, {where}: {stays} of these {len(labels)} plants, worst {labels[k]} ({far}), {told}; "
                f"threshold: stable, {allowed}",
            )
        )
    return lines


def _settling(found: Check, limits: Thresholds) -> list[CheckFinding]:
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
    return [CheckFinding("settling", slowest <= limits.settled * found.seconds, words)]


def _recovery(found: Check, limits: Thresholds) -> CheckFinding:
    shares = [plane.share for plane in found.planes]
    pairs = [least(100 * share, 100 * limits.recovered, 0) for share in shares]
    names = [f"{plane.names[0]} and {plane.names[1]}" for plane in found.planes]
    words = ", ".join(f"{share} % in {both}" for (share, _), both in zip(pairs, names, strict=True))
    worst, tried = shares.index(min(shares)), found.planes[0].back.numel()
    stays, left, output, _ = error(found, found.planes[0].steady_error.unsqueeze(0), limits)
    return CheckFinding(
        "recovery",
        shares[worst] >= limits.recovered,
        f"comes back from errors of up to {found.settings.reach:g} times the typical size of each state: "
        f"{words}, of {tried} errors in each such plane; the error that stays where it rests is {left} of "
        f"{_name_of(found, output)}{below(found, stays, output)}; threshold: {pairs[worst][1]} %",
    )
