"""Data to identify a model from, of a simulated plant, which is moved as training moves it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Annotated

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor

from dynasindy.dyna.excite import RegulatedExcitation, excitation_findings, excite
from dynasindy.dyna.experiment import PlantComponents
from dynasindy.envs import Aprbs, ControlEnv, Excitation, RandomStep, Sensors, Tracking, TrackingReward
from dynasindy.findings import Finding, note, weak
from dynasindy.identification.source import PERIOD, DataSource, Source
from dynasindy.limits import Positive
from dynasindy.safe_io import checked_class
from dynasindy.sentences import setting
from dynasindy.systems.base import Ends, System, sample_states
from dynasindy.systems.checks import require_plant, sample_places
from dynasindy.systems.integrators import simulate, steps_needed
from dynasindy.systems.transitions import Transitions

SUBSTEPS = 10
"""Runge-Kutta steps between two samples, unless a plant is too fast for them."""
VALIDATION = 400
"""Control periods of the validation, where its length is not given."""
FAR = 1000.0
"""Ranges of a state beyond which a plant has run away, where nobody says what its bounds are."""
Seconds = Annotated[float, Field(gt=0)]
Size = Annotated[float, Field(ge=0, allow_inf_nan=False)]


@checked_class
@dataclass(frozen=True, config={"extra": "forbid"})
class Simulated(DataSource):
    """Take data from a simulated plant.

    A plant that stays by itself is moved open loop. Any other is excited as in training: within bounds, by a signal
    that grows, and under a regulator once it has left them; the validation begins with that regulator.

    Attributes:
        dt: time between two samples [s]; the control period divided by `samples` if omitted. It has to divide the
            period of a plant that may not stay by itself.
        noise: standard deviation of white measurement noise: one number, relative to that of each state, or by the name
            of a state in its unit, where states that are not named have none.
        substeps: Runge-Kutta steps of the plant between two samples; as many as it needs, at least ten, if omitted.
        validation_seconds: length of the validation, random held inputs [s]; 400 control periods if omitted.
        seed: seed of noise and validation.
        bounds: limits of states by name, beyond which nothing is recorded; one for both sides of zero, or both ends.
        start: where the plant begins, by state: a value, or the two ends of a range from which it is drawn; zero for
            the others.
        period: control period, for which inputs are held [s]; `samples` of `dt` if omitted, or 0.05 s without both.
        samples: samples in a control period, where `dt` or `period` is omitted.
        sensors: what is measured in training, how finely and how noisily; all states as they are if omitted.

    Raises:
        ValueError: a number is out of range, or the sensors have an actuator or measurements that are late.
    """

    dt: Seconds | None = None
    noise: Size | dict[str, Size] = 0.0
    substeps: Positive | None = None
    validation_seconds: Seconds | None = None
    seed: int = 0
    bounds: dict[str, Ends] | None = None
    start: dict[str, Ends] | None = None
    period: Seconds | None = None
    samples: Positive = 5
    sensors: Sensors | None = None

    def __post_init__(self) -> None:
        if self.sensors is not None and (self.sensors.delay or self.sensors.actuator_delay):
            raise ValueError(
                f"sensors.delay is {self.sensors.delay} and sensors.actuator_delay is {self.sensors.actuator_delay}; "
                "allowed is 0 for both, as nothing in a recording comes late: leave them out, with sensors=bench, or "
                "use the command train"
            )

    def load(self, system: System | None, excitation: Callable[..., Excitation] | None) -> Source:
        """Excite the plant for training, and by random held inputs of the same range for validation.

        Raises:
            ValueError: there is no plant, its rates of change are none, a name is of none of its states, or `dt` does
                not divide the period of a plant that does not stay by itself.
        """
        if system is None or excitation is None:
            raise ValueError("data=simulated got no plant; it needs one of conf/system: give system=NAME, or data=csv")
        ends = system.signature.state_limits(self.bounds or {}, "data.bounds")
        start = system.signature.start_ranges(self.start or {}, setting("data.start")).double()
        system.signature.require_start_within(start, ends, group="data")
        require_plant(system, lambda batch: self._start(system, self.seed, batch), ends)
        period = self.period or (PERIOD if self.dt is None else self.samples * self.dt)
        signal = excitation(n_u=system.signature.n_u, seed=self.seed, dt=period)
        seconds = VALIDATION * period if self.validation_seconds is None else self.validation_seconds
        dt = period / self.samples if self.dt is None else self.dt
        substeps, coarse = (self.substeps, []) if self.substeps else _steps(system, start.mean(0), ends, dt)
        unseen = Aprbs(
            signal.n_u,
            duration=seconds,
            dt=period,
            amplitude=(0.7 * signal.amplitude).tolist(),
            offset=signal.offset.tolist(),
            seed=self.seed + 1,
            first=signal.first,
        )
        recorded = self._open_loop(system, signal, unseen, dt, substeps, ends) if signal.first == 1 else None
        training, validation, findings = recorded or self._held(system, signal, unseen, dt, substeps)
        training = training.disturbed(self.noise, self.seed, system.signature)
        if self.sensors is not None:
            generator = torch.Generator().manual_seed(self.seed)
            training = training.observed(partial(self.sensors.read, signature=system.signature, rng=generator))
        exact = self.sensors is None and not self.noise
        return Source(system.signature, training, validation, (*coarse, *findings), exact=exact)

    def _open_loop(
        self, system: System, signal: Excitation, unseen: Excitation, dt: float, substeps: int, limits: Tensor
    ) -> tuple[Transitions, Transitions, list[Finding]] | None:
        """Record a plant that stays by itself; None where it leaves its limits, or runs away."""
        far, parts = FAR * torch.tensor(system.signature.x_scale, dtype=torch.float64), list[Transitions]()
        for k, moved in enumerate((signal, unseen)):
            data = record_plant(system, moved.samples(dt), dt, substeps, self._start(system, self.seed + k))
            low, high = torch.where(limits.isfinite(), limits, data.x[0] + torch.stack([-far, far]))
            if not bool(((data.x_next >= low) & (data.x_next <= high)).all()):
                return None
            parts.append(data)
        lost = len(signal.samples(dt)) - len(parts[0])
        return parts[0], parts[1], [note("log.touched_stop", count=lost)] if lost else []

    def _held(
        self, system: System, signal: Excitation, unseen: Excitation, dt: float, substeps: int
    ) -> tuple[Transitions, Transitions, list[Finding]]:
        """Record a plant that may not stay by itself as training does."""
        pilot, parts, findings = RegulatedExcitation(signal), list[Transitions](), list[Finding]()
        for k, moved in enumerate((signal, unseen)):
            samples = round(moved.dt / dt)
            if samples < 1 or abs(samples * dt - moved.dt) > 1e-6 * moved.dt:
                raise ValueError(
                    f"data.dt is {dt:g} s, and this plant is excited as in training, in control periods of "
                    f"{moved.dt:g} s; allowed is a time that divides the period into equal parts: leave data.dt out, "
                    f"and give the number of parts, such as data.samples={math.ceil(moved.dt / dt)}"
                )
            task = Tracking(  # nothing is wanted of the plant but that it moves
                system.signature,
                RandomStep([0.0], [0.0]),
                system.signature.state_names[:1],
                rates=(),
                reward=TrackingReward((1.0,)),
                max_steps=moved.n_steps,
                start=self.start,
                bounds=self.bounds,
            )
            step, seed = samples * substeps, self.seed + k
            plant = ControlEnv(system, task, moved.dt, step, dtype=torch.float64, seed=seed)
            bench = PlantComponents(plant=plant, env=plant, excitation=moved)
            pilot.signal = moved
            rows = excite(bench, pilot)
            if k == 0:  # how the plant is simulated is set elsewhere than in training
                findings = [each for each in excitation_findings(bench, rows) if each.code.startswith("excitation.")]
            rows["next", "samples"] = rows["next", "samples"][:, substeps - 1 :: substeps]
            parts.append(Transitions.from_periods(rows, substeps * bench.plant.log_dt))
        return parts[0], parts[1], findings

    def _start(self, system: System, seed: int, batch: tuple[int, ...] = ()) -> Tensor:
        """Return the states in which recordings begin, `(*batch, n_x)`."""
        ends = system.signature.start_ranges(self.start or {})
        return sample_states(ends, torch.Size(batch), torch.Generator().manual_seed(seed))


def _steps(system: System, start: Tensor, ends: Tensor, dt: float) -> tuple[int, list[Finding]]:
    """Return how many Runge-Kutta steps a plant needs between two samples, and whether that was found."""
    x, u = sample_places(system, start, ends)
    with torch.no_grad():
        some = system(x, u).isfinite().all(-1)
        needed, apart = steps_needed(system, x[some], u[some], dt, SUBSTEPS, system.stops)
    far = apart if math.isfinite(apart) else None
    return needed or SUBSTEPS, [] if needed else [weak("plant.coarse_steps", apart=far, needed=None)]


def record_plant(plant: System, u: Tensor, dt: float, substeps: int = 10, x0: Tensor | None = None) -> Transitions:
    """Excite a plant and log its states; samples that touch a stop are left out.

    Args:
        plant: system to excite.
        u: inputs held in each interval, `(T, n_u)`.
        dt: time between two samples [s].
        substeps: Runge-Kutta steps between two samples.
        x0: start state, `(n_x,)`; zero by default.

    Returns:
        Up to T transitions, float64.
    """
    x = torch.zeros(plant.signature.n_x, dtype=torch.float64) if x0 is None else x0.to(torch.float64)
    with torch.no_grad():
        samples, touched = simulate(plant, x, u := u.to(torch.float64), dt, substeps, plant.stops)
    return Transitions.from_trajectory(torch.cat([x.unsqueeze(0), samples[..., -1, :]]), u, dt).select(~touched)
