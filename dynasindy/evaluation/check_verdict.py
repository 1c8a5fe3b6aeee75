"""What a check found: each figure beside its threshold, and the record of all figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dynasindy.control import Controller
from dynasindy.evaluation.check import TOLERANCE, Check, Settings
from dynasindy.evaluation.closed_loop import ClosedLoop
from dynasindy.evaluation.linear_loop import NEUTRAL, find_rest, loop_margins
from dynasindy.findings import Finding, note, records, weak, wrong
from dynasindy.planning.margins import MOVEMENT
from dynasindy.sindy import SindyModel


@dataclass(frozen=True)
class Thresholds:
    """Where a finding begins to be a weak one.

    Attributes:
        gain: Least gain margin upwards; downwards it is the inverse.
        phase: Least phase margin [deg].
        delay: Least delay margin [control periods].
        disk: Least disk margin.
        swing: Largest swing to either side where the loop is not stable [target ranges].
        error: Largest steady error [target ranges].
        recovered: Least share of initial errors from which the plant comes back.
        noise: Largest standard deviation of an input under the noise of the sensors.
        slew: Largest change of an input in a control period.
        saturated: Largest share of a step at the limit of an input.
    """

    gain: float = 2.0
    phase: float = 30.0
    delay: float = 1.0
    disk: float = 0.5
    swing: float = MOVEMENT
    error: float = TOLERANCE
    recovered: float = 0.9
    noise: float = 0.05
    slew: float = 1.0
    saturated: float = 0.2


def check_record(found: Check) -> dict[str, Any]:
    """Return all figures as plain numbers, findings first; null stands for what is infinite or does not exist."""
    signature, outputs = found.loop.signature, found.loop.task.output_names
    inputs, states = signature.input_names, signature.state_names
    others, linear, targets = found.spread, found.rest.linear, []
    for k, stable in enumerate(found.stable.tolist()):
        gain, swings = found.noise[k], (*found.swings.outputs[k].tolist(), *found.swings.inputs[k].tolist())
        targets.append(
            {
                "target": _named(outputs, found.targets[k]),
                "rests": bool(found.rest.still[k]),
                "stable": stable,
                "spectral_radius": float(linear.radius[k]),
                "eigenvalues": [[v.real, v.imag] for v in linear.eigenvalues[k].tolist() if abs(v) > 1e-6],
                "steady_error": _named(outputs, found.steps.steady_error[k]),
                "swing": None if stable else dict(zip((*outputs, *inputs), swings, strict=True)),
                "margins": dict(zip(inputs, map(vars, found.margins[k]), strict=False)),
                "noise_to_input": gain if gain is None else _named(inputs, [_named(states, row) for row in gain]),
                "slew": _named(inputs, found.steps.slew[k]),
                "saturated": _named(inputs, found.steps.saturated[k]),
            }
        )
    changes = zip(others.worst.tolist(), others.farthest, strict=True)
    figures = {
        "settings": vars(found.settings),
        "targets": targets,
        "changes": [{"spectral_radius": radius, "steady_error": _named(outputs, error)} for radius, error in changes],
        "recovery": [
            {"states": plane.names, "share": plane.share, "steady_error": _named(outputs, plane.steady_error)}
            for plane in found.planes
        ],
    }
    return {"findings": records(check_verdict(found)), **_finite(figures)}


def thin_margin(controller: Controller, model: SindyModel) -> list[Finding]:
    """Return that the disk margin is thin at ends or middles of the targets, or nothing; `check` tells more.

    Args:
        controller: The controller.
        model: Model of the plant.
    """
    if (ends := controller.setup.task.ends) is None:
        return []
    targets, limit = Settings(*ends).targets, Thresholds().disk
    rest = find_rest(ClosedLoop(controller, model), targets)
    resting = rest.still.nonzero().flatten().tolist()  # not so a mileage, which runs on
    rows = [(k, loop_margins(rest.linear.row(k).decaying())) for k in resting]
    least, k, i = min(((each.disk, k, i) for k, row in rows for i, each in enumerate(row)), default=(math.inf, 0, 0))
    facts = {"value": least, "limit": limit, "target": targets[k].tolist(), "input": model.signature.input_names[i]}
    return [weak("control.thin_margin", **facts)] if least < limit else []


def _named(names: Sequence[str], values: Any) -> dict[str, Any]:
    return dict(zip(names, values if isinstance(values, list) else values.tolist(), strict=True))


def _finite(value: Any) -> Any:
    """Return a record with None for numbers that are not finite, for which JSON has no word."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def unstable_targets(found: Check, thresholds: Thresholds | None = None) -> torch.Tensor:
    """Return at which targets a loop that is not stable leaves them, or swings more than is allowed, `(n_targets,)`."""
    limits, size = thresholds or Thresholds(), found.loop.task.boxes()
    small = (found.swings.outputs <= limits.swing * size) & (found.swings.error <= limits.error * size)
    return ~found.stable & ~small.all(-1)


def check_verdict(found: Check, thresholds: Thresholds | None = None) -> list[Finding]:
    """Return what was found, the stability first; an unstable loop has no margins and no noise.

    What keeps its threshold is a note, what does not is weak; a loop that leaves its targets is wrong.

    Args:
        found: What `check` returned.
        thresholds: What is good enough; the defaults if omitted.

    Returns:
        Findings with their numbers.
    """
    limits = thresholds or Thresholds()
    findings = [_stability(found, limits)]
    if any(found.margins):
        findings += [*_margins(found, limits), _noise(found, limits)]
    findings += [*_steps(found, limits), *_coefficients(found, limits)]
    if found.planes:
        shares = {" and ".join(plane.names): plane.share for plane in found.planes}
        error = _largest_error(found, found.planes[0].steady_error.unsqueeze(0), limits) | {"limit": limits.recovered}
        facts = {"shares": shares, "reach": found.settings.reach, "tried": found.planes[0].back.numel()}
        findings.append(_judged("recovery", min(shares.values()) >= limits.recovered, **facts, **error))
    return findings


def _judged(code: str, keeps: bool, **values: Any) -> Finding:
    return (note if keeps else weak)(f"check.{code}", **values)


def _largest_error(found: Check, errors: Tensor, limits: Thresholds) -> dict[str, Any]:
    """Return the largest of errors `(rows, n_r)`, counted in target ranges, beside what it may be."""
    signature, sizes = found.loop.signature, found.loop.task.boxes()
    ranged = (errors / sizes).amax(0)
    i = int(ranged.argmax())
    state, value, size = found.loop.task.outputs[i], float(errors[:, i].amax()), float(sizes[i])
    return {
        "output": signature.state_names[state],
        "unit": signature.state_units[state],
        "error": value,
        "share": float(ranged[i]),
        "limit": limits.error * size,
        "size": size,
    }


def _target(found: Check, k: int) -> list[float]:
    return [float(f"{value:.3g}") for value in found.targets[k].tolist()]


def _stability(found: Check, limits: Thresholds) -> Finding:
    count, good, dt = len(found.targets), int(found.stable.sum()), found.loop.dt
    facts: dict[str, Any] = {"targets": count, "unstable": count - good, "outputs": [*found.loop.task.output_names]}
    if good < count:
        bad = ~found.stable
        facts |= {"target": _target(found, int(bad.nonzero()[0])), "restless": int((~found.rest.still).sum())}
        facts |= {"seconds": found.swings.seconds, "ends": _largest_error(found, found.swings.error[bad], limits)}
        moved = found.swings.inputs.amax(0)
        i = int(moved.argmax())
        facts |= {"swing": _largest_error(found, found.swings.outputs, limits), "swing_limit": limits.swing}
        facts |= {"input": found.loop.signature.input_names[i], "input_swing": float(moved[i])}
        return (wrong if bool(unstable_targets(found, limits).any()) else weak)("check.stability", **facts)
    radii = found.rest.linear.radius
    k = int(np.argmax(radii))
    radius, neutral = float(radii[k]), bool(radii[k] >= 1 - NEUTRAL)
    if neutral:
        radius = max(float(found.rest.linear.row(j).decaying().radius) for j in range(count))
    facts |= {"target": _target(found, k), "radius": radius, "slowest": _time_constant(radius, dt), "dt": dt}
    facts |= {"neutral": neutral}
    return note("check.stability", **facts)


def _time_constant(radius: float, dt: float) -> float:
    """Return in which time the slowest part of a loop dies out to a share of 1/e [s]."""
    return -dt / math.log(radius) if 0 < radius < 1 else 0.0 if radius < 1 else math.inf


def _margins(found: Check, limits: Thresholds) -> list[Finding]:
    """Return the least margins over inputs and targets."""
    dt, names = found.loop.dt, found.loop.signature.input_names
    rows = [(k, i, margins) for k, target in enumerate(found.margins) for i, margins in enumerate(target)]
    kinds = {
        "gain_margin": ([m.gain for *_, m in rows], limits.gain),
        "gain_reduction": ([1 / m.lower if m.lower else math.inf for *_, m in rows], limits.gain),
        "phase_margin": ([m.phase for *_, m in rows], limits.phase),
        "delay_margin": ([m.delay / dt for *_, m in rows], limits.delay),
        "disk_margin": ([m.disk for *_, m in rows], limits.disk),
    }
    findings = []
    for code, (values, limit) in kinds.items():
        k, i, _ = rows[row := int(np.argmin(values))]
        where = {"input": names[i], "target": _target(found, k), "dt": dt}
        where["weak"] = len({row[0] for row, value in zip(rows, values, strict=True) if value < limit})
        findings.append(_judged(code, values[row] >= limit, value=values[row], limit=limit, **where))
    return findings


def _noise(found: Check, limits: Thresholds) -> Finding:
    if not found.sensors.any():
        return note("check.noise", known=False)
    spreads = [np.sqrt((gain**2) @ found.sensors**2) for gain in found.noise if gain is not None]
    worst = np.max(spreads, axis=0)
    i = int(worst.argmax())
    name = found.loop.signature.input_names[i]
    return _judged("noise", bool(worst[i] <= limits.noise), value=float(worst[i]), limit=limits.noise, input=name)


def _steps(found: Check, limits: Thresholds) -> list[Finding]:
    names, steps, begin = found.loop.signature.input_names, found.steps, found.beginning()
    error = _largest_error(found, steps.steady_error, limits)
    findings = [_judged("steady_error", error["share"] <= limits.error, begin=begin, **error)]
    for code, values, limit, more in (
        ("slew", steps.slew.nan_to_num(torch.inf), limits.slew, {}),
        ("saturation", steps.saturated, limits.saturated, {"seconds": found.seconds}),
    ):
        most = values.amax(0)
        i = int(most.argmax())
        value = float(most[i])
        findings.append(_judged(code, value <= limit, begin=begin, input=names[i], value=value, limit=limit, **more))
    return findings


def _coefficients(found: Check, limits: Thresholds) -> list[Finding]:
    others, held = found.spread, int(found.stable.sum())
    if not len(others.worst) or not held:
        return []
    rests, radius = others.worst < 1 + NEUTRAL, float(others.worst.max())
    away = int(found.drawn.away(found.reach).sum())
    error = _largest_error(found, others.farthest[rests] if rests.any() else 0 * found.targets[:1], limits)
    facts = {"plants": len(rests), "held": held, "how": others.how, "unstable": int((~rests).sum())}
    facts |= {"radius": radius, "slowest": _time_constant(radius, found.loop.dt), "ran_away": away}
    keeps = not (facts["unstable"] or away) and error["share"] <= limits.error
    return [_judged("coefficients", keeps, **facts, **error)]
