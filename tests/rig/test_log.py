"""A log holds every row that was added, whatever ends it."""

import math

import numpy as np
import pytest

from dynasindy.rig import Wiring
from dynasindy.rig.log import Log
from dynasindy.systems import Pendulum

WIRING = Wiring(Pendulum().signature, (False, True), 0.05)


def test_rows_are_in_the_file_as_soon_as_they_are_added(tmp_path):
    path = tmp_path / "new" / "log.csv"
    with Log(path, WIRING) as log:
        log.add(0.05, np.array([math.nan, 1.25]), np.array([-0.5]))
        assert path.read_text().splitlines() == ["time [s],Omega [rad/s],u [-]", "0.050000,1.25,-0.5"]
        log.add(0.1, np.array([math.nan, math.nan]), np.array([0.5]))
        assert log.rows == 2
    assert path.read_text().splitlines()[2] == "0.100000,,0.5"


def test_an_error_leaves_the_rows(tmp_path):
    log = Log(tmp_path / "log.csv", WIRING)

    def fly():
        with log:
            log.add(0.0, np.array([0.0, 1.0]), np.array([0.0]))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fly()
    assert len((tmp_path / "log.csv").read_text().splitlines()) == 2
    assert log._file.closed
