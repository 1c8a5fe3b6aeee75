"""A flight: measure, act, apply, once per control period, until it is over or something is wrong.

Whatever ends it, its length, a fault, Ctrl-C or an error of a program: the rig gets its safe input first, then the log
is closed, and what was wrong is said in one line.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dynasindy.rig.base import Array, Fault, Rig, RigClock, Wiring
from dynasindy.rig.log import Log
from dynasindy.systems.base import WHOLE, Ends
from dynasindy.text import unit_suffix

Act = Callable[[Array, float], Array]
"""What was measured `(n_x,)` and the time since the start [s], to inputs `(n_u,)` in [-1, 1]."""


@dataclass(frozen=True)
class Guard:
    """What a flight goes on with.

    Attributes:
        low: Lower end of each state's range, by name [unit of the state]; a state without one is not guarded.
        high: Upper end, likewise.
        late: Share of a control period by which inputs may be late.
        lost: Samples in a row that may be lost; the controller is then shown NaN, which needs an observer.

    Raises:
        ValueError: A number is negative, or a lower end is not below its upper end.
    """

    low: dict[str, float] | None = None
    high: dict[str, float] | None = None
    late: float = 0.5
    lost: int = 1

    def __post_init__(self) -> None:
        if not self.late >= 0 or self.lost < 0:
            raise ValueError(f"a guard has late={self.late} periods, lost={self.lost} samples; give numbers >= 0")
        for name, (low, high) in self.ranges.items():
            if not low < high:
                raise ValueError(f"a guard keeps {name} within {low} to {high}; give a lower and a higher end")

    @cached_property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Return lower and upper end of each state that is guarded, infinite where there is none."""
        low, high = self.low or {}, self.high or {}
        return {name: (low.get(name, -np.inf), high.get(name, np.inf)) for name in {**low, **high}}

    def or_limits(self, bounds: Mapping[str, Ends], wiring: Wiring) -> Guard:
        """Return the guard, or without a range of its own one with the limits of the plant.

        Args:
            bounds: Limits by state: two ends, or one number for both sides of zero [unit of the state].
            wiring: Tells which states are measured; limits of others are left out.

        Raises:
            ValueError: One of the limits is no range.
        """
        if self.low or self.high:
            return self
        given = {name: ends for name, ends in bounds.items() if name in wiring.measured}
        ends = wiring.signature.state_limits(given).tolist()
        low, high = ({name: side[wiring.signature.state_index(name)] for name in given} for side in ends)
        return replace(self, low=low, high=high)

    def require(self, wiring: Wiring) -> None:
        """Make sure that every range is one of a measured state.

        Raises:
            ValueError: It is not.
        """
        if unknown := [name for name in self.ranges if name not in wiring.measured]:
            raise ValueError(f"a guard has a range of '{unknown[0]}'; measured are {', '.join(wiring.measured)}")

    def summary(self, wiring: Wiring) -> str:
        """Say within which ranges a flight goes on."""
        units = dict(zip(wiring.signature.state_names, wiring.signature.state_units, strict=True))
        told = [f"{name} within {low:g} to {high:g} {units[name]}" for name, (low, high) in self.ranges.items()]
        if not told:
            return "No state has a range that ends a flight; give plant.bounds, or guard.low and guard.high"
        return f"A flight goes on with {', '.join(told)}"

    def check(self, y: Array, wiring: Wiring) -> None:
        """Look at a sample, `(n_x,)`.

        Raises:
            Fault: A measured state is not a finite number, or outside of its range.
        """
        for name, value, known in zip(wiring.signature.state_names, y.tolist(), wiring.seen, strict=True):
            if not known:
                continue
            if not np.isfinite(value):
                raise Fault("invalid", f"{name} was measured as {value}")
            low, high = self.ranges.get(name, (-np.inf, np.inf))
            if not low <= value <= high:
                unit = wiring.signature.state_units[wiring.signature.state_index(name)]
                allowed = f"{low:.6g} to {high:.6g}"
                raise Fault("range", f"{name} is {value:.6g}{unit_suffix(unit)}, outside of {allowed}")


@dataclass(frozen=True)
class FlightResult:
    """What came of a flight.

    Attributes:
        periods: Control periods that were flown.
        fault: What ended it early; None if nothing did.
        computing: Time from a sample to its inputs, in each period [s].
        jitter: How much later than due each period began, for a rig that is asked; for one that streams, how much
            longer than a period its samples were apart [s].
        lost: Samples that did not come, the bridged ones too.
    """

    periods: int
    fault: Fault | None
    computing: Array
    jitter: Array
    lost: int = 0

    def __str__(self) -> str:
        slowest, latest = (1e3 * float(np.max(t, initial=0.0)) for t in (self.computing, self.jitter))
        lost = f"{self.lost} sample{'s' * (self.lost != 1)} lost, " if self.lost else ""
        times = f"inputs after {slowest:.2f} ms at most, jitter {latest:.2f} ms at most"
        line = f"{self.periods} periods, {lost}{times}" if self.periods else "no period was flown"
        return f"{line}; ended by {self.ended}; the rig was asked for its safe input" if self.ended else line

    @property
    def ended(self) -> str:
        """What ended it early, in words; empty if nothing did."""
        return "" if self.fault is None else f"{self.fault.kind}: {self.fault}"


def run_flight(
    rig: Rig,
    act: Act,
    wiring: Wiring,
    periods: int,
    path: Path,
    guard: Guard | None = None,
    clock: RigClock = time,
) -> FlightResult:
    """Fly a rig, and leave it at its safe input.

    Args:
        rig: The plant.
        act: The controller, or an excitation.
        wiring: What is measured, and how often.
        periods: How many of them.
        path: Log to write.
        guard: What it goes on with.
        clock: Tells the time and waits.

    Returns:
        How the flight went, and why it ended.

    Raises:
        ValueError: A range is that of no measured state, or the log exists already; nothing has moved.
        OSError: The log cannot be written; nothing has moved.
        KeyboardInterrupt: It was asked to stop; the rig is at its safe input and the log is closed.
    """
    guard = guard or Guard()
    guard.require(wiring)
    fault: Fault | None = None
    with closing(Log(path, wiring)) as log:
        loop = _FlightLoop(rig, wiring, guard, clock)
        try:
            loop.run(act, periods, log)
        except Fault as error:
            fault = error
        except OSError as error:
            fault = Fault("connection", f"{type(error).__name__}: {error}")
        finally:  # before anything else, the closing of the log included
            try:
                rig.rest()
            finally:
                loop.watchdog.close()
    return FlightResult(log.rows, fault, np.array(loop.computing), np.array(loop.jitter), loop.lost)


ROUNDING = 1e-6
"""By how much an input may leave its limits, as single precision makes it."""
FIRST = 10
"""Times longer that the first sample may take: a rig has to begin."""


class _FlightLoop:
    """The control periods of one flight, each of which raises a `Fault` with which it does not go on."""

    def __init__(self, rig: Rig, wiring: Wiring, guard: Guard, clock: RigClock) -> None:
        self.rig, self.wiring, self.guard, self.dt, self.clock = rig, wiring, guard, wiring.dt, clock
        self.computing: list[float] = []
        self.jitter: list[float] = []
        self.missed = self.lost = 0
        self.heard = False  # whether any sample has come
        self.watchdog = _Watchdog(rig.rest, clock)

    def run(self, act: Act, periods: int, log: Log) -> None:
        self.rig.begin()
        self.start = self.begun = self.clock.monotonic()
        k, u, nothing = 0, np.zeros(self.wiring.signature.n_u), np.full(self.wiring.signature.n_x, np.nan)
        while k < periods:
            y = self._read(k)
            if y is not None and self.rig.number is not None:
                for gone in range(k, min(self.rig.number, periods)):  # samples that never came
                    self._check(None)
                    self._write_down(log, gone, nothing, u)
                k = max(k, self.rig.number)
            if k >= periods:
                return
            self._check(y)
            try:
                given = act(nothing.copy() if y is None else y, k * self.dt)
            except Exception as error:  # any: whatever the controller does, it costs one line and the rig comes to rest
                why = " ".join(str(error).split())
                raise Fault("controller", f"it failed with {type(error).__name__}: {why}") from error
            u = self._apply(given)
            self._write_down(log, k, nothing if y is None else y, u)
            k += 1

    def _read(self, k: int) -> Array | None:
        """Return the sample of a period, None if it is lost, and note when it came."""
        if not self.rig.streams:
            self.clock.sleep(max(0.0, self.start + k * self.dt - self.clock.monotonic()))
        allowed = (1 + self.guard.late) * self.dt * (1 if k else FIRST)
        self.watchdog.within(2 * allowed)  # the rig may hang in a call that does not keep to its time
        end = self.clock.monotonic() + allowed
        y = self.rig.read(allowed)
        # One that comes so late that its period was bridged is not taken for that of the next one.
        while y is not None and self.rig.number is not None and self.rig.number < k:
            y = self.rig.read(max(0.0, end - self.clock.monotonic()))
        arrived = self.clock.monotonic()
        self.watchdog.within(self.guard.late * self.dt)
        if k == 0:
            self.start = arrived  # the clock starts with the first sample
        else:
            due = self.begun + self.dt if self.rig.streams else self.start + k * self.dt
            self.jitter.append(max(0.0, arrived - due))
        self.begun = arrived
        return y

    def _check(self, y: Array | None) -> None:
        n_x = self.wiring.signature.n_x
        if y is not None:
            self.missed, self.heard = 0, True
            if np.shape(y) != (n_x,):
                raise Fault("invalid", f"a sample has the shape {np.shape(y)}, the plant {n_x} states")
            self.guard.check(y, self.wiring)
            return
        self.missed, self.lost = self.missed + 1, self.lost + 1
        if self.heard and self.missed <= self.guard.lost:
            return
        many = f"{self.missed} samples" if self.missed > 1 else "1 sample"
        told = f"{many} in a row did not come, and guard.lost={self.guard.lost} is allowed"
        if not self.heard:  # nobody knows where a flight would begin
            told = "no sample came to begin with; see that the rig is on and sends one per period to this computer"
        strange = getattr(self.rig, "strange", "")  # of a rig that tells what came in place of samples
        raise Fault("lost", f"{told}; {strange}" if strange else told)

    def _apply(self, given: Any) -> Array:
        """Apply inputs to the sample that was read last, and return them, `(n_u,)`."""
        took = self.clock.monotonic() - self.begun
        self.computing.append(took)  # those that came too late, too: the line about the flight names the slowest
        self._require_in_time(took)
        u, signature = np.asarray(given, dtype=np.float64), self.wiring.signature
        limits = signature.input_limits or (WHOLE,) * signature.n_u
        low, high = np.array(limits).T
        if u.shape != (signature.n_u,) or not ((low - ROUNDING <= u) & (u <= high + ROUNDING)).all():
            allowed = ", ".join(f"[{least:.6g}, {most:.6g}]" for least, most in dict.fromkeys(limits))
            raise Fault("controller", f"it gave {u.tolist()}, not {signature.n_u} numbers in {allowed}")
        self.rig.write(u)
        self._require_in_time(took)  # the watchdog may have barked meanwhile, and its safe input been overruled
        self.watchdog.within(2 * (1 + self.guard.late) * self.dt)  # the log, too, is not what the rig waits for
        return u

    def _require_in_time(self, took: float) -> None:
        allowed = self.guard.late * self.dt
        if self.watchdog.barked or took > allowed:
            told = f"inputs took {1e3 * took:.1f} ms, {1e3 * allowed:.1f} ms are allowed"
            if self.watchdog.barked:
                told = f"controller and rig did not come round within {1e3 * allowed:.1f} ms"
            mend = f"end what else this computer does, or give more than guard.late={self.guard.late:g} of a period"
            raise Fault("late", f"{told}; {mend}")

    def _write_down(self, log: Log, k: int, y: Array, u: Array) -> None:
        try:
            log.add(k * self.dt, y, u)
        except OSError as error:
            raise Fault("log", f"the log cannot be written: {error.strerror or error}") from error


class _Watchdog:
    """Call a function whenever a deadline has passed that was not renewed: a loop may hang, this thread does not."""

    def __init__(self, bark: Callable[[], None], clock: RigClock) -> None:
        self.bark, self.barked, self.clock = bark, False, clock
        self._deadline: float | None = None
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def within(self, seconds: float) -> None:
        """Ask for the next call of `within` or `close` in so many seconds."""
        with self._changed:
            self._deadline = self.clock.monotonic() + seconds
            self._changed.notify()

    def close(self) -> None:
        """Stop watching; the function is not called any more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _watch(self) -> None:
        with self._changed:
            while not self._closed:
                left = None if self._deadline is None else self._deadline - self.clock.monotonic()
                if left is None or left > 0:
                    self._changed.wait(left)
                else:
                    self.barked, self._deadline = True, None
                    with suppress(Exception):  # any: the thread has to go on watching
                        self.bark()
