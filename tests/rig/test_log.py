"""A log holds every row that was added, whatever ends it."""

import math
from contextlib import closing

import numpy as np
import pytest

from dynasindy.rig import Wiring
from dynasindy.rig.log import FlightRecord, Log
from dynasindy.systems import Pendulum, Signature

WIRING = Wiring(Pendulum().signature, (False, True), 0.05)


def test_rows_are_in_the_file_as_soon_as_they_are_added(tmp_path):
    path = tmp_path / "new" / "log.csv"
    with closing(Log(path, WIRING)) as log:
        log.add(0.05, np.array([math.nan, 1.25]), np.array([-0.5]))
        assert path.read_text().splitlines() == ["time [s],Omega [rad/s],u [-]", "0.050000,1.25,-0.5"]
        log.add(0.1, np.array([math.nan, math.nan]), np.array([0.5]))
        assert log.rows == 2
    assert path.read_text().splitlines()[2] == "0.100000,,0.5"


SIGNATURE = Signature(("theta", "level"), ("rad", "m"), ("u",), (1.0, 1.0))
LOG = """time [s],theta [rad],u [-]
0.0,5.0,0.1
0.1,5.0,0.2
0.2,0.9,0.3
0.3,1.3,0.4
0.4,5.0,0.5
0.5,5.0,0.6
0.6,,
0.7,-0.75,0.8
"""


@pytest.fixture
def flight(tmp_path):
    (tmp_path / "flight_1.csv").write_text(LOG)
    targets = [[1.0, 0.0]] * 4 + [[-1.0, 0.0]] * 4
    return FlightRecord.of(tmp_path / "flight_1.csv", SIGNATURE, ("theta", "level"), targets)


def test_the_last_half_of_each_target_counts(flight):
    """|0.9 - 1|, |1.3 - 1| and |-0.75 + 1|; the sample at 0.6 s was lost."""
    assert flight.ends.tolist() == [False, False, True, True, False, False, True, True]
    assert flight.errors()[0] == pytest.approx((0.1 + 0.3 + 0.25) / 3)
    assert np.isnan(flight.errors()[1])
    assert "0.217 rad" in flight.summary() and "level" in flight.summary()


def test_what_is_drawn_is_the_log(flight):
    assert flight.inputs[:, 0].tolist()[:6] == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert np.isnan(flight.outputs[6, 0]) and np.isnan(flight.inputs[6, 0])
    assert flight.references[:, 0].tolist() == [1.0] * 4 + [-1.0] * 4


def test_samples_are_those_of_the_log_in_the_order_of_the_plant(tmp_path):
    (tmp_path / "log.csv").write_text("time [s],v [m/s],u [-],w [-]\n0.0,1.5,0.1,-0.1\n0.5,,0.2,-0.2\n1.0")
    plant = Signature(("x", "v"), ("m", "m/s"), ("w", "u"), (1.0, 1.0))
    time, states, inputs = Log.read(tmp_path / "log.csv", plant)
    assert time.tolist() == [0.0, 0.5] and inputs.tolist() == [[-0.1, 0.1], [-0.2, 0.2]]
    assert np.isnan(states[:, 0]).all() and states[0, 1] == 1.5 and np.isnan(states[1, 1])


def test_a_flight_that_ended_early_is_shown_as_far_as_it_went(tmp_path):
    (tmp_path / "log.csv").write_text("\n".join(LOG.splitlines()[:3]))
    short = FlightRecord.of(tmp_path / "log.csv", SIGNATURE, ("theta",), [[1.0]] * 8)
    assert len(short.time) == len(short.references) == 2
    assert short.errors()[0] == pytest.approx(4.0)
    (tmp_path / "none.csv").write_text(LOG.splitlines()[0] + "\n")
    none = FlightRecord.of(tmp_path / "none.csv", SIGNATURE, ("theta",), [[1.0]] * 8)
    assert "no period" in none.summary()
