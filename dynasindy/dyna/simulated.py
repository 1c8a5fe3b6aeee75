"""Data to identify a model from, of a simulated plant, which is moved as training moves it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from dynasindy.dyna.components import PlantComponents
from dynasindy.dyna.excite import RegulatedExcitation, excite, left_out, restarts
from dynasindy.envs import ControlEnv
from dynasindy.envs.rollout_data import disturb, observed, record_plant, transitions
from dynasindy.excitation import Aprbs, Excitation
from dynasindy.findings import Finding, note
from dynasindy.identification.source import PERIOD, DataSource, Source
from dynasindy.sensing import Sensors
from dynasindy.systems import Diverged
from dynasindy.systems.base import Signature, System
from dynasindy.systems.checks import require_plant
from dynasindy.systems.ranges import Ends, require_start_within, sample_states, start_ranges, state_limits
from dynasindy.systems.transitions import Transitions
from dynasindy.tasks import RandomStep, Tracking, TrackingReward

HOLD = 0.5
"""Time for which an input of the validation is held, unless it is shorter [s]."""
VALIDATION = 400
"""Control periods of the validation, where its length is not given."""
FAR = 1000.0
"""Ranges of a state beyond which a plant has run away, where nobody says what its bounds are."""
LONGEST = 1e8
"""Steps of a simulated plant, beyond which a recording would take days."""


@dataclass(frozen=True)
class Simulated(DataSource):
    """Take data from a simulated plant.

    A plant that is known to stay by itself is moved open loop. Any other is excited as in training: within bounds, by a
    signal that grows, and under a regulator once it has left them; the validation begins with that regulator.

    Attributes:
        dt: time between two samples [s]; the control period divided by `samples` if omitted. It has to divide the
            period of a plant that may not stay by itself.
        noise: standard deviation of white measurement noise: one number, relative to that of each state, or by the name
            of a state in its unit, where states that are not named have none.
        substeps: Runge-Kutta steps of the plant between two samples.
        validation_seconds: length of the validation, random held inputs [s]; 400 control periods if omitted.
        seed: seed of noise and validation.
        bounds: limits of states by name, beyond which nothing is recorded; one for both sides of zero, or both ends.
        start: where the plant begins, by state: a value, or the two ends of a range from which it is drawn; zero for
            the others.
        period: control period, for which inputs are held [s]; 0.05 s if omitted.
        samples: samples in a control period, where `dt` is omitted.
        sensors: what is measured in training, how finely and how noisily; all states as they are if omitted.

    Raises:
        ValueError: a time, the substeps or the samples are not positive, a noise is negative, or the sensors have an
            actuator or measurements that are late.
    """

    dt: float | None = None
    noise: float | dict[str, float] = 0.0
    substeps: int = 10
    validation_seconds: float | None = None
    seed: int = 0
    bounds: dict[str, Ends] | None = None
    start: dict[str, Ends] | None = None
    period: float | None = None
    samples: int = 5
    sensors: Sensors | None = None

    def __post_init__(self) -> None:
        levels = self.noise.values() if isinstance(self.noise, Mapping) else [self.noise]
        times = [time for time in (self.dt, self.validation_seconds, self.period) if time is not None]
        sound = all(time > 0 for time in times) and all(0 <= level < math.inf for level in levels)
        if not sound or self.substeps < 1 or self.samples < 1:
            raise ValueError(
                f"data=simulated got dt {self.dt} s, validation {self.validation_seconds} s, period {self.period} s, "
                f"noise {self.noise}, substeps {self.substeps}, samples {self.samples}; allowed are positive times, "
                "noise >= 0, substeps >= 1 and samples >= 1: correct them"
            )
        if self.sensors is not None and (self.sensors.delay or self.sensors.actuator_delay):
            raise ValueError(
                f"sensors.delay is {self.sensors.delay} and sensors.actuator_delay is {self.sensors.actuator_delay}; "
                "allowed is 0 for both, as nothing in a recording comes late: leave them out, with sensors=bench, or "
                "use the command train"
            )

    def load(self, system: System | None, excitation: Callable[..., Excitation] | None) -> Source:
        """Excite the plant for training, and by random held inputs of the same range for validation.

        Raises:
            ValueError: there is no plant, its rates of change are none, a name is of none of its states, the recording
                would take days, or `dt` does not divide the period of a plant that may not stay by itself.
            Diverged: it leaves its bounds soon, though it is said to stay by itself.
        """
        if system is None or excitation is None:
            raise ValueError("data=simulated got no plant; it needs one of conf/system: give system=NAME, or data=csv")
        ends = state_limits(system.signature, self.bounds or {}, "data.bounds")
        start = start_ranges(system.signature, self.start or {}, "data.start")
        require_start_within(system.signature, start, ends, group="data")
        require_plant(system, lambda batch: self._start(system, self.seed, batch), ends)
        period = self.period or PERIOD
        signal = excitation(n_u=system.signature.n_u, seed=self.seed, dt=period)
        seconds = VALIDATION * period if self.validation_seconds is None else self.validation_seconds
        dt = self._step(period)
        steps = max(signal.duration, seconds) / dt * self.substeps
        if steps > LONGEST:
            raise ValueError(
                f"excitation.duration={signal.duration:g} s or data.validation_seconds={seconds:g} s, with "
                f"data.dt={dt:g} s and data.substeps={self.substeps}, is {steps:.3g} steps of the plant; allowed are "
                f"{LONGEST:g}, an arbitrary limit: shorten it"
            )
        unseen = self._unseen(signal, seconds)
        training, validation, findings = (self._open_loop if signal.first == 1 else self._held)(system, signal, unseen)
        training = disturb(training, self.noise, self.seed, system.signature)
        if self.sensors is not None:
            generator = torch.Generator().manual_seed(self.seed)
            training = observed(training, partial(self.sensors.read, signature=system.signature, rng=generator))
        return Source(system.signature, training, validation, tuple(each for each in findings if each is not None))

    def _step(self, period: float) -> float:
        """Return the time between two samples [s]."""
        return period / self.samples if self.dt is None else self.dt

    def _unseen(self, signal: Excitation, seconds: float) -> Excitation:
        """Return the signal of the validation."""
        return Aprbs(
            signal.n_u,
            seconds,
            signal.dt,
            hold=min(HOLD, seconds),
            amplitude=(0.7 * signal.amplitude).tolist(),
            offset=signal.offset.tolist(),
            seed=self.seed + 1,
            first=signal.first,
        )

    def _open_loop(
        self, system: System, signal: Excitation, unseen: Excitation
    ) -> tuple[Transitions, Transitions, list[Finding | None]]:
        """Record a plant that stays by itself; what comes after it has left its bounds is left out."""
        dt, parts = self._step(signal.dt), list[Transitions]()
        findings: list[Finding | None] = []
        for k, (moved, what) in enumerate(zip((signal, unseen), ("excitation", "validation"), strict=True)):
            inputs = moved.samples(dt)
            data = record_plant(system, inputs, dt, self.substeps, self._start(system, self.seed + k))
            if k == 0 and len(data) < len(inputs):
                findings.append(note("log.touched_stop", count=len(inputs) - len(data)))
            data, gone = _before_leaving(data, system.signature, self.bounds or {}, what)
            parts.append(data)
            findings.append(gone)
        return parts[0], parts[1], findings

    def _held(
        self, system: System, signal: Excitation, unseen: Excitation
    ) -> tuple[Transitions, Transitions, list[Finding | None]]:
        """Record a plant that may not stay by itself as training does."""
        pilot, parts = RegulatedExcitation(signal), list[Transitions]()
        findings: list[Finding | None] = []
        for k, moved in enumerate((signal, unseen)):
            bench = self._bench(system, moved, self.seed + k)
            pilot.signal = moved
            rows = excite(bench, pilot)
            findings += [restarts(bench, rows), left_out(rows)] if k == 0 else []
            rows["next", "samples"] = rows["next", "samples"][:, self.substeps - 1 :: self.substeps]
            parts.append(transitions(rows, self.substeps * bench.plant.log_dt))
        return parts[0], parts[1], findings

    def _bench(self, system: System, signal: Excitation, seed: int) -> PlantComponents:
        """Return the plant of which nothing is wanted but that it moves."""
        signature, dt = system.signature, self._step(signal.dt)
        samples = round(signal.dt / dt)
        if samples < 1 or abs(samples * dt - signal.dt) > 1e-6 * signal.dt:
            raise ValueError(
                f"data.dt is {dt:g} s, and this plant is excited as in training, in control periods of {signal.dt:g} "
                "s; allowed is a time that divides the period into equal parts: leave data.dt out, and give the number "
                f"of parts, such as data.samples={math.ceil(signal.dt / dt)}"
            )
        task = Tracking(
            signature,
            RandomStep([0.0], [0.0]),
            signature.state_names[:1],
            rates=(),
            reward=TrackingReward((1.0,)),
            max_steps=signal.n_steps,
            start=self.start,
            bounds=self.bounds,
        )
        plant = ControlEnv(system, task, signal.dt, samples * self.substeps, dtype=torch.float64, seed=seed)
        return PlantComponents(plant=plant, env=plant, excitation=signal)

    def _start(self, system: System, seed: int, batch: tuple[int, ...] = ()) -> Tensor:
        """Return the states in which recordings begin, `(*batch, n_x)`."""
        ends = start_ranges(system.signature, self.start or {})
        return sample_states(ends, torch.Size(batch), torch.Generator().manual_seed(seed))


def _before_leaving(
    data: Transitions, signature: Signature, bounds: Mapping[str, Ends], what: str
) -> tuple[Transitions, Finding | None]:
    """Cut a recording where the plant leaves its bounds or runs away, and return where it left, if it did."""
    far = FAR * torch.tensor(signature.x_scale, dtype=torch.float64)
    given = state_limits(signature, bounds)
    low, high = torch.where(given.isfinite(), given, data.x[0] + torch.stack([-far, far]))
    out = ~((data.x_next >= low) & (data.x_next <= high))
    if not bool(out.any()):
        return data, None
    row = int(out.any(-1).int().argmax())
    i = int(out[row].int().argmax())
    name, unit = signature.state_names[i], signature.state_units[i]
    ends = {"low": float(low[i]), "high": float(high[i]), "unit": unit, "bounded": name in bounds}
    left = note("excitation.left", during=what, state=name, seconds=(row + 1) * data.dt, **ends)
    if 2 * row < len(data):
        raise Diverged(
            f"{left}, and there is too little before that to identify from; give a smaller excitation.amplitude, "
            f"another excitation.offset{' or wider plant.bounds' if name in bounds else ''}, or excitation.first=0.1, "
            "which begins anew where the plant leaves its bounds and then holds it while it is excited"
        )
    return data.select(torch.arange(len(data)) < row), left
