"""Whether a measured rate is the slope of its angle, or of another unit or sign, as degrees beside rad/s."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

CLEAR = 3.0
"""Factor between slope and rate, either way, from which on a unit is wrong: no filter or noise makes as much."""
TIED = 0.95
"""Correlation from which on a state is told to move by the integral of another one; the factor is sure within 5 %."""
ALIKE = 0.99
"""The same where only the units make it likely: coupled axes move alike, too."""
USUAL = 0.95
"""Part of the rows that a factor is told from; others may be jumps, as of an angle that is counted modulo a turn."""
STRETCHES = 20
"""Stretches into which a recording falls at least: fewer may go together by chance."""
ROWS = 5000
"""Rows that are looked at."""
NAMED = ("{}_rate", "{}_dot", "{}dot", "d{}", "d_{}", "{}_vel", "{}_velocity", "{}_speed")
"""How the rate of a state is called."""
PLAIN = ("rate", "velocity", "speed")
"""What a rate is called that may be that of any state."""
KINDS = (("rad", "mrad", "deg", "degree", "degrees", "°", "rev", "turn", "turns"), ("m", "cm", "mm", "km"))
"""Units of one kind."""
NO_TIE = (0.0, 0.0)
"""Factor and correlation of what does not move."""
CAUSES = {
    180 / math.pi: "degrees beside rad/s",
    math.pi / 180: "rad beside degrees per second",
    2 * math.pi / 60: "rad beside rpm",
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
    """

    state: str
    rate: str
    factor: float

    def __str__(self) -> str:
        """Write it as a sentence."""
        size = abs(self.factor)
        near = min(CAUSES, key=lambda known: abs(math.log(size / known)))
        likely = f"; {CAUSES[near]}?" if abs(math.log(size / near)) < 0.05 else "; in which units are they?"
        factor = f"{self.factor:.3g}"
        return (
            f"{self.rate} does not fit {self.state}, whose slope over time is {factor} times {self.rate}{likely} "
            f"Correct the column, or give it a scale in data.states"
        )


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
    seen = [name for name, column in zip(names, data.x.unbind(-1), strict=True) if not bool(column.isnan().any())]
    found = []
    for rate in seen:
        sure = [state for state in seen if pairs.get(state) == rate] or [s for s in seen if _is_named(s, rate)]
        others = [s for s in seen if s not in pairs and s != rate and _may_be(s, rate, signature)]
        ties = {state: _factor(data, names.index(state), names.index(rate)) for state in sure or others}
        state, tie = max(ties.items(), key=lambda item: abs(item[1][1]), default=("", NO_TIE))
        if abs(tie[1]) > (TIED if sure else ALIKE) and not 1 / CLEAR < tie[0] < CLEAR:
            found.append(Mismatch(state, rate, tie[0]))
    return found


def _is_named(state: str, rate: str) -> bool:
    return rate in (pattern.format(state) for pattern in NAMED)


def _may_be(state: str, rate: str, signature: Signature) -> bool:
    units = dict(zip(signature.state_names, signature.state_units, strict=True))
    per_second = re.fullmatch(r"(.+)/s(ec)?", units[rate])
    if per_second is None:
        return rate in PLAIN
    return units[state] == per_second[1] or any({units[state], per_second[1]} <= set(kind) for kind in KINDS)


def _factor(data: Transitions, state: int, rate: int) -> tuple[float, float]:
    """Return the slope of a state over a rate, and their correlation.

    What the state moves by over a window is compared with the integral of the rate, by the trapezoidal rule: noise
    counts the less the longer the window is, so that the one is taken over which they go together best.
    """
    steps = 0.5 * data.dt * (data.x[:, rate] + data.x_next[:, rate]).double()
    sums = torch.cat([steps.new_zeros(1), steps.cumsum(0)])
    best, window = NO_TIE, 1
    while STRETCHES * window <= len(data):
        rows = torch.arange(0, len(data) - window + 1, max(1, len(data) // ROWS))
        last = rows + window - 1
        rows, last = (k[data.segment[rows] == data.segment[last]] for k in (rows, last))
        if len(rows) > STRETCHES:
            told = _compared((data.x_next[last, state] - data.x[rows, state]).double(), sums[last + 1] - sums[rows])
            best = max(best, told, key=lambda tie: abs(tie[1]))
        window *= 2
    return best


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
