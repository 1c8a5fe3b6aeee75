"""Flights of which somebody else holds the loop: a period is flown whenever it is asked for.

A flight that is left in the middle ends in the safe input by itself, as the watchdog waits for the next inputs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dynasindy.rig.base import Array, Fault, Rig, RigClock, Wiring
from dynasindy.rig.flight import FlightLoop, Guard, connection_fault
from dynasindy.rig.log import Log


class FlightSequence:
    """One flight of a rig after the other, a period at a time.

    Attributes:
        wiring: What is measured, and how often.
        k: Control periods of the present flight so far.

    Args:
        rig: The plant.
        wiring: What is measured, and how often.
        guard: What a flight goes on with.
        folder: Where each flight leaves a log, `episode_N.csv`; none is written if omitted.
        settle: Time at the safe input before each flight, in which the plant comes to rest [s].
        clock: Tells the time and waits.

    Raises:
        ValueError: The guard has a range of no measured state, or the time to settle is negative.
    """

    def __init__(
        self,
        rig: Rig,
        wiring: Wiring,
        guard: Guard | None = None,
        folder: Path | None = None,
        settle: float = 0.0,
        clock: RigClock = time,
    ) -> None:
        self.rig, self.wiring, self.guard, self.clock = rig, wiring, guard or Guard(), clock
        self.guard.require(wiring)
        if not settle >= 0:
            raise ValueError(f"a rig is given settle={settle} s to come to rest; give a time >= 0")
        self.folder, self.settle, self.k = folder, settle, 0
        self._loop: FlightLoop | None = None
        self._log: Log | None = None
        self._y = np.full(wiring.signature.n_x, np.nan)
        self._dry = False

    def begin(self) -> Array:
        """End what was flown, let the plant settle, and return the first sample of a new flight, `(n_x,)`.

        The rig stays at its safe input until the first period is asked for, which may take as long as it likes.

        Raises:
            Fault: The sample is none with which a flight begins, or the connection is broken.
        """
        self.end()
        with self._safe():
            self.rig.rest()
            self.clock.sleep(self.settle)
        return self._first()

    def period(self, u: Array) -> Array:
        """Apply inputs `(n_u,)` to the last sample and return the next one, `(n_x,)`, NaN where nothing was measured.

        Raises:
            Fault: Something is wrong; the rig is at its safe input.
            RuntimeError: No flight has begun, or it is over.
        """
        if self._dry:
            return self._y
        with self._safe():
            if self._loop is None:
                raise RuntimeError("no flight of the rig has begun, or it is over; reset the environment first")
            # Half of what is allowed: the first inputs are to be in time for the sample that they answer.
            if not self.k and self.clock.monotonic() - self._loop.begun > 0.5 * self.guard.late * self.wiring.dt:
                self._first()
            loop = self._loop
            if not self.k:
                self._log = self._new_log()
            inputs = loop.apply(u)
            if self._log is not None:
                loop.write_down(self._log, self.k, self._y, inputs)
            self.k += 1
            y, number = loop.read(self.k), self.rig.number
            if y is not None and number is not None and number > self.k:
                raise Fault("lost", f"the rig went on by {number - self.k} periods in which nothing was applied anew")
            self._y = loop.sample(y)
            return self._y

    def end(self) -> None:
        """Ask for the safe input, if a flight has begun, and close its log."""
        if self._dry:
            return
        loop, log = self._loop, self._log
        self._loop = self._log = None
        try:
            if loop is not None:
                loop.end()  # before anything else, the closing of the log included
        finally:
            if log is not None:
                log.close()

    @contextmanager
    def dry(self) -> Iterator[None]:
        """Move nothing meanwhile: a period gives the last sample again, at once, and does not count."""
        self._dry = True
        try:
            yield
        finally:
            self._dry = False

    def _first(self) -> Array:
        with self._safe():
            if self._loop is not None:
                self._loop.end()
            self._loop, self.k = FlightLoop(self.rig, self.wiring, self.guard, self.clock), 0
            self._loop.begin()
            self._y = self._loop.sample(self._loop.read(0))
            return self._y

    def _new_log(self) -> Log | None:
        if self.folder is None:
            return None
        number = 0
        while (path := self.folder / f"episode_{number}.csv").exists():
            number += 1
        try:
            return Log(path, self.wiring)
        except OSError as error:
            raise Fault("log", f"the log cannot be written: {error.strerror or error}") from error

    @contextmanager
    def _safe(self) -> Iterator[None]:
        """End the flight with whatever ends what is done in it."""
        try:
            yield
        except BaseException as error:
            self.end()
            if isinstance(error, OSError):
                raise connection_fault(error) from error
            raise
