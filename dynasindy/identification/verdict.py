"""What is found of a fitted model: what it holds, how far ahead it predicts, and where it may be relied on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from dynasindy.findings import Finding, FindingError, note, weak, wrong
from dynasindy.identification.forecast_errors import LOST, ForecastErrors
from dynasindy.identification.recording_diagnostics import repetition, samples_of, sensor_resolution
from dynasindy.identification.source import Source
from dynasindy.sindy import FitReport, SindyModel
from dynasindy.sindy.library import Factor, Feature
from dynasindy.sindy.reconstruction import rate_states
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

RESOLVED = 2.0
"""Error up to which a prediction is as good as a sensor can tell [what the sensor resolves]."""
BEHIND, BETTER, OFTEN = 0.5, 0.9, 0.97
"""Parts of a model's error that a linear model on past samples may have, below which something is missing, and below
which it is the better one; so it is where that is less clear and at several horizons."""
SEVERAL = 3
"""Horizons at which a linear model is ahead by no chance."""
SMALL = 1e-3
"""Error of a model that is small enough, whatever others make of it [ranges of the state]."""
ROUNDED = 1e-5
"""Part of an input by which numbers of 32 bits may go beyond an end."""
ROOM = 0.05
"""Part of the range of a logged input by which flights may go beyond it."""
AFAR = 0.5
"""Part of the range of a logged state by which targets may lie beyond it, if the equations depend on the state: what
bends there may be too small within the log to be found, and is eight times as large at twice its ends."""
COARSE = 5e-3
"""Part of what a state covers in a log from which on the step of its sensor may shift coefficients."""
HELPFUL = 0.5
"""Part of the error of the last value held that a model may have that predicts."""
FULL = 5.0
"""Widths of a function tanh(rate / width), at least, in the range of the rate, for it to be dry friction."""
TOLD = 0.02
"""Part of a function that the others of its equation leave over, above which the data tell its coefficient."""


def model_findings(forecasts: ForecastErrors, signature: Signature) -> list[Finding]:
    """Return whether a model predicts, how far, and whether it is needed; the gravest first.

    A model predicts a state over a horizon if it has at most half of the error of the last value held, or an error that
    the sensor cannot show. It has to do so over the time in which the slowest state changes.

    Args:
        forecasts: Its errors on data that no fit has seen.
        signature: Names and units of the states.
    """
    better = linear_better(forecasts, signature)
    if short := shortcoming(forecasts, signature):
        return [short, *runs_away(forecasts, signature), *better]
    if any(each.severity == "wrong" for each in better):
        return [*better, weak("model.incomplete", seconds=forecasts.horizons[forecasts.middle])]
    enough = _predicted(forecasts).all(1).tolist()
    reach = next((k - 1 for k in range(forecasts.middle + 1, len(enough)) if not enough[k]), len(enough) - 1)
    exact = (forecasts.model <= RESOLVED * forecasts.resolution)[reach] & ~forecasts.held[reach].isnan()
    names = _names(signature, exact)
    behind = any(each.severity != "note" for each in better)
    predicts = note("model.predicts", seconds=forecasts.horizons[reach], exact=names, behind=behind)
    return [*better, predicts] if behind else [predicts, *better]


def _predicted(forecasts: ForecastErrors) -> Tensor:
    """Tell over which horizons a state is predicted, or was not measured, bool `(H, n_x)`."""
    fine = (forecasts.model <= HELPFUL * forecasts.held) | (forecasts.model <= RESOLVED * forecasts.resolution)
    return fine | forecasts.held.isnan()


def _names(signature: Signature, where: Tensor) -> list[str]:
    return [name for name, true in zip(signature.state_names, where.tolist(), strict=True) if true]


def runs_away(forecasts: ForecastErrors, signature: Signature) -> list[Finding]:
    """Return that a plant seems to run away by itself, where a linear model does as well as this one.

    Args:
        forecasts: Errors of both.
        signature: Names of the states.
    """
    most = LOST * torch.tensor(signature.x_scale, dtype=forecasts.model.dtype)
    most = torch.maximum(most, forecasts.held)
    ours, simple = ((kind > most).any(0) for kind in (forecasts.model, forecasts.linear))
    if not (falls := _names(signature, ours & simple)):
        return []
    enough = _predicted(forecasts).all(1).tolist()
    reached = enough.index(False) if False in enough else len(enough)
    return [weak("model.unstable_plant", states=falls, seconds=forecasts.horizons[reached - 1] if reached else 0.0)]


def linear_better(forecasts: ForecastErrors, signature: Signature) -> list[Finding]:
    """Return which states a linear model on past samples predicts better: what it knows of the past, the model lacks.

    Each stands with the shortest horizon over which the model has far larger errors, and then it is wrong, or else over
    which they are larger. A linear model that is no better than the last value held knows nothing, and one that is
    ahead at the shortest horizon alone, by less than the sensor resolves, is a note.

    Args:
        forecasts: Errors of the model and of the linear one.
        signature: Names and units of the states.
    """
    findings, (horizons, n_x) = [], forecasts.model.shape
    small = SMALL * torch.tensor(signature.x_scale, dtype=forecasts.model.dtype)
    small = torch.maximum(
        RESOLVED * forecasts.resolution.to(small), small
    )  # a sensor explains it, or it counts as small
    large = (forecasts.model > small) & (forecasts.linear < forecasts.held)
    for i in range(n_x):
        ratio = torch.where(large[:, i], forecasts.linear[:, i] / forecasts.model[:, i], math.inf)
        worse = [[k for k in range(horizons) if float(ratio[k]) < limit] for limit in (BEHIND, BETTER, OFTEN)]
        if not (places := worse[0] or worse[1] or worse[2] * (len(worse[2]) >= SEVERAL)):
            continue
        k, far = places[0], bool(worse[0])
        facts = {"state": signature.state_names[i], "unit": signature.state_units[i], "far": far}
        errors = {"error": float(forecasts.model[k, i]), "linear": float(forecasts.linear[k, i])}
        slight = worse[2] == [0] and errors["error"] - errors["linear"] <= RESOLVED * float(forecasts.resolution[i])
        finding = wrong if far else note if slight else weak
        findings.append(finding("model.linear_better", seconds=forecasts.horizons[k], **facts, **errors))
    return findings


def logged_input_ranges(model: SindyModel, logged: Tensor) -> dict[str, tuple[float, float]]:
    """Return the ends of what a log has tried, and a little room, of each input that equations are not linear in.

    Beyond these a model only guesses: where inputs were never negative, a thrust that turns round with its propeller
    and one that does not look the same. What stands for an input counts as that: a state that follows it, seen or not.

    Args:
        model: The equations.
        logged: Inputs of the log, `(N, n_u)`.
    """
    used = _used(model.library.features, model.coefficients.any(-1))
    low, high = logged.amin(0), logged.amax(0)
    room = ROOM * (high - low)
    both = [*zip(model.signature.input_names, zip((low - room).tolist(), (high + room).tolist()), strict=True)]
    # States that one input alone moves, linearly, and that settle, go as far as it: as actuators do.
    followed, inputs = {**model.followed}, {*model.signature.input_names}
    for name, column in zip(model.signature.state_names, model.coefficients.unbind(-1), strict=True):
        features = _used(model.library.features, column)
        read = _variables(features)
        settles = any(float(size) < 0 for word, size in zip(model.library.names, column, strict=True) if word == name)
        bent = any(_bent(feature, read, model.signature) for feature in features)
        if settles and len(read & inputs) == 1 and read <= {name, *inputs} and not bent:
            followed[name] = (read & inputs).pop()
    reads = {name: {name, *(a for a, signal in followed.items() if signal == name)} for name, _ in both}
    return {
        name: known for name, known in both if any(_bent(feature, reads[name], model.signature) for feature in used)
    }


def targets_beyond_log(model: SindyModel, logged: Tensor, targets: Mapping[str, tuple[float, float]]) -> list[Finding]:
    """Return which outputs have targets so far beyond the log that the equations are a guess there.

    Args:
        model: The equations; of an output that none of them reads, as the place of a cart, any value is as good.
        logged: States of the log, `(N, n_x)`, NaN where they were not measured.
        targets: Lower and upper end of the targets of each output.
    """
    read, findings = _variables(_used(model.library.features, model.coefficients.any(-1))), []
    for name, (low, high) in targets.items():
        place = model.signature.state_index(name)
        seen = logged[:, place][logged[:, place].isfinite()]
        if name not in read or not len(seen):
            continue
        least, most = float(seen.min()), float(seen.max())
        if low < least - AFAR * (most - least) or high > most + AFAR * (most - least):
            facts = {"state": name, "unit": model.signature.state_units[place], "low": low, "high": high}
            findings.append(wrong("forecast.beyond_log", **facts, least=least, most=most))
    return findings


def require_controlled(model: SindyModel, outputs: Sequence[str]) -> None:
    """Refuse outputs that no input moves in the equations, be it through other states.

    Raises:
        FindingError: There are such outputs.
    """
    moved = moved_by_inputs(model)
    if still := [name for name in outputs if name not in moved]:
        raise FindingError("model.uncontrolled", outputs=still)


def moved_by_inputs(model: SindyModel) -> set[str]:
    """Return the inputs, and the states that they move in the equations, be it through other states."""
    names, moved = model.signature.state_names, set(model.signature.input_names)
    read = {
        name: _variables(_used(model.library.features, column))
        for name, column in zip(names, model.coefficients.unbind(-1), strict=True)
    }
    for _ in names:
        moved |= {name for name in names if read[name] & moved}
    return moved


def inputs_beyond_log(model: SindyModel, logged: Tensor, applied: Tensor) -> list[Finding]:
    """Return which inputs a controller takes to where the log never had them, if equations are not linear in them.

    A controller that was planned with the log stays where it is known; another one may not.

    Args:
        model: The equations.
        logged: Inputs of the log, `(N, n_u)`.
        applied: Inputs of simulations, `(M, n_u)`.
    """
    findings, names = [], model.signature.input_names
    for name, (least, most) in logged_input_ranges(model, logged).items():
        column = applied[:, names.index(name)]
        low, high = float(column.min()), float(column.max())
        if low < least - ROUNDED or high > most + ROUNDED:
            findings.append(wrong("forecast.beyond_inputs", input=name, low=low, high=high, least=least, most=most))
    return findings


def _used(features: Sequence[Feature], coefficients: Tensor) -> list[Feature]:
    return [features[k] for k in coefficients.nonzero().flatten().tolist()]


def _variables(features: Sequence[Feature]) -> set[str]:
    return {name for feature in features for name in feature.variables}


def _bent(feature: Feature, read: set[str], signature: Signature) -> bool:
    """Tell whether a function bends in an input in a way that a log alone tells; sines of angles are geometry."""
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    mine = [factor for factor in feature.factors if read & set(factor.variables)]

    def _straight(factor: Factor) -> bool:
        turned = not factor.fitted and all(units.get(name) == "rad" for name in factor.variables)
        plain = factor.function in ("id", "ahead") or (factor.function in ("sin", "cos") and turned)
        return plain and factor.power == 1

    return len(mine) > 1 or not all(map(_straight, mine))


def shortcoming(forecasts: ForecastErrors, signature: Signature, seconds: float | None = None) -> Finding | None:
    """Return what keeps a model from being one that predicts over some time; None of one that does.

    Args:
        forecasts: Its errors.
        signature: Names and units of the states.
        seconds: The time, of which the horizon next to it counts [s]; if omitted, that in which the slowest state
            changes.
    """
    k = forecasts.middle if seconds is None else forecasts.nearest(seconds)
    ours, held, ahead = forecasts.model[k], forecasts.held[k], forecasts.horizons[k]
    if lost := _names(signature, ~(ours.isfinite() | held.isnan())):
        return wrong("model.runs_away", seconds=ahead, states=lost)
    if not (poor := _names(signature, ~_predicted(forecasts)[k])):
        return None
    errors, last, units = (
        {name: values[signature.state_index(name)] for name in poor}
        for values in (ours.tolist(), held.tolist(), signature.state_units)
    )
    return wrong("model.misses", seconds=ahead, errors=errors, held=last, units=units)


def what_to_leave_out(findings: Sequence[Finding], source: Source, model: SindyModel) -> list[Finding]:
    """Return how states that a model does not predict are left out, as what is no part of a plant is to be.

    What moves the others is a part of it, whether it is predicted or not.

    Args:
        findings: What is wrong of the model.
        source: A log.
        model: The model.
    """
    facts = [each.values for each in findings if each.severity == "wrong"]
    poor = {name for each in facts for name in (*each.get("errors", ()), *each.get("states", ()), each.get("state"))}
    measured, names = _names(source.signature, ~source.training.x.isnan().all(0)), model.signature.state_names
    reads = {
        name: _variables(_used(model.library.features, column))
        for name, column in zip(names, model.coefficients.mT, strict=True)
    }
    for rate, place in rate_states(model.library, model.constraints).items():
        reads[names[rate]] |= {names[place]}  # a rate is none without its place
    moving = {name for name in measured if name not in poor}
    for _ in names:
        moving |= {each for name in moving for each in reads.get(name, ())}
    poor = poor & {*source.signature.state_names} - moving
    kept = [name for name in measured if name not in poor]
    return [weak("model.leave_out", states=sorted(poor), kept=kept)] if poor and moving else []


def recording_findings(data: Transitions, signature: Signature) -> list[Finding]:
    """Return in which steps the sensors of a log read, and whether it repeats itself."""
    seconds = repetition(data)
    findings = [] if seconds is None else [weak("log.repeats", seconds=seconds)]
    for name, unit, column in zip(signature.state_names, signature.state_units, samples_of(data), strict=True):
        if step := sensor_resolution(column):
            coarse = step > COARSE * float(np.ptp(column[~np.isnan(column)]))
            findings.append(note("log.resolution", state=name, step=step, unit=unit, coarse=coarse))
    return findings


def equation_findings(model: SindyModel, report: FitReport | None = None) -> list[Finding]:
    """Return what of delay and dry friction is in the equations.

    Args:
        model: A fitted model.
        report: Of its fit, which tells what the data do not: a delay that is the longest that was tried is none, and
            functions whose coefficients the data do not tell are no friction.
    """
    resolved = None if report is None else report.told_apart()
    at_end = report is not None and "fit.longest_delay" in {each.code for each in report.findings}
    findings = [note("model.delay", seconds=model.delay)] if model.delay and not at_end else []
    for i, rows in enumerate(dry_friction(model)):
        if any(resolved is None or resolved[k, i] > TOLD for k in rows):
            findings.append(note("model.dry_friction", state=model.signature.state_names[i]))
    return findings


def dry_friction(model: SindyModel) -> list[list[int]]:
    """Return which functions are dry friction of each state.

    Args:
        model: A fitted model.
    """
    features, found = model.library.features, list[list[int]]()
    for i, (name, size) in enumerate(zip(model.signature.state_names, model.signature.x_scale, strict=True)):
        rows = (model.coefficients[:, i] < 0).nonzero().flatten().tolist()
        # What bends only at the range of a rate, and does not oppose all but the lowest alike, is a drag.
        steep = ((k, f) for k in rows for f in features[k].factors if f.function == "tanh" and name in f.variables)
        found.append([k for k, f in steep if f.frequency * size >= FULL])
    return found


def idle_states(model: SindyModel, data: Transitions) -> list[Finding]:
    """Return which hidden states stand in no equation, and an example of a first guess of their equations.

    Args:
        model: A fitted model.
        data: The log, NaN where a state was not measured.
    """
    names, inputs = model.signature.state_names, model.signature.input_names
    read = _variables(_used(model.library.features, model.coefficients.any(-1)))
    idle = data.x.isnan().all(0) & ~model.coefficients.any(0)
    still = [n for n, each in zip(names, idle.tolist(), strict=True) if each and n not in read]
    if not still:
        return []
    seen = next((name for name, blind in zip(names, data.x.isnan().all(0).tolist(), strict=True) if not blind), "")
    first = {still[0]: {inputs[0]: 0.1, still[0]: -0.1}, seen: {still[0]: 0.1}}
    return [weak("model.idle_state", states=still, initial=first)]
