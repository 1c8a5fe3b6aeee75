"""What an engineer wants to hear of a fitted model: how far ahead it predicts, and what the data show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from dynasindy.evaluation.forecast_errors import LOST, ForecastErrors
from dynasindy.evaluation.recording_diagnostics import closed_loop, samples_of, saturated, sensor_resolution
from dynasindy.sindy import SindyModel
from dynasindy.sindy.library import Factor, Feature
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.text import format_duration

RESOLVED = 2.0
"""Error up to which a prediction is as good as a sensor can tell [what the sensor resolves]."""
BEHIND = 0.5
"""Part of a model's error that a linear model on past samples may have, below which something is missing."""
SMALL = 1e-3
"""Error of a model that is small enough, whatever others make of it [ranges of the state]."""
FINEST = 1e-6
"""Part of the range of a state below which what a sensor resolves is no noise."""
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
CELL = 11
"""Columns of a number in the table of errors."""


def table(forecasts: ForecastErrors, signature: Signature, columns: int | None = None) -> list[str]:
    """Write the errors over all horizons: of the model, of a linear one, and of the last value held, a line each.

    A linear model may run away without ever being infinite: beyond `LOST` ranges of a state its error is no number.

    Args:
        forecasts: The errors.
        signature: Names and units of the states.
        columns: Columns of the terminal; horizons that do not fit beside each other stand in a table below. None
            lets lines be long.
    """
    kinds = {
        "model": forecasts.model,
        "linear model": forecasts.linear,
        "last value held": forecasts.held,
    }
    wide, heads = max(map(len, kinds)) + 4, [format_duration(horizon) for horizon in forecasts.horizons]
    beside = len(heads) if columns is None else max(1, (columns - wide - 2) // CELL)
    fine = (forecasts.resolution < FINEST * torch.tensor(signature.x_scale)).tolist()
    lines = [
        f"RMS error of predictions that begin at {forecasts.starts} samples which the fit did not see; the linear "
        f"model predicts from {forecasts.order} past samples; over the first"
    ]
    for some in (range(len(heads))[first : first + beside] for first in range(0, len(heads), beside)):
        lines.append(f"  {'':<{wide}}{''.join(f'{heads[k]:>{CELL}}' for k in some)}")
        for i, (name, unit) in enumerate(zip(signature.state_names, signature.state_units, strict=True)):
            if bool(forecasts.held[:, i].isnan().all()):
                continue
            told = (
                "whose sensor shows no noise"
                if fine[i]
                else f"the sensor resolves {_short(float(forecasts.resolution[i]))}"
            )
            lines.append(f"  {name} [{unit}], {told}")
            most = LOST * signature.x_scale[i]
            for kind, found in kinds.items():
                errors = [float(found[k, i]) for k in some]
                cells = (_short(math.inf if error > most else error) for error in errors)
                lines.append(f"    {kind:<{wide - 2}}{''.join(f'{cell:>{CELL}}' for cell in cells)}")
    return lines


def judge(forecasts: ForecastErrors, signature: Signature) -> list[str]:
    """Say whether the model predicts, over the time in which the slowest state changes, and whether it is needed."""
    doubtful = doubts(forecasts, signature)
    if short := shortcoming(forecasts, signature):
        return [f"this model does not predict: {short}", *_falls(forecasts, signature), *doubtful]
    k = forecasts.middle
    ours, simple, seen = forecasts.model[k], forecasts.linear[k], _seen(forecasts, signature)
    names, ahead = signature.state_names, format_duration(forecasts.horizons[k])
    fine = _fine(forecasts, seen)
    near = f", and {_listed(names, fine)} as exactly as the sensors can tell" if fine else ""
    if doubtful:
        return [f"this model is better than the last value held for {ahead}, but it lacks something", *doubtful]
    large = [i for i in seen if i not in fine and float(ours[i]) > SMALL * signature.x_scale[i]]
    if behind := [i for i in large if float(simple[i]) < 0.9 * float(ours[i])]:
        misses = ", ".join(
            f"{names[i]} by {_short(float(simple[i]))} {signature.state_units[i]} instead of {_short(float(ours[i]))}"
            for i in behind
        )
        return [
            f"this model predicts {ahead} ahead{near}, but a linear model on past samples predicts better, as it "
            f"misses {misses}: a function is missing, or a state that nobody measured"
        ]
    return [f"this model predicts {ahead} ahead{near}"]


def _falls(forecasts: ForecastErrors, signature: Signature) -> list[str]:
    """Say that a plant seems to run away by itself, where a linear model does as well as this one, a line at most."""
    most = LOST * torch.tensor(signature.x_scale, dtype=forecasts.model.dtype)
    most = torch.maximum(most, forecasts.held)
    ours, simple = ((kind > most).any(0) for kind in (forecasts.model, forecasts.linear))
    falls = [name for name, lost in zip(signature.state_names, (ours & simple).tolist(), strict=True) if lost]
    if not falls:
        return []
    fine = (forecasts.model <= HELPFUL * forecasts.held) | (forecasts.model <= RESOLVED * forecasts.resolution)
    enough = (fine | forecasts.held.isnan()).all(1).tolist()
    reached = enough.index(False) if False in enough else len(enough)
    half = "half of the error of the last value held"
    least = f"up to {format_duration(forecasts.horizons[reached - 1])} ahead this model has at most {half}"
    if not reached:
        least = f"this model has more than {half} over any time"
    return [
        f"a linear model on past samples lets {' and '.join(falls)} run away, too: the plant seems to run away by "
        f"itself, as a pole that falls, and no model predicts that for long without the controller; {least}"
    ]


def doubts(forecasts: ForecastErrors, signature: Signature) -> list[str]:
    """Say which states a linear model on past samples predicts far better: what it knows of the past, a state lacks.

    One that is no better than the last value held knows nothing.
    """
    lines, (horizons, n_x), large = [], forecasts.model.shape, unresolved(forecasts, signature)
    large = large & (forecasts.linear < forecasts.held)
    for i in range(n_x):
        ours, simple, known = forecasts.model[:, i], forecasts.linear[:, i], large[:, i]
        worse = [k for k in range(horizons) if bool(known[k]) and float(simple[k]) < BEHIND * float(ours[k])]
        if worse:
            k, unit = worse[0], signature.state_units[i]
            ahead = format_duration(forecasts.horizons[k])
            error = f"to {_short(float(ours[k]))} {unit}" if bool(ours[k].isfinite()) else "runs away"
            lines.append(
                f"a linear model on past samples predicts {signature.state_names[i]} "
                f"{ahead} ahead to {_short(float(simple[k]))} {unit}, this one {error}: a "
                "function is missing, or a state that no sensor sees, as of a motor that follows its command slowly"
            )
    return lines


def unresolved(forecasts: ForecastErrors, signature: Signature) -> Tensor:
    """Return where errors are larger than the sensors explain and than counts as small, bool `(horizons, n_x)`."""
    small = SMALL * torch.tensor(signature.x_scale, dtype=forecasts.model.dtype)
    return forecasts.model > torch.maximum(RESOLVED * forecasts.resolution.to(small), small)


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
    followed = model.followed | _moved_alone(model)
    reads = {name: {name, *(a for a, signal in followed.items() if signal == name)} for name, _ in both}
    return {
        name: known for name, known in both if any(_bent(feature, reads[name], model.signature) for feature in used)
    }


def _moved_alone(model: SindyModel) -> dict[str, str]:
    """Return the states whose equations read themselves and one input alone, linearly, and settle: measured actuators.

    As far as its input goes beyond the log, so does such a state, as the angle of a blade its command.
    """
    found, inputs = {}, {*model.signature.input_names}
    for name, column in zip(model.signature.state_names, model.coefficients.unbind(-1), strict=True):
        features = _used(model.library.features, column)
        read = {v for feature in features for v in feature.variables}
        settles = any(float(size) < 0 for word, size in zip(model.library.names, column, strict=True) if word == name)
        if (
            settles
            and len(read & inputs) == 1
            and read <= {name, *inputs}
            and not any(_bent(f, read, model.signature) for f in features)
        ):
            found[name] = (read & inputs).pop()
    return found


def unlogged(model: SindyModel, logged: Tensor, targets: Mapping[str, tuple[float, float]]) -> list[str]:
    """Say which outputs have targets so far beyond the log that the equations are a guess there.

    Args:
        model: The equations; of an output that none of them reads, as the place of a cart, any value is as good.
        logged: States of the log, `(N, n_x)`, NaN where they were not measured.
        targets: Lower and upper end of the targets of each output.
    """
    used, lines = _used(model.library.features, model.coefficients.any(-1)), []
    read = {variable for feature in used for variable in feature.variables}
    for name, (least, most) in targets.items():
        place = model.signature.state_index(name)
        seen = logged[:, place][logged[:, place].isfinite()]
        if name not in read or not len(seen):
            continue
        low, high = float(seen.min()), float(seen.max())
        if least < low - AFAR * (high - low) or most > high + AFAR * (high - low):
            unit = model.signature.state_units[place]
            lines.append(
                f"the targets of {name} go from {least:.3g} to {most:.3g} {unit}, the log from {low:.3g} to "
                f"{high:.3g}: what the equations say so far beyond is a guess, so log it there, or give targets nearer "
                "to the log"
            )
    return lines


def uncontrolled_outputs(model: SindyModel, outputs: Sequence[str]) -> str:
    """Say which outputs no input moves in the equations, be it through other states; empty if all are moved."""
    names, moved = model.signature.state_names, set(model.signature.input_names)
    read = {
        name: {v for feature in _used(model.library.features, column) for v in feature.variables}
        for name, column in zip(names, model.coefficients.unbind(-1), strict=True)
    }
    for _ in names:
        moved |= {name for name in names if read[name] & moved}
    if still := [name for name in outputs if name not in moved]:
        return (
            f"in the equations that were found no input moves {', '.join(still)}, so nothing can be planned: the log "
            "hardly shows what the inputs do; record longer, and let every input change often and by much"
        )
    return ""


def beyond(model: SindyModel, logged: Tensor, flown: Tensor) -> list[str]:
    """Say which inputs flights take to where the log never had them, if equations are not linear in them.

    A controller that was planned with the log stays where it is known; another one may not.

    Args:
        model: The equations.
        logged: Inputs of the log, `(N, n_u)`.
        flown: Inputs of flights, `(M, n_u)`.
    """
    lines, names = [], model.signature.input_names
    for name, (low, high) in logged_input_ranges(model, logged).items():
        column = flown[:, names.index(name)]
        least, most = float(column.min()), float(column.max())
        if least < low - ROUNDED or most > high + ROUNDED:
            lines.append(
                f"flights take {name} from {least:.2g} to {most:.2g}, the log tells of {low:.2g} to {high:.2g}, and "
                "the equations are not linear in it: what it does beyond is a guess; plan with the log, or log all of "
                "the range"
            )
    return lines


def _used(features: Sequence[Feature], coefficients: Tensor) -> list[Feature]:
    """Return the functions whose coefficients `(n_features,)` are not zero."""
    return [features[k] for k in coefficients.nonzero().flatten().tolist()]


def _bent(feature: Feature, read: set[str], signature: Signature) -> bool:
    """Tell whether a function bends in an input in a way that a log alone tells.

    Sine and cosine of an angle do not: they are geometry, and the same beyond the log. Those of anything else do.
    """
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    mine = [factor for factor in feature.factors if read & set(factor.variables)]

    def _straight(factor: Factor) -> bool:
        turned = not factor.fitted and all(units.get(name) == "rad" for name in factor.variables)
        plain = factor.function in ("id", "ahead") or (factor.function in ("sin", "cos") and turned)
        return plain and factor.power == 1

    return len(mine) > 1 or not all(map(_straight, mine))


def shortcoming(forecasts: ForecastErrors, signature: Signature) -> str:
    """Say what keeps the model from being one that predicts; empty of one that does."""
    k, seen = forecasts.middle, _seen(forecasts, signature)
    ours, held, names, ahead = forecasts.model[k], forecasts.held[k], signature.state_names, forecasts.horizons[k]
    if lost := [i for i in seen if not math.isfinite(float(ours[i]))]:
        return f"within {format_duration(ahead)} {_listed(names, lost)} run{'s' * (len(lost) == 1)} away"
    fine = _fine(forecasts, seen)
    poor = [i for i in seen if i not in fine and not float(ours[i]) <= HELPFUL * float(held[i])]
    if not poor:
        return ""
    said = ", ".join(f"{names[i]} by {_short(float(ours[i]))} {signature.state_units[i]}" for i in poor)
    than = ", ".join(_short(float(held[i])) for i in poor)
    return f"over {format_duration(ahead)} it misses {said}; the last value held misses {than}"


def _seen(forecasts: ForecastErrors, signature: Signature) -> list[int]:
    """Return the states that were measured."""
    return [i for i in range(signature.n_x) if not math.isnan(float(forecasts.held[forecasts.middle, i]))]


def _fine(forecasts: ForecastErrors, seen: Sequence[int]) -> list[int]:
    """Return the states that are predicted as well as a sensor can tell."""
    ours = forecasts.model[forecasts.middle]
    return [i for i in seen if float(ours[i]) <= RESOLVED * float(forecasts.resolution[i])]


def describe_data(data: Transitions, signature: Signature) -> list[str]:
    """Say what the sensors and the inputs of a log show: steps, saturation, a controller."""
    lines = []
    for name, unit, column in zip(signature.state_names, signature.state_units, samples_of(data), strict=True):
        if step := sensor_resolution(column):
            coarse = step > COARSE * float(np.ptp(column[~np.isnan(column)]))
            more = (
                "; standard errors take it that the sensor rounds: one that cuts off reads half a step too low, "
                "which no log tells and none of them holds"
            )
            lines.append(f"{name} is read in steps of {step:.3g} {unit}{more * coarse}")
    limits = signature.input_limits or ((-1.0, 1.0),) * signature.n_u
    ends = signature.in_own_units(np.array(limits).T).T.tolist()
    units = signature.input_units or ("-",) * signature.n_u
    told = zip(signature.input_names, saturated(data, limits).tolist(), ends, units, strict=True)
    for name, share, (low, high), unit in told:
        if share:
            reach = f"{low:.6g} to {high:.6g}{'' if unit == '-' else f' {unit}'}"
            lines.append(f"{name} is at an end of its range, {reach}, in {100 * share:.0f} % of the samples")
    if driven := [name for name, told in zip(signature.input_names, closed_loop(data), strict=True) if told]:
        lines.append(f"a controller made {' and '.join(driven)} out of the measured states (closed loop)")
    return lines


def _listed(names: Sequence[str], places: Sequence[int]) -> str:
    return ", ".join(names[i] for i in places)


def _short(value: float) -> str:
    if math.isnan(value):
        return "-"
    return f"{value:.2g}" if abs(value) < 100 else (f"{value:.0f}" if math.isfinite(value) else "runs away")


def errors(forecasts: ForecastErrors, signature: Signature) -> dict[str, dict[str, float]]:
    """Return the errors over each horizon, of the states that were measured, for a file."""
    seen = [i for i in range(signature.n_x) if not bool(torch.isnan(forecasts.held[:, i]).all())]
    kinds = {"": forecasts.model, "linear_": forecasts.linear, "held_": forecasts.held}
    return {
        f"{kind}rmse_{h:g}_s": {signature.state_names[i]: float(found[k, i]) for i in seen}
        for kind, found in kinds.items()
        for k, h in enumerate(forecasts.horizons)
    }
