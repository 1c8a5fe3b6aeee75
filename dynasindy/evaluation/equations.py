"""What fitted equations hold, in the words of an engineer: delay, dry friction, springs, dead zones, idle states."""

from __future__ import annotations

import numpy as np

from dynasindy.evaluation.before_fit import rate_setting
from dynasindy.sindy import FitReport, SindyModel
from dynasindy.sindy.functions import QUOTIENTS
from dynasindy.sindy.input_nonlinearity import InputNonlinearity, read_nonlinearity
from dynasindy.sindy.library import Feature
from dynasindy.sindy.reconstruction import rate_states
from dynasindy.systems.transitions import Transitions
from dynasindy.text import format_duration

LATE = "the inputs act"
"""First words of the line that tells a delay."""
FULL = 5.0
"""Widths of a function tanh(rate / width), at least, in the range of the rate, for it to be dry friction."""
SHORT = 0.5
"""Delay that a poor fit does not tell from none [sampling times]."""
TOLD = 0.02
"""Part of a function that the others of its equation leave over, above which the data tell its coefficient."""


def describe_delay(delay: float) -> str:
    """Say how late the inputs act.

    Args:
        delay: Delay of the inputs [s].
    """
    return f"{LATE} {f'{1e3 * delay:.3g} ms' if delay < 1 else format_duration(delay)} late"


def describe_model(model: SindyModel, report: FitReport | None = None) -> list[str]:
    """Say what of delay, dry friction, springs, dead zones and saturations is in the equations.

    Args:
        model: a fitted model.
        report: of its fit, which tells what the data do not: a delay that is the longest that was tried, or far less
            than a sampling time where the fit is poor, is none, and functions whose coefficients the data do not tell
            are no friction and no spring.
    """
    names, lines = model.signature.state_names, []
    told = None if report is None else report.told_apart()
    if model.delay and (report is None or _sure(model.delay, report)):
        lines.append(describe_delay(model.delay))
    of_rate = rate_states(model.library, model.constraints)
    for i in range(len(names)):
        clear = model.coefficients[:, i] != 0
        used = (clear if told is None else clear & (told[:, i] > TOLD)).nonzero().flatten().tolist()
        terms = [model.library.features[k] for k in used]
        size = model.signature.x_scale[i]
        if any(_is_dry(model.library.features[k], names[i], size) and model.coefficients[k, i] < 0 for k in used):
            lines.append(f"{names[i]}' has dry friction")
        moved = [*model.signature.input_names, *model.followed]
        lines += [said for name in moved if (said := _bend_in_words(read_nonlinearity(model, i, name), model))]
        if i in of_rate and any(_is_spring(f, names[of_rate[i]]) for f in terms):
            lines.append(f"{names[i]}' has a spring in {names[of_rate[i]]}")
    return [*dict.fromkeys(lines)]


def _bend_in_words(bend: InputNonlinearity | None, model: SindyModel) -> str:
    """Say what a dead zone or a saturation does, in the unit of its actuator; empty where there is none."""
    if bend is None:
        return ""
    signature = model.signature
    place = signature.input_names.index(model.followed.get(bend.input, bend.input))
    ends = np.tile(np.array([[bend.low], [bend.high]]), signature.n_u)
    low, high = signature.in_own_units(ends)[:, place].tolist()
    unit = signature.input_units[place] if signature.input_units else "-"
    told = [f"{end:.3g}{'' if unit == '-' else f' {unit}'}" for end in (low, high)]
    if bend.kind == "dead zone":
        return f"{bend.input} does nothing from {told[0]} to {told[1]}"
    sides = [f"{side} {end}" for side, end in zip(("below", "above"), told, strict=True) if "inf" not in end]
    return f"{bend.input} has no more effect {' and '.join(sides)}"


def bend_hint(bend: InputNonlinearity, model: SindyModel) -> str:
    """Say which dead zone or saturation the equations seem to lack, and the words that fit one.

    Args:
        bend: what `missing_bend` found.
        model: a fitted model.
    """
    names = model.signature.state_names
    known = {names[i]: names[rate] for rate, i in rate_states(model.library, model.constraints).items()}
    words = " ".join(["plant.library=dead_zone", *([f"'{rate_setting(known)}'"] if known else [])])
    return (
        f"hint: what the equations leave over looks like a {bend.kind}, as if {_bend_in_words(bend, model)}, about: "
        f"{words} fits such bends of the inputs beside linear functions"
    )


def hidden_states(model: SindyModel, data: Transitions) -> list[str]:
    """Return the states that no sensor sees in any form: no rates of measured states, and none that only follow.

    Args:
        model: the model.
        data: the log, NaN where a state was not measured.
    """
    rates, unseen = rate_states(model.library, model.constraints), data.x.isnan().all(0).tolist()
    names = model.signature.state_names
    alone = [i for i, blind in enumerate(unseen) if blind and (i not in rates or unseen[rates[i]])]
    return [names[i] for i in alone if names[i] not in model.followed]


def idle(model: SindyModel, data: Transitions) -> list[str]:
    """Say which hidden states stand in no equation, and how to give a first guess of their equations, in a line.

    Args:
        model: a fitted model.
        data: the log, NaN where a state was not measured.
    """
    names, inputs = model.signature.state_names, model.signature.input_names
    used = [f for f, own in zip(model.library.features, model.coefficients.any(-1).tolist(), strict=True) if own]
    read = {name for feature in used for name in feature.variables}
    still = [n for n in hidden_states(model, data) if n not in read and not model.coefficients[:, names.index(n)].any()]
    if not still:
        return []
    seen = next((name for name, blind in zip(names, data.x.isnan().all(0).tolist(), strict=True) if not blind), "")
    first = [*(f"{name}: {{{inputs[0]}: 0.1, {name}: -0.1}}" for name in still[:1]), f"{seen}: {{{still[0]}: 0.1}}"]
    stands, needs = ("stands", "it needs") if len(still) == 1 else ("stand", "they need")
    return [
        f"hint: {' and '.join(still)} {stands} in no equation: no sensor sees what it does in any form, so {needs} a "
        f"first guess of the equations, as in 'plant.initial={{{', '.join(first)}}}', with numbers of your plant"
    ]


def _sure(delay: float, report: FitReport) -> bool:
    """Tell whether a delay of the inputs is one, and does not stand for what the equations lack."""
    return not report.delay_at_end and not (report.in_pieces and delay < SHORT * (report.dt or 0.0))


def _is_dry(feature: Feature, rate: str, size: float) -> bool:
    """Tell what opposes a rate alike at any speed but the lowest; of the other sign it would drive.

    Args:
        feature: the function.
        rate: name of the rate.
        size: its range; a function that bends only there is a drag.
    """
    return any(
        factor.function == "tanh" and rate in factor.variables and factor.frequency * size >= FULL
        for factor in feature.factors
    )


def _is_spring(feature: Feature, angle: str) -> bool:
    """Tell the angle itself, whatever inertia it is divided by."""
    return any(f.function == "id" and f.power == 1 and f.variables == (angle,) for f in feature.factors) and all(
        f.function in ("id", *QUOTIENTS) and (f.function != "id" or f.variables == (angle,)) for f in feature.factors
    )
