"""All that can be said of a controller on its model before it touches metal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dynasindy.checking.closed_loop import ClosedLoop
from dynasindy.checking.linear_loop import (
    RESTS,
    Array,
    Margins,
    RestingLoop,
    find_rest,
    guess_rest,
    loop_margins,
    noise_gain,
)
from dynasindy.checking.simulation import (
    AWAY,
    LargeSignalMargins,
    LimitCycles,
    LoopSimulation,
    Plane,
    diverged_rows,
    find_limit_cycles,
    has_dry_friction,
    large_signal_margins,
    no_limit_cycles,
    recovery_plane,
    simulate_loop,
)
from dynasindy.checking.uncertainty import Spread, Variants, spread, variants
from dynasindy.progress import report_progress, track
from dynasindy.systems import ranges
from dynasindy.systems.ranges import Ends

PERIODS = 400
"""Control periods of a flight whose length is not given, those of the paper's episodes; a slow plant gets more time."""


@dataclass(frozen=True)
class Settings:
    """What is tried.

    Attributes:
        low, high: Target range, one number per output [of the outputs].
        points: Targets along each output.
        seconds: Length of a flight [s]; None for `PERIODS` control periods.
        reach: Largest initial error [ranges of the states].
        grid: Initial errors along each axis.
        draws: Plants drawn at random.
        seed: Seed of the draws.
        start: Where steps begin, as `plant.start` of a run: by state a value, or a range, of which it is the middle.
        bounds: Limits of states, as `plant.bounds` of a run. Without `start` steps begin at the origin, or where the
            model rests nearest to the middle target if these exclude the origin.

    Raises:
        ValueError: The target range is none, or a number is too small.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    points: int = 3
    seconds: float | None = None
    reach: float = 1.0
    grid: int = 11
    draws: int = 20
    seed: int = 0
    start: Mapping[str, Ends] = field(default_factory=dict)
    bounds: Mapping[str, Ends] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ends = list(zip(self.low, self.high, strict=False))
        if len(self.low) != len(self.high) or not all(-math.inf < a <= b < math.inf for a, b in ends):
            raise ValueError(
                f"low is {list(self.low)}, high is {list(self.high)}; give one number per output in each, low <= high"
            )
        length = 1.0 if self.seconds is None else self.seconds
        if self.points < 1 or self.grid < 2 or self.draws < 0 or not (0 < length < math.inf and self.reach > 0):
            raise ValueError(
                f"points={self.points}, grid={self.grid}, draws={self.draws}, seconds={self.seconds}, "
                f"reach={self.reach}; give points >= 1, grid >= 2, draws >= 0, seconds > 0 and reach > 0"
            )

    @property
    def middle(self) -> Tensor:
        """Middle of the target range, `(n_r,)`."""
        low, high = (torch.tensor(ends, dtype=torch.float64) for ends in (self.low, self.high))
        return (low + high) / 2

    @property
    def targets(self) -> Tensor:
        """All combinations of targets, `(points ** n_r, n_r)`."""
        ends = zip(self.low, self.high, strict=True)
        axes = [
            torch.linspace(a, b, self.points, dtype=torch.float64)
            if self.points > 1
            else torch.tensor([(a + b) / 2], dtype=torch.float64)
            for a, b in ends
        ]
        return torch.cartesian_prod(*axes).reshape(-1, len(axes))


@dataclass(frozen=True)
class Check:
    """What was found; targets come first in every array.

    Attributes:
        loop: The loop that was looked at.
        settings: What was tried.
        targets: References, `(n_targets, n_r)`.
        begin: State in which steps begin, `(n_x,)`.
        rest: Where the loop rests at them.
        margins: Per target and input; none where the loop is not stable.
        noise: Per target, standard deviation of the inputs per unit of noise, `(n_u, n_x)`; none likewise.
        sensors: Standard deviation of the noise of each state's measurement, as the controller's file has it, `(n_x,)`.
        resolution: Step between two values that each state's sensor can tell apart, likewise; 0 where none is known.
        steps: Flights from `begin` to each target.
        drawn: Flights from `begin` to the farthest target with each plant that was drawn.
        spread: What becomes of the loop with other plants, at the targets where it is stable with the model.
        planes: From which errors around the middle target the plant comes back.
        swings: What becomes of flights to the targets at which the loop is not stable.
        flown: Margins of flights from each target at which the loop is stable to the opposite one; None where there is
            none, and of a plant without dry friction, whose margins at rest are those of large movements as well.
        left: What is not looked at yet, in words; the fields that it would fill are empty.
    """

    loop: ClosedLoop
    settings: Settings
    targets: Tensor
    begin: Tensor
    rest: RestingLoop
    margins: list[list[Margins]]
    noise: list[Array | None]
    sensors: Array
    resolution: Array
    steps: LoopSimulation
    drawn: LoopSimulation | None
    spread: Spread
    planes: list[Plane]
    swings: LimitCycles
    flown: LargeSignalMargins | None
    left: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Length of its flights [s]."""
        assert self.settings.seconds is not None, "a check knows how long it flew"
        return max(1, round(self.settings.seconds / self.loop.dt)) * self.loop.dt

    @property
    def middle(self) -> Tensor:
        """Target around which the errors of `planes` lie, `(n_r,)`: the middle of their range."""
        return self.settings.middle

    @property
    def farthest(self) -> int:
        """Number of the target of `drawn`."""
        return _farthest(self.loop, self.targets, self.begin)

    @property
    def reach(self) -> Tensor:
        """Distance from the target of `drawn` beyond which what ends there has run away, `(n_r,)` [of the outputs]."""
        outputs = self.loop.task.outputs
        low, high = (torch.tensor(ends, dtype=torch.float64) for ends in (self.settings.low, self.settings.high))
        way = (self.targets[self.farthest] - self.begin[outputs]).abs()
        extent = torch.maximum(high - low, way)
        size = torch.tensor(self.loop.signature.x_scale, dtype=torch.float64)[outputs]
        return AWAY * extent.where(extent > 0, size)

    @property
    def ran_away(self) -> int:
        """How many of the flights in `drawn` run away."""
        if self.drawn is None:
            return 0
        y = self.drawn.x[..., self.drawn.outputs]
        return int(diverged_rows(y, self.targets[self.farthest], self.reach, self.loop.dt).sum())

    def beginning(self, written: Callable[[str], str] = str) -> str:
        """Return in words where steps begin; `written` says how the name of a state is written."""
        signature = self.loop.signature
        states = zip(signature.state_names, self.begin.tolist(), signature.state_units, strict=True)
        return ", ".join(f"{written(name)} = {x:.3g} {unit}" for name, x, unit in states if x) or "the origin"

    @property
    def stable(self) -> Tensor:
        """Whether the loop comes to rest and is stable there, bool `(n_targets,)`."""
        return self.rest.still & torch.from_numpy(self.rest.linear.radius < 1)


def check(loop: ClosedLoop, settings: Settings, keep: Callable[[Check], object] | None = None) -> Check:
    """Look at a loop.

    Args:
        loop: Controller and model.
        settings: What is tried.
        keep: Is handed what was found so far, each time that more was; `Check.left` says what is still to come.

    Raises:
        ValueError: The target range has another number of outputs than the controller.
    """
    if len(settings.low) != loop.task.n_r:
        raise ValueError(
            f"low and high have {len(settings.low)} numbers; give one for each of {', '.join(loop.task.output_names)}"
        )
    settings = replace(settings, seconds=settings.seconds or PERIODS * loop.dt)
    found = _begun(loop, settings)
    for done, look in enumerate(STAGES.values(), 1):
        found = replace(found, **look(found), left=tuple(STAGES)[done:])
        if keep is not None:
            keep(found)
    return found


def _begun(loop: ClosedLoop, settings: Settings) -> Check:
    """Return where the loop rests, and nothing else yet."""
    targets, signature = settings.targets, loop.signature
    count, n_r, n_u, seconds = len(targets), loop.task.n_r, signature.n_u, float(settings.seconds or 0.0)
    report_progress(RESTS, 0, count, "targets")
    found = find_rest(loop, targets, seconds=seconds)
    begin = _begin(loop, settings, settings.middle)
    none, no_x, no_u = (torch.zeros(shape).double() for shape in ((count, 0), (0, 2, signature.n_x), (0, 1, n_u)))
    return Check(
        loop,
        settings,
        targets,
        begin,
        found,
        [[] for _ in targets],
        [None for _ in targets],
        _stated(loop),
        _resolved(loop),
        LoopSimulation(no_x, no_u, targets[:0], loop.task.outputs, loop.dt, loop.task.input_limits),
        None,
        Spread([], none, none.unsqueeze(-1).expand(count, 0, n_r), 0),
        [],
        no_limit_cycles(count, n_r, n_u, seconds),
        None,
        tuple(STAGES),
    )


def _swinging(found: Check) -> dict[str, Any]:
    return {"swings": find_limit_cycles(found.loop, found.targets, found.stable, found.seconds, found.begin)}


def _bearing(found: Check) -> dict[str, Any]:
    """Return margins and what noise does, at the targets at which the loop is stable."""
    stable = found.stable.tolist()
    rows = [found.rest.linear.row(k) if ok else None for k, ok in enumerate(stable)]
    told = track("margins", rows, len(rows), "targets")
    both = [([], None) if row is None else (loop_margins(row), noise_gain(row)) for row in told]
    return {"margins": [each for each, _ in both], "noise": [each for _, each in both]}


def _stepping(found: Check) -> dict[str, Any]:
    begin = found.begin.expand(len(found.targets), -1)
    return {"steps": simulate_loop(found.loop, begin, found.targets, found.seconds)}


def _others(found: Check) -> Variants:
    return variants(found.loop.plant.model, found.settings.draws, found.settings.seed)


def _varying(found: Check) -> dict[str, Any]:
    """Return where the loop rests with other plants, and flights of those that are drawn."""
    others, good = _others(found), found.stable
    rests = spread(found.loop, found.targets[good], found.rest.select(good), others, found.seconds)
    return {"drawn": _drawn(found, others), "spread": rests}


def _recovering(found: Check) -> dict[str, Any]:
    """Start around the middle of the target range, which is none of an even number of targets along an output."""
    settings, r = found.settings, found.middle.unsqueeze(0)
    held = torch.isclose(found.targets, r, atol=0.0).all(-1).nonzero().flatten()
    home = found.rest.select(held) if len(held) else find_rest(found.loop, r, seconds=found.seconds)
    x = home.z[0, found.loop.parts["x"]]
    return {"planes": recovery_plane(found.loop, x, r[0], settings.reach, settings.grid, found.seconds)}


def _flying(found: Check) -> dict[str, Any]:
    """Fly from rest at each target to the opposite one; a single target is flown to from where steps begin."""
    loop, targets, good = found.loop, found.targets[found.stable], found.stable
    if not len(targets) or not has_dry_friction(loop.plant.model):
        return {"flown": None}
    x = found.rest.z[good][:, loop.parts["x"]]
    x = x if len(targets) > 1 else found.begin.expand_as(x)
    return {"flown": large_signal_margins(loop, x, targets.flip(0), found.seconds)}


STAGES: dict[str, Callable[[Check], dict[str, Any]]] = {
    "swings where it is not stable": _swinging,
    "margins": _bearing,
    "steps": _stepping,
    "other coefficients": _varying,
    "recovery": _recovering,
    "large movements": _flying,
}
"""What is looked at once it is known where the loop rests, one after the other, and what fills fields of a check."""


def _farthest(loop: ClosedLoop, targets: Tensor, begin: Tensor) -> int:
    return int((targets - begin[loop.task.outputs]).square().sum(-1).argmax())


def _begin(loop: ClosedLoop, settings: Settings, middle: Tensor) -> Tensor:
    """Return the state in which steps begin, `(n_x,)`."""
    ends = ranges.start_ranges(loop.signature, settings.start).double()
    low, high = ranges.state_limits(loop.signature, settings.bounds)
    if settings.start or bool(((low <= 0) & (high >= 0)).all()):
        return ends.mean(0)
    return guess_rest(loop, middle.unsqueeze(0))[0, loop.parts["x"]]


def _stated(loop: ClosedLoop) -> Array:
    """Return the standard deviation of the noise that the file states; 0 where a state is seen as it is, or not."""
    if loop.observer is None:
        return np.zeros(loop.signature.n_x)
    variance = loop.observer.sensors.variance(loop.signature)
    return variance.where(variance.isfinite(), 0.0).sqrt().numpy()


def _resolved(loop: ClosedLoop) -> Array:
    if loop.observer is None:
        return np.zeros(loop.signature.n_x)
    return loop.observer.sensors.resolution(loop.signature).numpy()


def _drawn(found: Check, others: Variants) -> LoopSimulation | None:
    if not others.draws:
        return None
    farthest = found.targets[found.farthest]
    start = found.begin.expand(others.draws, -1)
    plants = found.loop.varied(others.coefficients[: others.draws])
    phase = "steps of plants that differ from the model"
    return simulate_loop(plants, start, farthest.expand(others.draws, -1), found.seconds, phase)
