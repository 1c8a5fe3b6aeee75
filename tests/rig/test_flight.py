"""Flights of a simulated rig over UDP: what is flown is right, and whatever goes wrong ends in the safe input."""

import math
import threading
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from far_end import FarEnd
from fast_clock import FastClock

from dynasindy.data.recording import LogReader
from dynasindy.rig import Guard, UdpRig, Wiring, run_flight
from dynasindy.rig.simulated import SimulatedRig
from dynasindy.systems import Pendulum

WIRING = Wiring(Pendulum().signature, (True, True), 0.05)
SAFE = np.array([0.25])
PATIENT = Guard(late=10.0, lost=1)
"""Half a second at a period of 50 ms: this computer may be busy."""


class Still:
    """A rig that is asked, whose samples have no numbers."""

    streams, number = False, None

    def begin(self):
        pass

    def rest(self):
        pass


def swing(y, t):
    return np.array([0.5 * math.sin(3 * t) - 0.1 * np.nan_to_num(y[1])])


@contextmanager
def served(periods):
    """Serve a pendulum for so many samples; yield its rig and its far end."""
    far = FarEnd(Pendulum(), 0.05, safe=SAFE)
    thread = threading.Thread(target=far.serve, args=(periods,))
    thread.start()
    rig = UdpRig(2, 1, port=far.port)
    try:
        yield rig, far
    finally:
        rig.close()
        thread.join()


def test_the_log_is_read_back_by_identification(tmp_path):
    with served(61) as (rig, far):
        run_flight(rig, swing, WIRING, 60, tmp_path / "log.csv", PATIENT)
    units = {"theta": {"name": "theta", "unit": "rad"}, "Omega": {"name": "Omega", "unit": "rad/s"}}
    data = LogReader(str(tmp_path / "log.csv"), units, {"u": "u"}).recording().transitions
    np.testing.assert_allclose(data.x, np.array(far.states[:59]), atol=1e-7)
    np.testing.assert_allclose(data.u, np.array(far.applied[:59]), atol=1e-7)
    assert data.dt == pytest.approx(0.05)


class Noticing(Still):
    """A rig that notes what it is told, and when."""

    def __init__(self, hang=None):
        self.told, self.hang, self.resting = [], hang, threading.Event()

    def read(self, seconds):
        if self.hang == "read" and len(self.told) >= 2:
            assert self.resting.wait(20.0), "nobody asked for the safe input while the rig hung"
        return np.zeros(2)

    def write(self, u):
        if self.hang == "write" and len(self.told) == 2:
            assert self.resting.wait(20.0), "nobody asked for the safe input while the rig hung"
        self.told.append("inputs")

    def rest(self):
        self.told.append("rest")
        self.resting.set()


def test_inputs_beyond_what_an_actuator_reaches_never_leave(tmp_path):
    """A pump that takes 0 to 12 V gets no -0.1 of it."""
    rig = SimulatedRig(Pendulum(), clock=FastClock())
    pump = replace(WIRING, signature=replace(WIRING.signature, input_limits=((0.0, 1.0),)))
    result = run_flight(rig, lambda y, t: [0.3 - t], pump, 20, tmp_path / "log.csv", clock=rig.clock)
    assert result.periods == 7 and result.fault.kind == "controller"  # 0.3 s are six periods and their first sample
    assert "[0, 1]" in str(result.fault) and rig.u.tolist() == [0.0]


def test_a_controller_that_hangs_is_overtaken_by_the_watchdog(tmp_path):
    """It goes on only once the safe input was asked for, by another thread than its own."""
    rig = Noticing()

    def act(y, t):
        if t > 0.1:
            assert rig.resting.wait(20.0), "nobody asked for the safe input while the controller hung"
        return np.array([0.1])

    result = run_flight(rig, act, WIRING, 9, tmp_path / "log.csv", Guard(late=6.0))
    assert (result.fault.kind, result.periods) == ("late", 3)
    assert rig.told == ["inputs"] * 3 + ["rest"] * 2


@pytest.mark.parametrize("hang", ["read", "write"])
def test_a_rig_that_hangs_is_asked_for_its_safe_input_last(tmp_path, hang):
    """Inputs that were applied after the watchdog had barked are overruled again."""
    rig = Noticing(hang)
    result = run_flight(
        rig, lambda y, t: np.array([0.1]), WIRING, 3 if hang == "write" else 9, tmp_path / "log.csv", Guard(late=3.0)
    )
    assert result.fault.kind == "late"
    assert rig.told[-1] == "rest"
    assert rig.told.count("rest") == 2
    assert "round" in str(result)


def test_a_sample_that_comes_late_is_not_taken_for_the_next_one(tmp_path):
    class Numbered(Noticing):
        streams = True

        def __init__(self, samples):
            super().__init__()
            self.samples, self.number = samples, None

        def read(self, seconds):
            self.number, y = self.samples.pop(0)
            return y

    a, shown = [np.full(2, float(k)) for k in range(8)], []

    def act(y, t):
        shown.append((round(t / 0.05), y[0]))
        return np.zeros(1)

    # Sample 2 is late: its period is bridged, and it is thrown away when it comes. Sample 5 never comes.
    samples = [(0, a[0]), (1, a[1]), (1, None), (2, a[2]), (3, a[3]), (4, a[4]), (6, a[6]), (7, a[7])]
    result = run_flight(Numbered(samples), act, WIRING, 8, tmp_path / "log.csv", Guard(late=50.0))
    assert result.fault is None
    np.testing.assert_equal(shown, [(0, 0), (1, 1), (2, np.nan), (3, 3), (4, 4), (6, 6), (7, 7)])
    rows = [row.split(",")[:2] for row in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    assert rows == [[f"{0.05 * k:.6f}", "" if k in (2, 5) else str(k)] for k in range(8)]


def test_an_error_of_the_rig_at_the_end_does_not_leave_the_watchdog_alone(tmp_path):
    class Cut(Noticing):
        def rest(self):
            super().rest()
            raise OSError("cut")

    before = threading.active_count()
    with pytest.raises(OSError, match="cut"):
        run_flight(Cut(), swing, WIRING, 2, tmp_path / "log.csv", PATIENT)
    assert threading.active_count() == before


def test_ctrl_c_brings_the_rig_to_rest_and_goes_on(tmp_path):
    def act(y, t):
        if t > 0.2:
            raise KeyboardInterrupt
        return swing(y, t)

    with served(6) as (rig, far), pytest.raises(KeyboardInterrupt):
        run_flight(rig, act, WIRING, 9, tmp_path / "log.csv", PATIENT)
    for u in far.applied[5:]:
        np.testing.assert_array_equal(u, SAFE)


def test_one_lost_sample_is_shown_as_nan_and_bridged(tmp_path):
    class Polled(Still):
        rested = 0

        def __init__(self, samples):
            self.samples, self.written = list(samples), []

        def read(self, seconds):
            return self.samples.pop(0)

        def write(self, u):
            self.written.append(u)

        def rest(self):
            self.rested += 1

    shown = []

    def act(y, t):
        shown.append(y.copy())
        y[np.isnan(y)] = 0.0  # what a controller does to its own numbers is not what was measured
        return np.array([0.1])

    y = np.array([0.1, 0.2])
    rig = Polled([y, None, y, None, None, y])
    result = run_flight(rig, act, replace(WIRING, dt=0.01), 6, tmp_path / "log.csv", Guard(late=50.0, lost=1))
    assert [np.isnan(v).all() for v in shown] == [False, True, False, True]
    assert (result.fault.kind, result.periods, rig.rested, len(rig.written)) == ("lost", 4, 1, 4)
    assert "guard.lost=1" in str(result.fault) and "3 samples lost" in str(result)
    rows = (tmp_path / "log.csv").read_text().splitlines()
    assert rows[2] == "0.010000,,,0.1"


def test_the_limits_of_a_plant_guard_what_has_no_range_of_its_own():
    half = replace(WIRING, seen=(True, False))
    found = Guard(late=0.3).or_limits({"theta": 0.5, "Omega": [-1.0, 3.0]}, half)
    assert (found.low, found.high, found.late) == ({"theta": -0.5}, {"theta": 0.5}, 0.3)
    assert Guard().or_limits({"Omega": [-1.0, 3.0]}, WIRING).high == {"Omega": 3.0}
    own = Guard(high={"theta": 0.1})
    assert own.or_limits({"theta": 0.5}, WIRING) is own
