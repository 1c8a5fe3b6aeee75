"""A finding of a check, in words, where it begins to be a weak one, and what may mend it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynasindy.checking.flights import TOLERANCE

GENTLE = "Where plant.rates names rates, try task.reward.rate_weight=10, by which quick movements cost more than by 0.1"
CAREFUL = (
    f"{GENTLE}. On any plant, try planning.margin=0.5 with planning.variation.parameters=0.2, by which training varies "
    "the plant more"
)
VARIED = (
    "Where a plant is not stable, try planning.variation.parameters=0.2, by which training varies the plant by up to "
    "that share; where only the steady error is too large, give the controller integral action, as the page on checks "
    "shows"
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
    "settling": "For a plant that is not as the model says, try planning.variation.parameters=0.2, or give the "
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
class Finding:
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


def in_lines(findings: Sequence[Finding]) -> list[str]:
    """Return a line per finding; what may mend several of them stands behind the first one that is weak."""
    lines, said = [], set[str]()
    for each in findings:
        lines.append(str(each).removesuffix(f". {each.mend}") if each.mend in said else str(each))
        said.add(each.mend)
    return lines
