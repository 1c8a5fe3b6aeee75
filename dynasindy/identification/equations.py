"""What fitted equations hold: delay, dry friction, dead zones, saturations, idle states."""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np

from dynasindy.findings import Finding, note, weak
from dynasindy.sindy import FitReport, SindyModel
from dynasindy.sindy.library import Feature
from dynasindy.sindy.reconstruction import rate_states
from dynasindy.systems.transitions import Transitions

FULL = 5.0
"""Widths of a function tanh(rate / width), at least, in the range of the rate, for it to be dry friction."""
FLAT = 0.1
"""Slope in a part of the range of an input below which it does nothing there [largest slope]."""
TOLD = 0.02
"""Part of a function that the others of its equation leave over, above which the data tell its coefficient."""


def _nonlinearity(model: SindyModel, state: int, name: str) -> Finding | None:
    """Return the dead zone or the saturation of an input, or of a state that stands for it, in an equation.

    One that a saturation lacks is infinite. `slopes` are below the first of `edges`, between them, and above the last.
    """
    edges: dict[float, float] = {}
    slope = 0.0
    for k in model.coefficients[:, state].nonzero().flatten().tolist():
        feature, size = model.library.features[k], float(model.coefficients[k, state])
        if name not in feature.variables:
            continue
        (first, *others) = feature.factors
        if others or first.power != 1 or first.variables != (name,) or first.function not in ("id", "hinge"):
            return None
        if first.function == "id":
            slope += size
        else:
            edges[first.frequency] = edges.get(first.frequency, 0.0) + size
    rising = sorted(edges)
    slopes = list(accumulate((edges[edge] for edge in rising), initial=slope))
    still = [abs(slope) <= FLAT * max(map(abs, slopes)) for slope in slopes]
    if all(still) or True not in still:
        return None
    if still[0] or still[-1]:
        kind, ends = "saturation", [rising[0] if still[0] else -math.inf, rising[-1] if still[-1] else math.inf]
    else:
        kind, ends = "dead zone", rising[still.index(True) - 1 : still.index(True) + 1]
    signature = model.signature
    place = signature.input_names.index(model.followed.get(name, name))
    low, high = signature.in_own_units(np.tile(np.array(ends)[:, None], signature.n_u))[:, place].tolist()
    unit = signature.input_units[place] if signature.input_units else "-"
    return note("model.input_nonlinearity", input=name, kind=kind, low=low, high=high, unit=unit)


def equation_findings(model: SindyModel, report: FitReport | None = None) -> list[Finding]:
    """Return what of delay, dry friction, dead zones and saturations is in the equations.

    Args:
        model: a fitted model.
        report: of its fit, which tells what the data do not: a delay that is the longest that was tried is none, and
            functions whose coefficients the data do not tell are no friction.
    """
    names, findings = model.signature.state_names, []
    resolved = None if report is None else report.told_apart()
    if model.delay and not (report is not None and report.delay_at_end):
        findings.append(note("model.delay", seconds=model.delay))
    for i in range(len(names)):
        clear = model.coefficients[:, i] != 0
        used = (clear if resolved is None else clear & (resolved[:, i] > TOLD)).nonzero().flatten().tolist()
        size = model.signature.x_scale[i]
        if any(_is_dry(model.library.features[k], names[i], size) and model.coefficients[k, i] < 0 for k in used):
            findings.append(note("model.dry_friction", state=names[i]))
        for name in [*model.signature.input_names, *model.followed]:
            found = _nonlinearity(model, i, name)
            if found is not None and found not in findings:
                findings.append(found)
    return findings


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


def idle_states(model: SindyModel, data: Transitions) -> list[Finding]:
    """Return which hidden states stand in no equation, and an example of a first guess of their equations.

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
    return [
        weak(
            "model.idle_state",
            states=still,
            initial={still[0]: {inputs[0]: 0.1, still[0]: -0.1}, seen: {still[0]: 0.1}},
        )
    ]


def _is_dry(feature: Feature, rate: str, size: float) -> bool:
    """Tell what opposes a rate alike at any speed but the lowest; what bends only at the range of it is a drag."""
    return any(
        factor.function == "tanh" and rate in factor.variables and factor.frequency * size >= FULL
        for factor in feature.factors
    )
