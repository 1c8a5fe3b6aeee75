"""A simulated rig: a plant that moves by a clock, behind its sensors."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from dynasindy.envs import Sensors
from dynasindy.rig.base import Array, RigClock
from dynasindy.systems import System, integrate
from dynasindy.systems.base import Ends, sample_states
from dynasindy.systems.checks import require_plant

ROUNDING = 1e-9
"""Times that differ by less are the same [s]."""
REST = 60.0
"""Longest time between two inputs that is simulated [s]: a plant that is left alone for longer is where it is then."""


class SimulatedRig:
    """A plant that is asked once per period and moves by a clock; it stays where a flight has left it.

    Attributes:
        x: True state at the last time that the rig was spoken to, `(n_x,)`.
        u: Inputs that are applied, `(n_u,)`.

    Args:
        system: The plant.
        sensors: What is measured; all states as they are if omitted.
        clock: Clock of the plant, and of the flights.
        seed: Seed of the sensors' noise.
        step: Longest step of the simulation [s].
        delay: Time from an input to its effect, which is not told to anybody [s].
        start: State in which the plant begins, `(n_x,)`; zeros if omitted.
    """

    streams, number = False, None

    def __init__(
        self,
        system: System,
        sensors: Sensors | None = None,
        clock: RigClock = time,
        seed: int = 0,
        step: float = 0.01,
        delay: float = 0.0,
        start: Tensor | None = None,
    ) -> None:
        self.system, self.sensors, self.clock, self.step, self.delay = system, sensors, clock, step, delay
        self.x = torch.zeros(system.signature.n_x).double() if start is None else start.double()
        self.u, self._time = np.zeros(system.signature.n_u), clock.monotonic()
        self._coming: deque[tuple[float, Array]] = deque()
        self._rng, self._lock = torch.Generator().manual_seed(seed), threading.Lock()

    def begin(self) -> None:
        """Do nothing: no sample is kept."""

    def read(self, seconds: float) -> Array | None:
        """Return what is measured now, `(n_x,)`."""
        with self._lock:
            self._move()
            y = self.x if self.sensors is None else self.sensors.read(self.x, self.system.signature, self._rng)
            return y.numpy().copy()

    def write(self, u: Array) -> None:
        """Apply inputs from now on, `(n_u,)`."""
        with self._lock:
            self._coming.append((self.clock.monotonic() + self.delay, np.array(u)))
            self._move()

    def rest(self) -> None:
        """Apply the safe input, zeros, from now on."""
        self.write(np.zeros(self.system.signature.n_u))

    @torch.no_grad()
    def _move(self) -> None:
        now = self.clock.monotonic()
        while self._coming and self._coming[0][0] <= now + ROUNDING:
            self._move_until(self._coming[0][0])
            self.u = self._coming.popleft()[1]
        self._move_until(now)

    def _move_until(self, then: float) -> None:
        past = min(round(then - self._time, 9), REST)  # differences of times carry errors of rounding
        if past > 0:
            self._time = then
            steps = max(1, round(past / self.step))
            self.x = integrate(self.system, self.x, torch.from_numpy(self.u), past, steps, self.system.stops)[0][-1]


@contextmanager
def rehearsal(
    system: System,
    dt: float,
    sensors: Sensors | None = None,
    seed: int = 0,
    bounds: Mapping[str, Ends] | None = None,
    start: Mapping[str, Ends] | None = None,
) -> Iterator[SimulatedRig]:
    """Simulate a rig whose sensors and actuators are late as those of the plant, and leave it at its safe input.

    Args:
        system: The plant.
        dt: Control period [s].
        sensors: What is measured, and how many periods late an input acts; all states as they are if omitted.
        seed: Seed of the sensors' noise, and of where the plant begins.
        bounds: Limits of states by name, beyond which the equations are not asked about; one for both sides of zero, or
            both ends.
        start: Where the plant begins, by state: a value, or the two ends of a range from which it is drawn; zero for
            the others.

    Raises:
        ValueError: Nobody knows the equations of the plant, they give no rates of change, or a limit or a start is of
            no state or is no range.
    """
    if not system.known:
        raise ValueError("nobody knows the equations of this plant, so none is simulated; give rig=udp and rig.host")
    ends = system.signature.start_ranges(start or {}).double()

    def _begins(batch: torch.Size) -> torch.Tensor:
        return sample_states(ends, batch, torch.Generator().manual_seed(seed))

    limits = system.signature.state_limits(bounds or {})
    system.signature.require_start_within(ends, limits)
    require_plant(system, _begins, limits)
    late = dt * sensors.actuator_delay if sensors else 0.0
    rig = SimulatedRig(system, sensors, seed=seed, step=dt / 5, delay=late, start=_begins(torch.Size()))
    integrate(system, rig.x, torch.from_numpy(rig.u), dt, 5, system.stops)  # makes machine code before anybody asks
    try:
        yield rig
    finally:
        rig.rest()
