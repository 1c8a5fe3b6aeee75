"""A simulated rig in another process, over UDP at its own clock: jitter, and faults that end in the safe input.

A flight without faults tells how late samples and inputs are. Then faults are injected at random moments: some at the
rig's end, some in the controller, and the flight's own end by a signal. What counts is which inputs the plant got: how
many periods after the fault it had something else than its safe input for the last time.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.common import add_output, commit
from dynasindy.rig import Fault, FlightResult, Guard, UdpRig, Wiring, run_flight
from dynasindy.rig.base import Array
from dynasindy.rig.simulated import FAULTS as THEIRS
from dynasindy.rig.simulated import FarEnd, Record
from dynasindy.safe_io import Row, append_rows, read_rows
from dynasindy.systems import Pendulum

COLUMNS = (
    *("hertz", "fault", "at_period", "ended_by"),
    *("periods_to_request", "periods_to_safe", "rows_lost", "milliseconds", "commit"),
)
SAFE = np.array([0.25])
FAULTS = (*THEIRS, "raises", "hangs", "no_number", "ctrl_c")
NEVER = 99
"""Periods to a request that did not come."""
PERIODS = 40
"""Length of a flight with a fault [control periods]."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--hertz", type=float, nargs="+", default=[20.0, 100.0])
    parser.add_argument("--moments", type=int, default=5, help="moments at which each fault is injected")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the flight without faults")
    add_output(parser, "rig")


def main(arguments: argparse.Namespace) -> None:
    """Fly without faults, then with them, and append a row for each flight."""
    draw = random.Random(0)
    with FarEnd() as end:
        for hertz in arguments.hertz:
            rows = [run_calm(end, hertz, round(arguments.seconds * hertz))]
            append_rows(arguments.out, COLUMNS, rows)
            for fault in FAULTS:
                for _ in range(arguments.moments):
                    row = run_with_fault(end, hertz, fault, draw.randrange(5, PERIODS - 10))
                    append_rows(arguments.out, COLUMNS, [row])
                    print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    found = [row for row in read_rows(arguments.out) if row["fault"] != "none"]
    safe = sum(is_safe(row) for row in found)
    print(f"{safe} of {len(found)} faults ended in the safe input within one period, and nothing was lost")


def is_safe(row: Row) -> bool:
    """Return whether a fault ended as it should: the safe input a period later, asked for by the flight, no row lost.

    The rig that is gone hears no request; its own watch gives it the safe input.
    """
    asked = row["fault"] == "gone" or float(row["periods_to_request"]) <= 1
    return asked and float(row["periods_to_safe"]) <= 1 and float(row["rows_lost"]) == 0


def run_calm(end: FarEnd, hertz: float, periods: int) -> Row:
    """Fly without a fault; the milliseconds are those by which the latest sample was late."""
    flown, _, _ = _flown(end, hertz, {}, lambda y, t: np.array([0.3 * math.sin(t)]), periods)
    late = 1e3 * float(np.quantile(flown.jitter, 0.999))
    ended = "nothing" if flown.fault is None else flown.fault.kind
    return _row((hertz, "none", periods, ended), (0, 0, 0), late)


def run_with_fault(end: FarEnd, hertz: float, fault: str, at: int) -> Row:
    """Fly, and have something go wrong at a period."""
    theirs = {fault: at} if fault in THEIRS else {}

    def _act(y: Array, t: float) -> Array:
        if theirs or round(t * hertz) < at:
            return np.array([0.3 * math.sin(t) + 0.1])
        return _go_wrong(fault, 20 / hertz)

    flown, record, rows = _flown(end, hertz, theirs, _act, PERIODS)
    begins = at + (fault == "old")  # the first of those that are all alike is new
    unsafe = [k for k, u in enumerate(record.applied) if k >= begins and not np.array_equal(u, SAFE)]
    last = unsafe[-1] - begins + 1 if unsafe else 0
    asked = next((max(0, k - begins) for k, rest in enumerate(record.asked) if rest), NEVER)
    slowest = 1e3 * float(np.max(flown.computing, initial=0.0))
    ended = flown.fault.kind if flown.fault else "nothing"
    return _row((hertz, fault, at, ended), (asked, last, flown.periods - rows), slowest)


def _go_wrong(fault: str, seconds: float) -> Array:
    if fault == "raises":
        raise ArithmeticError("the controller divided by zero")
    if fault == "hangs":
        time.sleep(seconds)
    if fault == "ctrl_c":
        # The command that runs this module has a handler of its own, which would end all flights.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(seconds)
    return np.array([math.nan])


def _flown(
    end: FarEnd, hertz: float, theirs: dict[str, int], act: Callable[[Array, float], Array], periods: int
) -> tuple[FlightResult, Record, int]:
    """Return what came of a flight, what the rig saw, and the rows of the log."""
    wiring = Wiring(Pendulum().signature, (True, True), 1 / hertz)
    guard = Guard({"theta": -50.0}, {"theta": 50.0}, lost=0)
    port = end.begin(periods + 5, system=Pendulum(), dt=1 / hertz, safe=SAFE, faults=theirs)
    with tempfile.TemporaryDirectory() as folder:
        log, rig = Path(folder) / "log.csv", UdpRig(2, 1, port=port)
        try:
            flown = run_flight(rig, act, wiring, periods, log, guard)
        except KeyboardInterrupt:
            stopped = len(log.read_text().splitlines()) - 1
            flown = FlightResult(stopped, Fault("stopped", "by a signal"), np.zeros(0), np.zeros(1))
        rig.close()
        rows = len(log.read_text().splitlines()) - 1
    return flown, end.end(), rows


def _row(what: tuple[float, str, int, str], counts: tuple[int, int, int], ms: float) -> Row:
    return dict(zip(COLUMNS, (*what, *counts, round(ms, 2), commit()), strict=True))
