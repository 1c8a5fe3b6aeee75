"""The benchmark counts the periods in which the plant has something else than its safe input."""

import signal
import threading

import numpy as np
import pytest
from benchmarks import rig

from dynasindy.rig.simulated import Record, SimulatedRig


class Here:
    """The far end in a thread, in lockstep, so that a busy computer is no fault."""

    def begin(self, periods, **settings):
        server = SimulatedRig(**settings)
        self.record = Record()
        self.thread = threading.Thread(target=self._serve, args=(server, periods))
        self.thread.start()
        return server.port

    def _serve(self, server, periods):
        self.record = server.serve(periods, lockstep=2.0)

    def end(self):
        self.thread.join()
        return self.record


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    monkeypatch.setattr(rig, "PERIODS", 6)
    monkeypatch.setattr(rig, "Guard", lambda low, high, lost: rig_guard(low, high, lost))


def rig_guard(low, high, lost):
    from dynasindy.rig import Guard

    return Guard(low, high, late=20.0, lost=lost)


def test_a_fault_of_the_controller_is_counted():
    row = rig.run_with_fault(Here(), 20.0, "raises", 3)
    assert (row["ended_by"], row["periods_to_request"], row["periods_to_safe"]) == ("controller", 0, 0)
    assert rig.is_safe(row)


def test_ctrl_c_ends_the_flight_and_not_the_benchmark():
    """Whatever handler the command has, which ends the process."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        row = rig.run_with_fault(Here(), 20.0, "ctrl_c", 3)
    finally:
        signal.signal(signal.SIGINT, before)
    assert (row["ended_by"], row["periods_to_request"], row["rows_lost"]) == ("stopped", 0, 0)


def test_inputs_that_go_on_are_counted_against_it(monkeypatch):
    class Stubborn(Here):
        def end(self):
            record = super().end()
            record.applied = [np.array([0.1])] * 7
            return record

    assert rig.run_with_fault(Stubborn(), 20.0, "nan", 4)["periods_to_safe"] == 3


def test_a_flight_that_does_not_ask_is_no_success():
    """The far end comes to rest by its own watch, which is not the flight's merit."""
    assert not rig.is_safe({"fault": "nan", "periods_to_request": rig.NEVER, "periods_to_safe": 1, "rows_lost": 0})
    assert rig.is_safe({"fault": "gone", "periods_to_request": rig.NEVER, "periods_to_safe": 1, "rows_lost": 0})
    assert not rig.is_safe({"fault": "nan", "periods_to_request": 0, "periods_to_safe": 2, "rows_lost": 0})
    assert not rig.is_safe({"fault": "nan", "periods_to_request": 0, "periods_to_safe": 0, "rows_lost": 1})
