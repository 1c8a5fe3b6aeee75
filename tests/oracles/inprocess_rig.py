"""A simulated rig in this process, and a clock that does not wait: rehearsals as fast as they compute."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np
import torch

from dynasindy.rig.base import Array, RigClock
from dynasindy.sensing import Sensors
from dynasindy.systems import System, integrate

ROUNDING = 1e-9
"""Times that differ by less are the same [s]."""


class FastClock:
    """A clock that only goes on when somebody waits, and then at once; computing takes no time by it."""

    def __init__(self) -> None:
        self._now = 0.0

    def monotonic(self) -> float:
        """Return the time that was waited so far [s]."""
        return self._now

    def sleep(self, seconds: float, /) -> None:
        """Let so much time pass [s]."""
        self._now += max(0.0, seconds)


class InProcessRig:
    """A plant that is asked once per period and moves by a clock; it stays where a flight has left it.

    Attributes:
        x: True state at the last time that the rig was spoken to, `(n_x,)`.
        u: Inputs that are applied, `(n_u,)`.

    Args:
        system: The plant.
        sensors: What is measured; all states as they are if omitted.
        clock: Clock of the plant, and of the flights.
        safe: Safe input, `(n_u,)`; zeros if omitted.
        seed: Seed of the sensors' noise.
        step: Longest step of the simulation [s].
        delay: Time from an input to its effect, which is not told to anybody [s].
    """

    streams, number = False, None

    def __init__(
        self,
        system: System,
        sensors: Sensors | None = None,
        clock: RigClock = time,
        safe: Array | None = None,
        seed: int = 0,
        step: float = 0.01,
        delay: float = 0.0,
    ) -> None:
        self.system, self.sensors, self.clock, self.step, self.delay = system, sensors, clock, step, delay
        self.safe = np.zeros(system.signature.n_u) if safe is None else np.asarray(safe, dtype=np.float64)
        self.x = torch.zeros(system.signature.n_x, dtype=torch.float64)
        self.u, self._time = self.safe, clock.monotonic()
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
        """Apply the safe input from now on."""
        self.write(self.safe)

    @torch.no_grad()
    def _move(self) -> None:
        now = self.clock.monotonic()
        while self._coming and self._coming[0][0] <= now + ROUNDING:
            self._move_until(self._coming[0][0])
            self.u = self._coming.popleft()[1]
        self._move_until(now)

    def _move_until(self, then: float) -> None:
        past = round(then - self._time, 9)  # differences of times carry errors of rounding
        if past > 0:
            self._time = then
            steps = max(1, round(past / self.step))
            self.x = integrate(self.system, self.x, torch.from_numpy(self.u), past, steps, self.system.stops)[0][-1]
