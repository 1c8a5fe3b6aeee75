"""The far end of a network: a plant that streams samples over UDP and keeps a watch of its own.

It applies the inputs that arrived since its last sample. A period without any is bridged with the inputs as they were,
a second one ends in the safe input.
"""

from __future__ import annotations

import socket
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import torch

from dynasindy.envs import Sensors
from dynasindy.rig.base import Array
from dynasindy.rig.udp import REST, UdpRig
from dynasindy.systems import System, integrate

BRIDGED = 1
"""Periods without inputs that are bridged with the last ones."""


@dataclass
class Record:
    """What a simulated rig saw and did.

    Attributes:
        applied: Inputs of each period, `(n_u,)` each.
        answered: Whether new inputs had arrived for it.
        asked: Whether the safe input was asked for in it.
        states: True states at the beginning of each period.
    """

    applied: list[Array] = field(default_factory=list)
    answered: list[bool] = field(default_factory=list)
    asked: list[bool] = field(default_factory=list)
    states: list[Array] = field(default_factory=list)


class FarEnd:
    """Serve a plant over UDP.

    Args:
        system: The plant.
        dt: Control period [s].
        sensors: What is measured, and how many periods late an input acts; all states as they are if omitted.
        safe: Safe input, `(n_u,)`; zeros if omitted.
        seed: Seed of the sensors' noise.
        start: State in which the plant begins, `(n_x,)`; zeros if omitted.

    Attributes:
        port: Free port on which it listens.
        record: What it saw and did.
    """

    def __init__(
        self,
        system: System,
        dt: float = 0.05,
        sensors: Sensors | None = None,
        safe: Array | None = None,
        seed: int = 0,
        start: Array | None = None,
    ) -> None:
        self.system, self.dt, self.sensors = system, dt, sensors
        self.safe = np.zeros(system.signature.n_u) if safe is None else np.asarray(safe, dtype=np.float64)
        begin = np.zeros(system.signature.n_x) if start is None else np.asarray(start, dtype=np.float64)
        self.start = torch.from_numpy(begin)
        self.rng = torch.Generator().manual_seed(seed)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self.record = Record()
        # The first period makes machine code of the plant, which would take longer than a control period.
        self._moved(self.start, self.safe)

    def serve(self, periods: int, lockstep: float = 0.0) -> Record:
        """Wait for a caller, then run so many periods.

        Args:
            periods: How many.
            lockstep: Wait so long for the answer to each sample instead of keeping a clock [s]: for tests, in which a
                busy computer is no fault of the flight; 0 keeps the clock.

        Returns:
            What it saw and did.
        """
        self._socket.settimeout(300.0)
        caller = self._socket.recvfrom(65536)[1]
        x, begun = self.start, time.monotonic()
        u, missed = self.safe, 0
        coming = deque([self.safe] * (self.sensors.actuator_delay if self.sensors else 0))
        for k in range(periods):
            y = x if self.sensors is None else self.sensors.read(x, self.system.signature, self.rng)
            self._socket.sendto(UdpRig.pack(k, y.numpy()), caller)
            found = self._inputs(begun + (k + 1) * self.dt, lockstep)
            missed = 0 if found is not None else missed + 1
            u = found if found is not None else u if missed <= BRIDGED else self.safe
            self.record.states.append(x.numpy().copy())
            self.record.applied.append(u)
            self.record.answered.append(found is not None)
            self.record.asked.append(found is self.safe)
            coming.append(u)
            x = self._moved(x, coming.popleft())
        self._socket.close()
        return self.record

    def _moved(self, x: torch.Tensor, u: Array) -> torch.Tensor:
        """Return the state after a control period."""
        return integrate(self.system, x, torch.from_numpy(u), self.dt, 5, self.system.stops)[0][-1]

    def _inputs(self, end: float, lockstep: float) -> Array | None:
        """Return the newest inputs that arrive before a period is over; the safe ones if those are asked for."""
        found: Array | None = None
        while True:
            left = lockstep or end - time.monotonic()
            if left <= 0:
                return found
            self._socket.settimeout(left)
            try:
                answer = UdpRig.unpack(self._socket.recv(65536), len(self.safe))
            except (TimeoutError, BlockingIOError):
                return found
            except ConnectionError:  # the caller is gone: its own silence tells
                return found
            if answer is not None:
                found = self.safe if answer[0] == REST else answer[1]
                if lockstep:
                    return found
