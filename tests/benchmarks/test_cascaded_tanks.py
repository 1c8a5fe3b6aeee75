"""The opponents of our model of the tanks, on linear tanks whose solution is known."""

import numpy as np
import pytest
import torch
from benchmarks.cascaded_tanks import (
    LINEAR,
    RIM,
    linear_tanks,
    pysindy_tanks,
    reading_errors,
    rms,
    states_of,
)
from scipy.signal import cont2discrete, dlsim

from dynasindy.systems.transitions import Transitions

DT, UPPER, LOWER, GAIN = 4.0, 0.02, 0.01, 0.03
"""Sampling time [s], rates at which either tank empties [1/s], and what the pump gives [V/s per V]."""


def _log(start=(2.0, 3.0), seed=0):
    """Return a log by SciPy's solution of `l' = GAIN u - UPPER l`, `r' = 0.04 l - LOWER r`, and the reading."""
    a, b = np.array([[-UPPER, 0.0], [0.04, -LOWER]]), np.array([[GAIN], [0.0]])
    system = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), DT)
    held = np.random.default_rng(seed).uniform(0, 1, 12).repeat(10)[:, None]
    path = dlsim(system, np.vstack([held, held[-1:]]), x0=np.array(start))[1]
    y = np.full((len(path), 4), np.nan)
    y[:, 3] = path[:, 1]
    return Transitions.from_trajectory(torch.from_numpy(y), torch.from_numpy(held), DT), path[:, 1]


def _of(model, state, function):
    return float(model.coefficients[model.library.names.index(function), model.signature.state_names.index(state)])


def test_a_linear_model_finds_linear_tanks_whose_upper_level_nobody_measures():
    model = linear_tanks()
    model.fit(states_of(_log()[0], [0, -1]))
    assert _of(model, "level_1", "u") == pytest.approx(GAIN, rel=1e-3)
    assert _of(model, "level_1", "level_1") == pytest.approx(-UPPER, rel=1e-3)
    assert _of(model, "reading", "reading") == pytest.approx(-LOWER, rel=1e-3)
    other, seen = _log((3.0, 1.0), seed=1)
    assert rms(reading_errors(model, other, seen)) < 1e-3


def test_the_error_of_a_reading_is_that_of_the_best_start():
    data, level = _log()
    model = linear_tanks()
    model.fit(states_of(data, [0, -1]))
    # 0.3 V more on every sample behind the first 21, on which the start is found.
    more = np.where(np.arange(len(level)) > 20, 0.3, 0.0)
    n = len(level)
    assert rms(reading_errors(model, data, level + more)) == pytest.approx(0.3 * ((n - 21) / n) ** 0.5, rel=0.01)


def test_pysindy_finds_linear_tanks_by_the_reading_and_its_rate():
    data, level = _log()
    model = pysindy_tanks(data, level, [LINEAR])
    # r'' = 0.04 GAIN u - UPPER LOWER r - (UPPER + LOWER) r'.
    assert _of(model, "rate", "rate") == pytest.approx(-(UPPER + LOWER), rel=0.1)
    assert _of(model, "rate", "u") == pytest.approx(0.04 * GAIN, rel=0.1)
    assert rms(reading_errors(model, data, level)) < 0.1


def test_a_reading_ends_where_the_sensor_does():
    model = linear_tanks()
    model.fit(states_of(_log()[0], [0, -1]))
    data, level = _log((10.0, 5.0))
    assert level.max() > 1.2 * RIM
    assert rms(reading_errors(model, data, level.clip(max=RIM))) < 0.01
