"""Flights a period at a time: what is applied and logged when, and what ends them."""

import threading

import numpy as np
import pytest

from dynasindy.rig import FastClock, Fault, FlightSequence, Guard, Wiring
from dynasindy.systems import Pendulum

WIRING = Wiring(Pendulum().signature, (True, True), 0.05)


class Noting:
    """A rig that gives samples out of a list and notes what it is told, and when."""

    streams, number = False, None

    def __init__(self, clock, samples=None):
        self.clock, self.samples = clock, samples
        self.told, self.resting = [], threading.Event()
        self.asked = []

    def begin(self):
        self.told.append("begin")

    def read(self, seconds):
        self.asked.append(round(self.clock.monotonic(), 9))
        return np.full(2, float(len(self.asked))) if self.samples is None else self.samples.pop(0)

    def write(self, u):
        self.told.append(float(u[0]))

    def rest(self):
        self.told.append("rest")
        self.resting.set()


def flights(samples=None, clock=None, **settings):
    clock = clock or FastClock()
    rig = Noting(clock, samples)
    return rig, FlightSequence(rig, WIRING, clock=clock, **settings)


def u(value):
    return np.array([value])


def test_each_period_applies_its_inputs_and_waits_for_the_next_sample():
    rig, flown = flights(settle=3.0)
    assert flown.begin().tolist() == [1.0, 1.0]
    assert [flown.period(u(0.1 * k)).tolist() for k in range(3)] == [[k, k] for k in (2.0, 3.0, 4.0)]
    flown.end()
    flown.end()
    assert rig.asked == [3.0, 3.05, 3.1, 3.15]
    assert rig.told == ["rest", "begin", 0.0, 0.1, 0.2, "rest"]
    assert flown.k == 3


def test_a_new_flight_ends_the_one_before():
    rig, flown = flights()
    flown.begin()
    flown.period(u(0.5))
    flown.begin()
    assert rig.told == ["rest", "begin", 0.5, "rest", "rest", "begin"]
    assert flown.k == 0


def test_each_flight_leaves_a_log_of_its_own(tmp_path):
    nan = np.full(2, np.nan)
    for _ in range(2):  # as of a run that is resumed
        _, flown = flights([np.zeros(2), None, np.ones(2), nan], folder=tmp_path)
        flown.begin()
        flown.period(u(0.1))
        flown.period(u(0.2))
        with pytest.raises(Fault, match="measured"):
            flown.period(u(0.3))
    head = "time [s],theta [rad],Omega [rad/s],u [-]"
    rows = [head, "0.000000,0,0,0.1", "0.050000,,,0.2", "0.100000,1,1,0.3"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["episode_0.csv", "episode_1.csv"]
    for path in tmp_path.iterdir():
        assert path.read_text().splitlines() == rows


def test_a_log_that_cannot_be_begun_ends_the_flight_before_anything_moves(tmp_path):
    (tmp_path / "logs").write_text("a file, no folder")
    rig, flown = flights(folder=tmp_path / "logs")
    flown.begin()
    with pytest.raises(Fault, match="written") as found:
        flown.period(u(0.1))
    assert found.value.kind == "log"
    assert rig.told == ["rest", "begin", "rest"]


def test_first_inputs_may_take_their_time_and_answer_a_fresh_sample():
    rig, flown = flights()
    flown.begin()
    rig.clock.sleep(60.0)
    assert flown.period(u(0.4)).tolist() == [3.0, 3.0]
    assert rig.asked == [0.0, 60.0, 60.05]
    assert [told for told in rig.told if told != "rest"] == ["begin", "begin", 0.4]


def test_later_inputs_may_not():
    rig, flown = flights()
    flown.begin()
    flown.period(u(0.4))
    rig.resting.clear()
    rig.clock.sleep(0.026)
    assert rig.resting.wait(20.0)  # the watchdog does not wait for the next period to be asked for
    with pytest.raises(Fault) as found:
        flown.period(u(0.3))
    assert found.value.kind == "late"
    assert rig.told[-1] == "rest" and 0.3 not in rig.told


def test_a_rig_that_went_on_alone_is_not_followed():
    class Numbered(Noting):
        streams = True

        def read(self, seconds):
            self.number = self.samples.pop(0)
            return np.zeros(2)

    clock = FastClock()
    rig = Numbered(clock, [0, 1, 3])
    flown = FlightSequence(rig, WIRING, clock=clock)
    flown.begin()
    flown.period(u(0.1))
    with pytest.raises(Fault, match="went") as found:
        flown.period(u(0.2))
    assert (found.value.kind, rig.told[-1]) == ("lost", "rest")


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError("the cable is out"), ZeroDivisionError])
def test_whatever_ends_a_period_leaves_the_rig_at_its_safe_input(error):
    class Failing(Noting):
        def write(self, u):
            raise error

    before = threading.active_count()
    rig = Failing(FastClock())
    flown = FlightSequence(rig, WIRING, clock=rig.clock)
    flown.begin()
    with pytest.raises(Fault if isinstance(error, OSError) else error):
        flown.period(u(0.1))
    assert rig.told[-1] == "rest"
    assert threading.active_count() == before
    with pytest.raises(RuntimeError, match="reset"):
        flown.period(u(0.1))


def test_bad_settings_are_found_before_anything_moves():
    with pytest.raises(ValueError, match=r"settle=-1\.0 s"):
        flights(settle=-1.0)
    with pytest.raises(ValueError, match="measured"):
        flights(guard=Guard(low={"thta": 0.0}))
