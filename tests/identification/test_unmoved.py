"""Columns that are no states of a plant, in logs that SciPy simulates, are left out; what acts on it is not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dynasindy

DT, ROWS = 0.02, 1500


@pytest.fixture(scope="module")
def swing():
    """Time, input, a gust as random as it, and angle and rate of a pendulum that both push."""
    random = np.random.default_rng(3)
    u, gust = (np.repeat(random.uniform(-1, 1, ROWS // 10), 10) for _ in range(2))
    gust = np.convolve(gust, np.ones(8) / 8, "same")
    x = [np.zeros(2)]
    for k in range(ROWS - 1):
        forced = 7 * u[k] + 9 * gust[k]
        field = lambda t, x, forced=forced: (x[1], -0.9 * x[1] - 12 * np.sin(x[0]) + forced)  # noqa: E731
        x.append(solve_ivp(field, (0, DT), x[-1], rtol=1e-8).y[:, -1])
    return DT * np.arange(ROWS), u, gust, *np.array(x).T


def states_of(tmp_path, **columns):
    names = ",".join(columns)
    np.savetxt(tmp_path / "log.csv", np.stack([*columns.values()], 1), "%.6f", ",", header=names, comments="")
    source = dynasindy.read(tmp_path / "log.csv")
    return source.signature.state_names, [f for f in source.findings if f.values.get("why") == "unmoved"]


def test_what_the_computer_logs_of_itself_is_left_out_and_said(tmp_path, swing):
    t, u, _, angle, rate = swing
    warm = np.round(45 + 2 * np.sin(0.05 * t) + np.random.default_rng(5).normal(0, 0.1, ROWS), 1)
    free = 200_000 - np.floor(np.arange(ROWS) / 7) * 16
    states, (said,) = states_of(tmp_path, time=t, angle=angle, rate=rate, warm=warm, free=free, u=u)
    assert states == ("angle", "rate") and said.values["columns"] == ["warm", "free"] and said.severity == "weak"
    named = dynasindy.read(tmp_path / "log.csv", states=["angle", "rate", "warm"])
    assert named.signature.state_names == ("angle", "rate", "warm")


def test_a_disturbance_that_nothing_moves_stays_as_it_tells_of_others(tmp_path, swing):
    t, u, gust, angle, rate = swing
    assert states_of(tmp_path, time=t, angle=angle, rate=rate, gust=gust, u=u) == (("angle", "rate", "gust"), [])


def test_a_place_stays_that_its_speed_alone_tells_of(tmp_path, swing):
    """Nothing hangs on how far something went."""
    t, u, _, _, rate = swing
    place = DT * np.cumsum(rate) + np.random.default_rng(7).normal(0, 1e-3, ROWS)
    assert states_of(tmp_path, time=t, place=place, rate=rate, u=u) == (("place", "rate"), [])


def test_what_a_product_moves_or_tells_of_stays(tmp_path):
    """A place goes by speed times a sine of the heading, a speed by the voltage of a battery times the input."""
    random = np.random.default_rng(0)
    speed, turn = np.repeat(random.uniform(0, 1, 67), 30)[:2000], np.repeat(random.uniform(-1, 1, 100), 20)
    voltage, x = 12 + 3 * np.sin(0.18 * 0.05 * np.arange(2000)), [np.zeros(4)]
    for k in range(1999):
        field = lambda t, x, k=k: (  # noqa: E731
            *(speed[k] * np.cos(x[2]), speed[k] * np.sin(x[2]), 2 * turn[k]),
            voltage[k] / 12 * turn[k] - x[3],
        )
        x.append(solve_ivp(field, (0, 0.05), x[-1], rtol=1e-6).y[:, -1])
    x, voltage = (value + random.normal(0, 3e-3, value.shape) for value in (np.array(x), voltage))
    names = ("east", "north", "heading")
    log = {"time": 0.05 * np.arange(2000), **dict(zip(names, x.T[:3], strict=True)), "u_speed": speed, "u_turn": turn}
    assert states_of(tmp_path, **log) == (names, [])
    log = {"time": log["time"], "w": x[:, 3], "voltage": voltage, "u": turn}
    assert states_of(tmp_path, **log) == (("w", "voltage"), [])
