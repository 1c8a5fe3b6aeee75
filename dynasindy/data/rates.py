"""Whether a measured rate is the slope of its angle, or of another unit or sign, as degrees beside rad/s."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import pandas as pd
import torch
from torch import Tensor

from dynasindy.data.columns import Column, as_map
from dynasindy.data.headings import is_rate_of
from dynasindy.findings import Finding, LogError, weak
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

PLAIN_RATES = ("rate", "velocity", "speed")
"""What a rate is called that may be that of any state, where no unit says so."""
CLEAR = 3.0
"""Factor between slope and rate, either way, from which on a unit is wrong: no filter or noise makes as much."""
TIED = 0.95
"""Correlation from which on a state is told to move by the integral of another one; the factor is sure within 5 %."""
ALIKE = 0.99
"""The same where only the units make it likely: coupled axes move alike, too."""
STRETCHES = 20
"""Stretches into which a recording falls at least: fewer may go together by chance."""
RPM = 2 * math.pi / 60
"""A turn per minute [rad/s]."""
NO_TIE = (0.0, 0.0)
"""Factor and correlation of what does not move."""
FACTORS = (180 / math.pi, math.pi / 180, RPM, 6.0, 1 / 60, 2 * math.pi, 0.5 / math.pi, 1e3, 1e-3, 1e2, 1e-2, 1e-6, 1.0)
"""Factors between the slope of a state and its rate that units make: degrees, turns, minutes, and parts of a unit."""


def check_rates(data: Transitions, signature: Signature, known: Mapping[str, str]) -> list[Finding]:
    """Return which states clearly do not move by their rates, and which rates are in other units than their states.

    A rate is known to be that of a state, or is called so, or its unit says so. Of several states whose unit fits, it
    is that of the one whose movement follows it most closely.

    Args:
        data: The recording; what was not measured is NaN, and is not judged.
        signature: Names and units of the states.
        known: The rate of each state, as far as it is known; other equations are not looked at.
    """
    names = signature.state_names
    known = {state: rate for state, rate in known.items() if {state, rate} <= set(names)}
    units = dict(zip(names, signature.state_units, strict=True))
    wrong, other = dict[str, Finding](), list[Finding]()

    @cache
    def compare(state: str, rate: str) -> tuple[float, float]:
        return compare_rate(data, names.index(state), names.index(rate))

    for state, rate in known.items():
        (_, correlation), (factor, reverse) = compare(state, rate), compare(rate, state)
        if reverse > TIED and 1 / CLEAR < factor < CLEAR and not correlation > TIED:
            wrong[state] = weak("log.rate_exchanged", state=state, rate=rate, known={rate: state})
        elif compare(state, rate) != NO_TIE and -TIED < correlation < 0.3:  # sensors of much noise leave .5 and more
            wrong[state] = weak("log.rate_contradicted", state=state, rate=rate, correlation=correlation)
    measured = [name for name, column in zip(names, data.x.unbind(-1), strict=True) if bool(column.isfinite().any())]
    for rate in measured:
        sure = [s for s in measured if known.get(s) == rate] or [s for s in measured if is_rate_of(s, rate)]
        plain = rate in PLAIN_RATES and units[rate] == "-"
        fits = (s for s, unit in units.items() if (unit == "-" if plain else signature.rate_unit(s) == units[rate]))
        others = [s for s in fits if s in measured and s not in known and s != rate]
        ties = {s: compare(s, rate) for s in sure or others}
        state, (factor, correlation) = max(ties.items(), key=lambda tie: abs(tie[1][1]), default=("", NO_TIE))
        # The equation of a rate that is known is not fitted, so smaller factors are told.
        clear = 1.25 if known.get(state) == rate and abs(correlation) > ALIKE else CLEAR
        if state in wrong or abs(correlation) <= (TIED if sure else ALIKE) or 1 / clear < factor < clear:
            continue
        other.append(weak("log.rate_units", state=state, rate=rate, factor=factor, guessed=not sure))
    return [*wrong.values(), *other]


def require_consistent_rates(
    data: Transitions, signature: Signature, known: Mapping[str, str], columns: Mapping[str, Column], file: str = ""
) -> list[Finding]:
    """Return what `check_rates` does, but refuse rates that are known and cannot be those of their states.

    Their equations are taken as exact.

    Args:
        data: The recording.
        signature: Names and units of the states.
        known: The rate of each state; other equations are not looked at.
        columns: The columns that were read, by state.
        file: The file, for the message.

    Raises:
        LogError: A rate was exchanged with its state, is in other units, or counts the other way.
    """
    place = {"file": file} if file else {}
    for each in (findings := check_rates(data, signature, known)):
        state, rate = each.values["state"], each.values["rate"]
        if each.code == "log.rate_exchanged":
            raise LogError(each.code, **place, **each.values)
        if each.code != "log.rate_units" or known.get(state) != rate or 1 / CLEAR < each.values["factor"] < CLEAR:
            continue
        unit, column = signature.state_units[signature.state_index(state)], columns[rate]
        # The factor that units make and that is within 5 % of the one that the log tells, else three digits of it.
        factor = each.values["factor"]
        near = min(FACTORS, key=lambda known: abs(math.log(abs(factor) / known)))
        close = abs(math.log(abs(factor) / near)) < 0.05
        scale = (math.copysign(near, factor) if close else float(f"{factor:.3g}")) * column.scale
        mended = {**columns, rate: replace(column, unit=signature.rate_unit(state), scale=scale)}
        allowed = f"the unit of {state} per second" if unit == "-" else signature.rate_unit(state)
        raise LogError(each.code, **place, **each.values, unit=allowed, states=as_map(mended))
    return findings


def compare_rate(data: Transitions, state: int, rate: int) -> tuple[float, float]:
    """Return the slope of a state over the integral of a rate, and their correlation, in windows that fit best."""
    # Noise counts the less the longer a window is; some 5000 of each length are looked at.
    steps = _increments(data, rate)
    lost = torch.cat([torch.zeros(1, dtype=torch.int32), (~steps.isfinite()).cumsum(0, dtype=torch.int32)])
    sums = torch.cat([steps.new_zeros(1), steps.nan_to_num(0.0).cumsum(0)])
    stride = max(1, len(data) // 5000)
    best, window = NO_TIE, 1
    while STRETCHES * window <= len(data):
        rows = torch.arange(0, len(data) - window + 1, stride)
        last = rows + window - 1
        moved = (data.x_next[last, state] - data.x[rows, state]).double()
        whole = (data.segment[rows] == data.segment[last]) & (lost[last + 1] == lost[rows]) & moved.isfinite()
        rows, last, moved = rows[whole], last[whole], moved[whole]
        if len(rows) > STRETCHES and len(rows) * stride > (STRETCHES - 1) * window:
            tie = _ratio(moved, sums[last + 1] - sums[rows])
            best = max(best, tie, key=lambda each: abs(each[1]))
        window *= 2
    return best


def _increments(data: Transitions, rate: int) -> Tensor:
    """Return the integral of a rate over each row, straight over up to ten missing samples, `(N,)`."""
    first, last = data.x[:, rate].double(), data.x_next[:, rate].double()
    if bool((first + last).isnan().any()):
        segment, x = data.begins().cumsum(0).numpy(), pd.Series(first.numpy())
        gap = x.isna() & (x.isna().groupby(x.notna().cumsum()).transform("sum") > 10)  # a line would invent it
        x = x.groupby(segment).transform(lambda each: each.interpolate(limit_area="inside")).mask(gap)
        following = x.groupby(segment).shift(-1).fillna(pd.Series(last.numpy()))
        first, last = (torch.from_numpy(each.to_numpy(copy=True)) for each in (x, following))
    return 0.5 * data.dt * (first + last)


def _ratio(moved: Tensor, integral: Tensor) -> tuple[float, float]:
    """Return the factor between two columns and their correlation, without the rows that fit worst."""
    keep = torch.ones(len(moved), dtype=torch.bool)
    factor = correlation = 0.0
    for _ in range(2):
        a, b = moved[keep] - moved[keep].mean(), integral[keep] - integral[keep].mean()
        sizes = float(a.norm()), float(b.norm())
        if not min(sizes) > 0:
            return NO_TIE
        correlation = float(a @ b) / (sizes[0] * sizes[1])
        factor = math.copysign(sizes[0] / sizes[1], correlation)
        left = (moved - moved[keep].mean() - factor * (integral - integral[keep].mean())).abs()
        keep = left <= torch.quantile(left, 0.95)  # others may be jumps, as of an angle counted modulo a turn
    return factor, correlation
