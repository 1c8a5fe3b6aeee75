"""A simulated rig: a plant in a process of its own that streams samples over UDP and keeps a watch of its own.

It applies the inputs that arrived since its last sample. A period without any is bridged with the inputs as they were,
a second one ends in the safe input. Faults are switched on to try what a flight does about them.
"""

from __future__ import annotations

import multiprocessing
import signal
import socket
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pickle import PicklingError
from typing import Any

import numpy as np
import torch

from dynasindy.rig.base import Array
from dynasindy.rig.udp import REST, UdpRig, connect, pack, unpack
from dynasindy.sensing import Sensors
from dynasindy.systems import System, integrate
from dynasindy.systems.checks import require_plant
from dynasindy.systems.ranges import Ends, require_start_within, sample_states, start_ranges, state_limits

BRIDGED = 1
"""Periods without inputs that are bridged with the last ones."""
FOREVER = 10**9
"""Periods of a rig that is ended from outside."""
FAULTS = ("silent", "old", "garbage", "nan", "range", "gone")


@dataclass
class _Record:
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


class SimulatedRig:
    """Serve a plant over UDP.

    Args:
        system: The plant.
        dt: Control period [s].
        sensors: What is measured, and how many periods late an input acts; all states as they are if omitted.
        safe: Safe input, `(n_u,)`; zeros if omitted.
        seed: Seed of the sensors' noise.
        faults: What goes wrong from which sample on: silent (no samples), old (the same again), garbage, nan, range (a
            state of 1e9), gone (the socket is closed).
        start: State in which the plant begins, `(n_x,)`; zeros if omitted.

    Attributes:
        port: Free port on which it listens.
        record: What it saw and did.

    Raises:
        ValueError: A fault is unknown.
    """

    def __init__(
        self,
        system: System,
        dt: float = 0.05,
        sensors: Sensors | None = None,
        safe: Array | None = None,
        seed: int = 0,
        faults: Mapping[str, int] | None = None,
        start: Array | None = None,
    ) -> None:
        if unknown := [name for name in faults or {} if name not in FAULTS]:
            raise ValueError(f"fault '{unknown[0]}' is unknown; use some of {', '.join(FAULTS)}")
        self.system, self.dt, self.sensors = system, dt, sensors
        self.safe = np.zeros(system.signature.n_u) if safe is None else np.asarray(safe, dtype=np.float64)
        begin = np.zeros(system.signature.n_x) if start is None else np.asarray(start, dtype=np.float64)
        self.start = torch.from_numpy(begin)
        self.faults, self.rng = dict(faults or {}), torch.Generator().manual_seed(seed)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self.record = _Record()
        # The first period makes machine code of the plant, which would take longer than a control period.
        self._moved(self.start, self.safe)

    def serve(self, periods: int, lockstep: float = 0.0) -> _Record:
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
            if not self._send(k, x, caller):
                break
            found = self._inputs(k, begun + (k + 1) * self.dt, lockstep)
            missed = 0 if found is not None else missed + 1
            u = found if found is not None else u if missed <= BRIDGED else self.safe
            if periods < FOREVER:
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

    def _wrong(self, fault: str, k: int) -> bool:
        return fault in self.faults and k >= self.faults[fault]

    def _send(self, k: int, x: torch.Tensor, caller: Any) -> bool:
        """Send a sample; False if the rig is gone."""
        if self._wrong("gone", k):
            return False
        y = x if self.sensors is None else self.sensors.read(x, self.system.signature, self.rng)
        values = y.numpy().copy()
        if self._wrong("nan", k):
            values[0] = np.nan
        if self._wrong("range", k):
            values[0] = 1e9
        if not self._wrong("silent", k):
            number = min(k, self.faults["old"]) if self._wrong("old", k) else k
            datagram = b"DYN1 of no sense" if self._wrong("garbage", k) else pack(number, values)
            self._socket.sendto(datagram, caller)
        return True

    def _inputs(self, k: int, end: float, lockstep: float) -> Array | None:
        """Return the newest inputs that arrive before a period is over; the safe ones if those are asked for."""
        found: Array | None = None
        quiet = any(self._wrong(name, k) for name in FAULTS)
        while True:
            left = end - time.monotonic() if not lockstep else 2 * self.dt if quiet else lockstep
            if left <= 0:
                return found
            self._socket.settimeout(left)
            try:
                answer = unpack(self._socket.recv(65536), len(self.safe))
            except (TimeoutError, BlockingIOError):
                return found
            except ConnectionError:  # the caller is gone: its own silence tells
                return found
            if answer is not None:
                found = self.safe if answer[0] == REST else answer[1]
                if lockstep:
                    return found


class _FarEnd:
    """Another process, which serves one simulated rig after the other; leaving it ends it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_serve, args=(there,), daemon=True)
        self._process.start()

    def __enter__(self) -> _FarEnd:
        """Return it."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()

    def begin(self, periods: int, **settings: Any) -> int:
        """Serve a rig for so many periods, and return its port.

        Args:
            periods: How many.
            **settings: Arguments of `SimulatedRig`.
        """
        try:
            self._here.send((periods, settings))
            answer: int | Exception = self._here.recv()
        except (AttributeError, PicklingError) as error:  # a class within a function has no address
            answer = error
        if isinstance(answer, Exception):
            plant = type(settings["system"])
            raise ValueError(
                f"the simulated rig plays its plant in another process, which cannot import {plant.__qualname__} of "
                f"{plant.__module__} ({answer}); write the class into a Python file of its own that can be imported "
                "(docs/plant.md), and import it from there"
            ) from answer
        return answer

    def end(self) -> _Record:
        """Return what the rig saw, once it has run all its periods."""
        record: _Record = self._here.recv()
        return record


@contextmanager
def rehearsal(
    system: System,
    dt: float,
    sensors: Sensors | None = None,
    seed: int = 0,
    bounds: Mapping[str, Ends] | None = None,
    start: Mapping[str, Ends] | None = None,
) -> Iterator[UdpRig]:
    """Talk to a simulated rig in another process, which ends with the conversation.

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
        raise ValueError(
            "rig=simulated moves a plant by its equations, which nobody knows of this one; give rig=udp and the "
            "address of the rig, rig.host"
        )
    ends = start_ranges(system.signature, start or {}).double()

    def _begins(batch: torch.Size) -> torch.Tensor:
        return sample_states(ends, batch, torch.Generator().manual_seed(seed))

    limits = state_limits(system.signature, bounds or {})
    require_start_within(system.signature, ends, limits)
    require_plant(system, _begins, limits)
    with _FarEnd() as end:
        begin = _begins(torch.Size()).numpy()
        port = end.begin(FOREVER, system=system, dt=dt, sensors=sensors, seed=seed, start=begin)
        with connect(system, dt, port=port) as rig:
            yield rig


def _serve(pipe: Connection) -> None:
    torch.set_num_threads(1)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a script's own handlers came with its module
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the flight; this end notices its silence
    while True:
        try:
            periods, settings = pipe.recv()
        except (ImportError, AttributeError) as error:  # the other end knows what to say about it
            pipe.send(error)
            continue
        rig = SimulatedRig(**settings)
        pipe.send(rig.port)
        pipe.send(rig.serve(periods))
