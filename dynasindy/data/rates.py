"""Whether a measured rate is the slope of its angle, or of another unit or sign, as degrees beside rad/s."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from dynasindy.findings import Finding, LogError, weak
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

CLEAR = 3.0
"""Factor between slope and rate, either way, from which on a unit is wrong: no filter or noise makes as much."""
EXACT = 1.25
"""The same of a rate that is known to be that of a state: its equation is not fitted, so smaller factors are told."""
TIED = 0.95
"""Correlation from which on a state is told to move by the integral of another one; the factor is sure within 5 %."""
LOOSE = 0.3
"""Correlation below which a state does not move by what is said to be its rate; sensors as noisy as their states move
by half leave more."""
ALIKE = 0.99
"""The same where only the units make it likely: coupled axes move alike, too."""
USUAL = 0.95
"""Part of the rows that a factor is told from; others may be jumps, as of an angle that is counted modulo a turn."""
STRETCHES = 20
"""Stretches into which a recording falls at least: fewer may go together by chance."""
ROWS = 5000
"""Rows that are looked at."""
BRIDGED = 10
"""Samples of a rate that may be missing in a row; over these it is taken to be straight, over more nothing is told."""
NAMED = ("{}_rate", "{}_dot", "{}dot", "d{}", "d_{}", "{}_vel", "{}_velocity", "{}_speed")
"""How the rate of a state is called."""
PLAIN = ("rate", "velocity", "speed")
"""What a rate is called that may be that of any state."""
RPM = 2 * math.pi / 60
"""A turn per minute [rad/s]."""
NEAR = 0.05
"""Part by which a factor that the log tells may differ from one whose cause is known."""
KINDS = (("rad", "mrad", "deg", "degree", "degrees", "°", "rev", "turn", "turns"), ("m", "cm", "mm", "km"))
"""Units of one kind."""
PER_TIME = re.compile(r"(.+)/(s|sec|ms|min|h)")
"""How the unit of a rate is written, but for rpm."""
NO_TIE = (0.0, 0.0)
"""Factor and correlation of what does not move."""
CAUSES = {
    180 / math.pi: "degrees beside rad/s",
    math.pi / 180: "rad beside degrees per second",
    RPM: "rad beside rpm",
    6.0: "degrees beside rpm",
    1 / 60: "a rate per minute",
    2 * math.pi: "rad beside revolutions per second",
    0.5 / math.pi: "revolutions beside rad/s",
    1e3: "thousandths of a unit beside the unit, as mm beside m/s",
    1e-3: "a time in ms without its unit, or m beside mm/s",
    1e2: "hundredths of a unit beside the unit, as cm beside m/s",
    1e-2: "m beside cm/s",
    1e-6: "a time in us without its unit",
    1.0: "one of them counted the other way",
}
"""What a factor between the slope of a state and its rate comes from."""


@dataclass(frozen=True)
class Mismatch:
    """Hold a rate that is not the slope of its state.

    Attributes:
        state: name of the state.
        rate: name of its rate.
        factor: slope of the state over the rate.
        guessed: whether only units, or a name that may be of any rate, say that the two belong together.
    """

    state: str
    rate: str
    factor: float
    guessed: bool = False

    @property
    def finding(self) -> Finding:
        """The finding."""
        facts = {"state": self.state, "rate": self.rate, "factor": self.factor, "cause": self.cause()}
        return weak("log.unit_of_rate", **facts, guessed=self.guessed)

    @property
    def likely(self) -> float:
        """The factor that the rate lacks: that of the likely cause, or else the one of the log to three digits."""
        size = abs(self.factor)
        near = min(CAUSES, key=lambda known: abs(math.log(size / known)))
        return math.copysign(near if abs(math.log(size / near)) < NEAR else float(f"{size:.3g}"), self.factor)

    def cause(self) -> str:
        """Say what the factor comes from, its sign too."""
        size, turned = abs(self.factor), self.factor < 0
        near = min(CAUSES, key=lambda known: abs(math.log(size / known)))
        if abs(math.log(size / near)) >= NEAR:
            return "in which units are they" + ", and which one is counted the other way" * turned
        return CAUSES[near] + ", and one of them counted the other way" * (turned and near != 1.0)


def unit_of_rate(unit: str) -> str:
    """Return the unit of the rate of a state, per second."""
    return "1/s" if unit == "-" else f"{unit}/s"


def with_rates(signature: Signature, known: Mapping[str, str]) -> Signature:
    """Return a signature with the rates that are known to belong to a state and are no states yet, behind the others.

    Args:
        signature: Names and units.
        known: The rate of each state, by its name; other equations add nothing.
    """
    for name, rate in known.items():  # a rate may be a state that has a rate
        if name in signature.state_names and rate not in signature.state_names and rate.isidentifier():
            signature = signature.with_state(rate, unit_of_rate(signature.state_units[signature.state_index(name)]))
    return signature


def contradicted(data: Transitions, signature: Signature, known: Mapping[str, str]) -> dict[str, Finding]:
    """Return the states that clearly do not move by what is said to be their rate.

    Args:
        data: the recording; what was not measured is NaN, and is not judged.
        signature: names and units of the states.
        known: the rate of each state, as it was said.
    """
    told, names = _exchanged(data, signature, known), signature.state_names
    for state, rate in known.items():
        tie = _factor(data, names.index(state), names.index(rate))
        if state not in told and tie != NO_TIE and -TIED < tie[1] < LOOSE:
            told[state] = weak("log.rate_contradicted", state=state, rate=rate, correlation=tie[1])
    return told


def _exchanged(data: Transitions, signature: Signature, known: Mapping[str, str]) -> dict[str, Finding]:
    """Return the states that are clearly the rates of what is said to be their rate.

    Args:
        data: the recording.
        signature: names and units of the states.
        known: the rate of each state, as it was said.
    """
    told, names = {}, signature.state_names
    for state, rate in known.items():
        places = names.index(state), names.index(rate)
        tie, turned = _factor(data, *places), _factor(data, *reversed(places))
        if turned[1] > TIED and 1 / CLEAR < turned[0] < CLEAR and not tie[1] > TIED:
            told[state] = weak("log.rate_exchanged", state=state, rate=rate, known={rate: state})
    return told


def mismatched(data: Transitions, signature: Signature, known: Mapping[str, str] | None = None) -> list[Mismatch]:
    """Return the rates that are clearly not the slopes of their states.

    A rate is known to be that of a state, or is called so, or its unit says so. Of several states whose unit fits, it
    is that of the one whose movement follows it most closely.

    Args:
        data: the recording, NaN where a state was not measured.
        signature: names and units of the states.
        known: the rate of each state, as far as it is known.
    """
    names, pairs = signature.state_names, dict(known or {})
    seen = [name for name, column in zip(names, data.x.unbind(-1), strict=True) if bool(column.isfinite().any())]
    found = []
    for rate in seen:
        sure = [state for state in seen if pairs.get(state) == rate] or [s for s in seen if is_rate_of(s, rate)]
        others = [s for s in seen if s not in pairs and s != rate and _may_be(s, rate, signature)]
        ties = {state: _factor(data, names.index(state), names.index(rate)) for state in sure or others}
        state, tie = max(ties.items(), key=lambda item: abs(item[1][1]), default=("", NO_TIE))
        clear = EXACT if pairs.get(state) == rate and abs(tie[1]) > ALIKE else CLEAR
        if abs(tie[1]) > (TIED if sure else ALIKE) and not 1 / clear < tie[0] < clear:
            found.append(Mismatch(state, rate, tie[0], guessed=not sure))
    return found


def _misfit(data: Transitions, signature: Signature, known: Mapping[str, str]) -> list[Mismatch]:
    """Return the rates that are known to be those of a state and are clearly in other units, or of the other sign.

    Where the log contradicts that the two belong together, nothing is told of their units.

    Args:
        data: The recording.
        signature: Names and units of the states.
        known: The rate of each state; other equations tell nothing.
    """
    pairs = {s: rate for s, rate in known.items() if {s, rate} <= set(signature.state_names)}
    wrong = contradicted(data, signature, pairs)
    found = [m for m in mismatched(data, signature, pairs) if not 1 / CLEAR < m.factor < CLEAR]
    return [m for m in found if pairs.get(m.state) == m.rate and m.state not in wrong]


def require_consistent_rates(
    data: Transitions, signature: Signature, known: Mapping[str, str], mend: Callable[[Mismatch], Mapping[str, Any]]
) -> None:
    """Refuse rates that are known and cannot be those of their states, for their equations are taken as exact.

    Args:
        data: The recording.
        signature: Names and units of the states.
        known: The rate of each state; other equations are not looked at.
        mend: Returns the column map of the states that mends a rate in other units, or of the other sign.

    Raises:
        ValueError: A rate was exchanged with its state, is in other units, or counts the other way.
    """
    pairs = {s: rate for s, rate in known.items() if {s, rate} <= set(signature.state_names)}
    for exchanged in _exchanged(data, signature, pairs).values():
        raise LogError(exchanged.code, **exchanged.values)
    for wrong in _misfit(data, signature, pairs):
        unit = signature.state_units[signature.state_index(wrong.state)]
        allowed = f"the unit of {wrong.state} per second" if unit == "-" else unit_of_rate(unit)
        facts = {"state": wrong.state, "rate": wrong.rate, "factor": wrong.factor, "cause": wrong.cause()}
        raise LogError("log.rate_units", **facts, unit=allowed, states=mend(wrong))


def turning(data: Transitions, angles: Sequence[int], speeds: Sequence[int]) -> dict[int, int]:
    """Return the angles whose slope over time is a column in turns per minute, each with this column.

    Args:
        data: The recording.
        angles: Places of states in rad.
        speeds: Places of states in turns per minute.
    """
    found = {}
    for speed in speeds:
        for angle in angles:
            factor, correlation = _factor(data, angle, speed)
            if abs(correlation) > ALIKE and abs(math.log(abs(factor) / RPM)) < NEAR:
                found[angle] = speed
    return found


def is_rate_of(state: str, rate: str) -> bool:
    """Tell whether a column is called the rate of another one, as `arm_rate` of `arm`."""
    return rate in (pattern.format(state) for pattern in NAMED)


def _may_be(state: str, rate: str, signature: Signature) -> bool:
    """Return whether the units allow a rate to be that of a state; without units its name must be that of a rate."""
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    if rate in PLAIN and units[rate] == "-":
        return units[state] == "-"
    per_time = PER_TIME.fullmatch("rev/min" if units[rate] == "rpm" else units[rate])
    if per_time is None or (rate not in PLAIN and not units[rate].endswith(("/s", "/sec"))):
        return False
    return units[state] == per_time[1] or any({units[state], per_time[1]} <= set(kind) for kind in KINDS)


def _factor(data: Transitions, state: int, rate: int) -> tuple[float, float]:
    """Return the slope of a state over a rate, and their correlation.

    What the state moves by over a window is compared with the integral of the rate, by the trapezoidal rule: noise
    counts the less the longer the window is, so that the one is taken over which they go together best. A window has
    the state at both ends and the rate all along.
    """
    samples, places = _bridged(data, rate), _places(data)
    steps = 0.5 * data.dt * (samples[places] + samples[places + 1])
    sums, lost = (torch.cat([c.new_zeros(1), c.cumsum(0)]) for c in (steps.nan_to_num(0.0), (~steps.isfinite()).long()))
    stride = max(1, len(data) // ROWS)
    best, window = NO_TIE, 1
    while STRETCHES * window <= len(data):
        rows = torch.arange(0, len(data) - window + 1, stride)
        last = rows + window - 1
        moved = (data.x_next[last, state] - data.x[rows, state]).double()
        whole = (data.segment[rows] == data.segment[last]) & (lost[last + 1] == lost[rows]) & moved.isfinite()
        rows, last, moved = rows[whole], last[whole], moved[whole]
        if len(rows) > STRETCHES and len(rows) * stride > (STRETCHES - 1) * window:
            told = _compared(moved, sums[last + 1] - sums[rows])
            best = max(best, told, key=lambda tie: abs(tie[1]))
        window *= 2
    return best


def _places(data: Transitions) -> Tensor:
    """Return where the start of each row is among the samples: a segment has one more of them than rows."""
    return torch.arange(len(data)) + data.begins().long().cumsum(0) - 1


def _bridged(data: Transitions, state: int) -> Tensor:
    """Return the samples of a state, straight over the few that are missing in a row and NaN over more."""
    places, segments = _places(data), data.begins().long().cumsum(0)
    samples = torch.full((len(data) + int(segments.max()),), math.nan, dtype=torch.float64)
    segment = torch.zeros(len(samples), dtype=torch.int64)
    for offset, x in enumerate((data.x, data.x_next)):
        samples[places + offset], segment[places + offset] = x[:, state].double(), segments
    seen = samples.isfinite().nonzero().squeeze(-1)
    if not len(seen):
        return samples
    at = torch.arange(len(samples))
    after = torch.searchsorted(seen, at).clamp(max=len(seen) - 1)
    left, right = seen[(after - (seen[after] > at).long()).clamp(min=0)], seen[after]
    share = (at - left) / (right - left).clamp(min=1)
    values = samples[left] + share * (samples[right] - samples[left])
    inside = (left <= at) & (at <= right) & (right - left <= BRIDGED + 1) & (segment[left] == segment[right])
    return values.where(inside, math.nan)


def _compared(moved: Tensor, integral: Tensor) -> tuple[float, float]:
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
        keep = left <= torch.quantile(left, USUAL)
    return factor, correlation
