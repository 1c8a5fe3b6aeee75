"""All that can be said of a controller on its model before it touches metal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import pydantic
import torch
from torch import Tensor

from dynasindy.control import Controller
from dynasindy.evaluation.closed_loop import PERIODS, ClosedLoop, LoopSimulation
from dynasindy.evaluation.linear_loop import NEUTRAL, Array, Margins, RestingLoop, find_rest, loop_margins
from dynasindy.findings import Finding, note, records, weak, wrong
from dynasindy.identification.verdict import dry_friction, moved_by_inputs
from dynasindy.planning.margins import MOVEMENT
from dynasindy.progress import reporting_as, track
from dynasindy.safe_io import checked_class
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import turn_of
from dynasindy.text import unit_suffix

DRAWN = 0.05
"""Largest share by which coefficients are drawn at random where the model does not tell how well it knows them."""
WITHIN = f"each within {100 * DRAWN:g} % of itself, as the model tells no standard errors"
"""How they were drawn by that share."""
TOLERANCE = 0.05
"""Distance of a plant which has come back from where the loop rests [target ranges]."""
AWAY = 3.0
"""Distance from the target beyond which what ends there has run away [target ranges, or ways to it if longer]."""
LONGER = 5
"""How many times as long as the others flights are where the loop is not stable: a slow swing has time to grow."""
NO_SWING = 1e-6
"""Swing that is none [target ranges]."""
GROWTH = 1.1
"""Ratio of the swings in the last part of such a flight to those in the part before, from which on they grow."""


@checked_class
@pydantic.dataclasses.dataclass(frozen=True)
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

    Raises:
        ValueError: The target range is none, or a number is out of its range.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    points: Annotated[int, pydantic.Field(ge=1, le=50)] = 3  # their number grows with the power of the outputs
    seconds: Annotated[float, pydantic.Field(gt=0, lt=math.inf)] | None = None
    reach: Annotated[float, pydantic.Field(gt=0, le=1e5)] = 1.0
    grid: Annotated[int, pydantic.Field(ge=2, le=100)] = 11  # with whose square flights grow
    draws: Annotated[int, pydantic.Field(ge=0, le=10_000)] = 20
    seed: int = 0

    def __post_init__(self) -> None:
        ends = list(zip(self.low, self.high, strict=False))
        if len(self.low) != len(self.high) or not all(-math.inf < a <= b < math.inf for a, b in ends):
            raise ValueError(f"low={self.low}, high={self.high}; give one number per output in each, low <= high")

    @property
    def ends(self) -> Tensor:
        """Lower and upper end of the target range, `(2, n_r)`."""
        return torch.tensor([self.low, self.high], dtype=torch.float64)

    @property
    def targets(self) -> Tensor:
        """All combinations of targets, `(points ** n_r, n_r)`."""
        parts = [k / (self.points - 1) for k in range(self.points)] if self.points > 1 else [0.5]
        low, high = self.ends.unsqueeze(-1)
        axes = torch.lerp(low, high, torch.tensor(parts, dtype=torch.float64))
        return torch.cartesian_prod(*axes).reshape(-1, len(axes))


class _Plane(NamedTuple):
    """Initial errors of two states, all others at rest, and whether the plant comes back from them."""

    names: tuple[str, str]
    units: tuple[str, str]
    first: Tensor  # errors of the first state, `(n,)`
    second: Tensor  # and of the second one
    back: Tensor  # whether it comes back to where the loop rests, bool `(n, n)`, rows by the first state
    steady_error: Tensor  # of each output where the loop rests, `(n_r,)`; infinite if it runs away from its rest

    @property
    def share(self) -> float:
        """Share of the grid from which it comes back, or of a smaller square about its middle where that is less."""
        n = len(self.back)
        return min(float(self.back[k : n - k, k : n - k].double().mean()) for k in range((n + 1) // 2))


class _Spread(NamedTuple):
    """What becomes of the loop with other plants, at the worst of the targets."""

    worst: Tensor  # largest spectral radius of each plant, `(n,)`; infinite without a point of rest, or a target
    farthest: Tensor  # largest steady error of its outputs, `(n, n_r)`; infinite where they run away
    how: str  # by how much plants are drawn, in words


class _LimitCycles(NamedTuple):
    """The end of long flights, as long as one of the other flights; a row is zero where the loop is stable."""

    outputs: Tensor  # half of the way between the ends of each output, `(n_targets, n_r)`; infinite where it grows
    inputs: Tensor  # the same of each input, `(n_targets, n_u)`
    error: Tensor  # mean absolute error of each output, `(n_targets, n_r)`; infinite where a flight diverged
    seconds: float  # length of a flight


@dataclass(frozen=True)
class Check:
    """What was found; targets come first in every array.

    Attributes:
        loop: The loop that was looked at.
        settings: What was tried.
        targets: References, `(n_targets, n_r)`.
        begin: State in which steps begin, the middle of where episodes of the plan did, `(n_x,)`.
        farthest: Number of the target that is farthest from there.
        rest: Where the loop rests at the targets.
        margins: Per target and input, at rest; none where the loop is not stable.
        noise: Per target, standard deviation of the inputs per unit of noise, `(n_u, n_x)`; none likewise.
        sensors: Standard deviation of the noise of each state's measurement, as the controller's file has it, `(n_x,)`.
        steps: Flights from `begin` to each target.
        drawn: Flights from `begin` to the farthest target with each plant that was drawn, none if none was.
        spread: What becomes of the loop with other plants, at the targets where it is stable with the model.
        planes: From which errors around the middle of the target range the plant comes back.
        swings: What becomes of flights to the targets at which the loop is not stable.
    """

    loop: ClosedLoop
    settings: Settings
    targets: Tensor
    begin: Tensor
    farthest: int
    rest: RestingLoop
    margins: list[list[Margins]]
    noise: list[Array | None]
    sensors: Array
    steps: LoopSimulation
    drawn: LoopSimulation
    spread: _Spread
    planes: list[_Plane]
    swings: _LimitCycles

    @property
    def stable(self) -> Tensor:
        """Whether the loop comes to rest and is stable there, bool `(n_targets,)`."""
        return self.rest.stable

    @property
    def seconds(self) -> float:
        """Length of its flights [s]."""
        return self.steps.u.shape[1] * self.loop.dt

    @property
    def reach(self) -> Tensor:
        """Distance from the target of `drawn` beyond which what ends there has run away, `(n_r,)` [of the outputs]."""
        outputs = self.loop.task.outputs
        return AWAY * torch.maximum(self.loop.task.boxes(), (self.targets[self.farthest] - self.begin[outputs]).abs())

    def beginning(self) -> str:
        """Return in words where steps begin."""
        signature = self.loop.signature
        states = zip(signature.state_names, self.begin.tolist(), signature.state_units, strict=True)
        return ", ".join(f"{n} = {x:.3g}{unit_suffix(unit)}" for n, x, unit in states if x) or "the origin"


def check(loop: ClosedLoop, settings: Settings) -> Check:
    """Look at a loop.

    Args:
        loop: Controller and model.
        settings: What is tried.

    Returns:
        All that was found, as arrays and figures.

    Raises:
        ValueError: The target range has another number of outputs than the controller.
    """
    if len(settings.low) != loop.task.n_r:
        raise ValueError(f"give low and high a number for each of {', '.join(loop.task.output_names)}")
    seconds = settings.seconds or PERIODS * loop.dt
    settings, targets = replace(settings, seconds=seconds), settings.targets
    rest = find_rest(loop, targets, seconds=seconds)
    begin = loop.task.start_ends.double().mean(0)
    good, farthest = rest.stable, int((targets - begin[loop.task.outputs]).square().sum(-1).argmax())
    rows = [rest.linear.row(k).decaying() if ok else None for k, ok in enumerate(good.tolist())]
    margins = [loop_margins(row) if row else [] for row in track("margins", rows, len(rows), "targets")]
    others, how = _variants(loop.model, settings.draws, settings.seed)
    sensors = None if loop.observer is None else loop.observer.sensors
    noise = torch.zeros(loop.signature.n_x) if sensors is None else sensors.variance(loop.signature).double()
    steps = loop.fly(begin.expand(len(targets), -1), targets, seconds)
    drawn = replace(steps, x=steps.x[:0], u=steps.u[:0], r=steps.r[:0])
    if n := len(others):
        phase = "steps of plants that differ from the model"
        drawn = loop.varied(others).fly(begin.expand(n, -1), targets[farthest].expand(n, -1), seconds, phase)
    return Check(
        loop,
        settings,
        targets,
        begin,
        farthest,
        rest,
        margins,
        [row.noise_gain() if row else None for row in rows],
        noise.where(noise.isfinite(), 0.0).sqrt().numpy(),
        steps,
        drawn,
        _spread(loop, targets[good], rest.select(good), others, how, seconds),
        _recovery(loop, settings, targets, rest, seconds),
        _limit_cycles(loop, targets, ~good, seconds, begin),
    )


def _recovery(loop: ClosedLoop, settings: Settings, targets: Tensor, rest: RestingLoop, seconds: float) -> list[_Plane]:
    """Start around the middle of the target range in planes of states, and see from where the plant comes back."""
    task, signature = loop.task, loop.signature
    pairs = [(task.outputs[k], rate) for k, rate in zip(task.rated, task.rates, strict=True)]
    pairs += [(a, b) for k, a in enumerate(task.outputs) for b in task.outputs[k + 1 :]]
    # A plant of the first order has no rates, and an output may be the only one.
    pairs = pairs or [(a, b) for a in task.outputs for b in range(signature.n_x) if a != b][:1]
    if not pairs:
        return []
    r, points = settings.ends.mean(0, keepdim=True), settings.grid
    held = torch.isclose(targets, r, atol=0.0).all(-1).nonzero().flatten()  # none of an even number along an output
    home = rest.select(held) if len(held) else find_rest(loop, r, seconds=seconds)
    sizes = map(min, signature.x_scale, map(turn_of, signature.state_units))  # no angle is farther off than a turn
    x, scale = home.z[0, loop.parts["x"]], torch.tensor([*sizes], dtype=torch.float64)
    axis = settings.reach * torch.linspace(-1.0, 1.0, points, dtype=torch.float64)
    starts = x.double().repeat(len(pairs), points, points, 1)
    for start, (a, b) in zip(starts, pairs, strict=True):
        start[..., a] += scale[a] * axis.unsqueeze(1)
        start[..., b] += scale[b] * axis
    flat = starts.flatten(0, -2)
    if loop.stops is not None:
        flat = loop.stops.apply(flat)[0]
    flat = torch.cat([flat, x.to(flat).unsqueeze(0)])
    flights = loop.fly(flat, r.expand(len(flat), -1), seconds, "recovery from initial errors")
    left = replace(flights, r=flights.end[-1:]).steady_error  # from where a flight without an initial error ends
    back = (left <= TOLERANCE * task.boxes()).all(-1)[:-1].unflatten(0, (len(pairs), points, points))
    names, units, error = signature.state_names, signature.state_units, flights.steady_error[-1]
    return [
        _Plane((names[a], names[b]), (units[a], units[b]), scale[a] * axis, scale[b] * axis, found, error)
        for (a, b), found in zip(pairs, back, strict=True)
    ]


def _limit_cycles(loop: ClosedLoop, targets: Tensor, lost: Tensor, seconds: float, begin: Tensor) -> _LimitCycles:
    """Fly to the targets at which the loop is not stable, bool `(n_targets,)`."""
    n_r, n_u = loop.task.n_r, loop.signature.n_u
    outputs, inputs, error = (torch.zeros(len(targets), n, dtype=torch.float64) for n in (n_r, n_u, n_r))
    found = _LimitCycles(outputs, inputs, error, LONGER * seconds)
    if not bool(lost.any()):
        return found
    r, part = targets[lost], max(1, round(seconds / loop.dt))
    phase = "flights where the loop is not stable"
    flights = loop.fly(begin.expand(len(r), -1), r, found.seconds, phase)
    y = flights.x[..., flights.outputs]
    before, last = _half(y[:, -2 * part : -part]), _half(y[:, -part:])
    found.outputs[lost] = torch.where(last > GROWTH * before, math.inf, last).nan_to_num(math.inf, math.inf)
    found.inputs[lost] = _half(flights.u[:, -part:])
    found.error[lost] = (y[:, -part:] - r.double().unsqueeze(1)).abs().mean(1).nan_to_num(math.inf, math.inf)
    return found


def _half(values: Tensor) -> Tensor:
    """Return half of the way between the least and the largest value, `(rows, T, n)` to `(rows, n)`."""
    return (values.amax(1) - values.amin(1)) / 2


def _variants(model: SindyModel, draws: int, seed: int) -> tuple[Tensor, str]:
    """Draw coefficients from the covariance of the fit, else within a share `DRAWN` of each, and say by how much."""
    generator, xi, known = torch.Generator().manual_seed(seed), model.coefficients, model.covariance
    if known is None:
        uniform = 2 * torch.rand((draws, *xi.shape), generator=generator, dtype=xi.dtype) - 1
        return xi * (1 + DRAWN * uniform * model.constraints.free), WITHIN
    # What no input moves, as a disturbance that fades, no controller has to stand and no training mends.
    names = moved_by_inputs(model)
    moved = torch.tensor([name in names for name in model.signature.state_names])
    shares, drawn = 100 * known.shares(xi)[moved[known.states]], xi.repeat(draws, 1, 1)
    how = "from the covariance of the fit"
    if len(shares):
        how += f", with standard errors of {shares.min():.2g} to {shares.max():.2g} %"
    normal = torch.randn(draws, known.factor.shape[1], generator=generator, dtype=torch.float64)
    drawn[:, known.features, known.states] += normal @ known.factor.mT
    return torch.where(moved, drawn, xi), how


def _spread(
    loop: ClosedLoop, r: Tensor, nominal: RestingLoop, changed: Tensor, how: str = WITHIN, seconds: float = 20.0
) -> _Spread:
    """Let loops with other plants `(n, n_features, n_x)` rest at each target, from where that of the model rests."""
    count = len(changed)
    worst = torch.full((count,), 0.0 if len(r) else torch.inf, dtype=torch.float64)
    farthest = torch.zeros(count, r.shape[-1], dtype=torch.float64)
    for k, target in enumerate(r.double() if count else []):
        start = nominal.select(torch.full((count,), k))
        with reporting_as(f"plants that differ from the model, target {k + 1} of {len(r)}"):
            found = find_rest(loop.varied(changed), target.expand(count, -1), start, seconds)
        worst = worst.maximum(torch.from_numpy(found.linear.radius).where(found.still, torch.inf))
        farthest = farthest.maximum(found.error)
    return _Spread(worst, farthest, how)


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
    findings = [_stability(found, limits), *_undamped(found)]
    if any(found.margins):
        findings += [*_margins(found, limits), _noise(found, limits)]
        pairs = zip(found.loop.signature.state_names, dry_friction(found.loop.model), strict=True)
        if states := [name for name, functions in pairs if functions]:
            findings.append(note("control.dry_friction", known=False, states=states))
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
        facts |= {"at_rest": facts["swing"]["share"] < NO_SWING}
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


def _undamped(found: Check) -> list[Finding]:
    """Say which state swings without ever dying out, where the loop is stable otherwise, and how long a swing takes."""
    signature = found.loop.signature
    for k in range(len(found.targets) if bool(found.stable.all()) else 0):
        values, modes = np.linalg.eig(found.rest.linear.row(k).a)
        turning = np.flatnonzero((np.abs(values) >= 1 - NEUTRAL) & (np.abs(np.angle(values)) > TURNING))
        if len(turning):
            mode = turning[0]
            state = int((np.abs(modes[: signature.n_x, mode]) / np.array(signature.x_scale)).argmax())
            seconds = 2 * math.pi * found.loop.dt / abs(float(np.angle(values[mode])))
            facts = {"state": signature.state_names[state], "seconds": seconds, "target": _target(found, k)}
            return [weak("check.undamped", **facts)]
    return []


TURNING = 1e-3
"""Angle of an eigenvalue on the unit circle from which on what it belongs to swings [rad per control period]."""


def _time_constant(radius: float, dt: float) -> float:
    """Return in which time the slowest part of a loop dies out to a share of 1/e [s]."""
    return -dt / math.log(radius) if 0 < radius < 1 else 0.0 if radius < 1 else math.inf


def _margins(found: Check, limits: Thresholds) -> list[Finding]:
    dt, names = found.loop.dt, found.loop.signature.input_names
    rows = [(k, i, margins) for k, target in enumerate(found.margins) for i, margins in enumerate(target)]
    kinds = {
        "gain_margin": ([m.gain for *_, m in rows], limits.gain),
        "gain_reduction": ([1 / m.lower if m.lower else math.inf for *_, m in rows], limits.gain),
        "phase_margin": ([m.phase for *_, m in rows], limits.phase),
        "delay_margin": ([m.delay / dt for *_, m in rows], limits.delay),
        "disk_margin": ([m.disk for *_, m in rows], limits.disk),
    }
    findings, low, high = [], found.targets.amin(0), found.targets.amax(0)
    outer = ((low < high) & ((found.targets == low) | (found.targets == high))).any(-1).tolist()
    for code, (values, limit) in kinds.items():
        k, i, _ = rows[row := int(np.argmin(values))]
        where = {"input": names[i], "target": _target(found, k), "dt": dt}
        lacking = {row[0] for row, value in zip(rows, values, strict=True) if value < limit}
        where |= {"weak": len(lacking), "inside": not all(outer[target] for target in lacking)}
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
