"""What is said of a recording before any fit."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from plants import scipy_motion
from scipy.signal import lfilter

import dynasindy
from dynasindy.identification.forecast_errors import ForecastErrors
from dynasindy.identification.recording_diagnostics import (
    FEW,
    low_signal_findings,
    low_signal_states,
    repetition,
    resolution,
    resolutions,
    sensor_resolution,
)
from dynasindy.systems import Pendulum, Signature, rk4
from dynasindy.systems.transitions import Transitions

T = 0.01 * np.arange(3000)


def first_order(u, error=0.0):
    """A recording of y' = 4 (u - y) from rest, exact between samples, but for noise of its sensor."""
    y = np.concatenate([[0.0], lfilter([1 - math.exp(-0.04)], [1.0, -math.exp(-0.04)], u)])
    y = y + error * np.random.default_rng(1).normal(size=len(y))
    return Transitions.from_trajectory(torch.from_numpy(y[:, None]), torch.from_numpy(u[:, None]), 0.01)


@pytest.mark.parametrize("error", [0.0, 0.03])
@pytest.mark.parametrize(("times", "seconds"), [(5, 6.0), (1, None)])
def test_a_log_repeats_itself_where_its_inputs_do_whatever_its_sensor_adds(times, seconds, error):
    levels = np.random.default_rng(0).uniform(-1, 1, 300 // times)
    u = np.tile(np.repeat(levels, 10), times)
    assert repetition(first_order(u, error)) == (seconds and pytest.approx(seconds))


@pytest.mark.parametrize("rest", [400, 900])
def test_a_log_that_rests_between_movements_does_not_repeat_itself(rest):
    moved = np.repeat(np.random.default_rng(0).uniform(-1, 1, 60), 10)
    assert repetition(first_order(np.pad(moved, rest))) is None


@pytest.mark.parametrize("step", [0.0015, 0.02])
def test_the_step_of_an_encoder_is_found_and_exact_or_noisy_samples_have_none(step):
    swing = np.sin(1.3 * T) + 0.4 * np.sin(0.37 * T)
    assert sensor_resolution(step * np.round(swing / step)) == pytest.approx(step, rel=1e-6)
    assert sensor_resolution(swing) == 0.0
    noisy = swing + 0.01 * np.random.default_rng(0).normal(size=3000)
    assert sensor_resolution(noisy) == 0.0 and resolution(noisy) == pytest.approx(0.01, rel=0.1)
    assert sensor_resolution(np.round(noisy, 6)) == 0.0  # six decimals of a file are no sensor's step


@pytest.mark.parametrize("interval", [0.1, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_what_a_plant_does_between_samples_that_are_far_apart_is_no_noise_of_its_sensor(interval, noise):
    """x' = u + 0.4 u^2 - x under held inputs: x[k+1] = a x[k] + (1 - a) (u + 0.4 u^2), a = exp(-interval)."""
    generator, left = np.random.default_rng(0), np.exp(-interval)
    u, x = generator.uniform(-1, 1, 800), [0.0]
    for held in u:
        x.append(left * x[-1] + (1 - left) * (held + 0.4 * held**2))
    read = np.array(x) + noise * generator.normal(size=801)
    data = Transitions.from_trajectory(torch.tensor(read)[:, None], torch.tensor(u)[:, None], interval)
    told = float(resolutions(data)[0])
    assert resolution(read) > 0.02 * np.std(x)  # a cubic alone cannot follow what jumps with each input
    # What is left over has the noise of this sample and, through `a`, that of the last one.
    assert noise * 0.9 < told < noise * 1.1 * np.sqrt(1 + left**2) + 1e-9


def test_noise_of_samples_that_are_close_is_what_no_cubic_follows_and_a_step_stays_a_step():
    swing = np.sin(1.3 * T) + 0.4 * np.sin(0.37 * T)
    noisy = swing + 0.01 * np.random.default_rng(0).normal(size=3000)
    read = torch.tensor(np.stack([noisy, 0.02 * np.round(swing / 0.02), np.full(3000, np.nan)], -1))
    told = resolutions(Transitions.from_trajectory(read, torch.zeros(2999, 1).double(), 0.01)).tolist()
    assert told[0] == pytest.approx(resolution(noisy), rel=1e-6) and told[1] == pytest.approx(0.02, rel=1e-6)
    assert np.isnan(told[2])


def test_the_noise_of_what_jumps_is_told_by_past_samples():
    """x+ = -0.6 x + u, seen with noise of 0.02: a cubic takes the jumps themselves for noise."""
    rng, n = np.random.default_rng(3), 3000
    u, x = rng.standard_normal(n), np.zeros(n + 1)
    for k in range(n):
        x[k + 1] = -0.6 * x[k] + u[k]
    seen = torch.from_numpy(x + 0.02 * rng.standard_normal(n + 1)).unsqueeze(-1)
    data = Transitions.from_trajectory(seen, torch.from_numpy(u).unsqueeze(-1), 0.1)
    assert resolution(seen[:, 0].numpy()) > 0.3
    assert resolutions(data).tolist() == pytest.approx([0.02], rel=0.1)


STEP = 2 * math.pi / 4096
SIGNATURE = Signature(("angle", "way"), ("rad", "m"), ("u",), (1.0, 1.0))


@cache
def pendulum(amplitude, seconds=20.0, dt=0.02):
    """Return a log of a pendulum under a sine of the input, its angle read by an encoder of 4096 steps a turn.

    At rest a torque u turns it by theta = 12 u / 9.81, and the slow sine stays near rests.
    """
    plant, x = Pendulum(), torch.zeros(2, dtype=torch.float64)
    u = amplitude * torch.sin(0.5 * math.pi * dt * torch.arange(round(seconds / dt), dtype=torch.float64)).unsqueeze(-1)
    angles = [0.0]
    for held in u:
        for _ in range(4):
            x = rk4(plant, x, held, dt / 4)
        angles.append(round(float(x[0]) / STEP) * STEP)
    way = torch.linspace(0.0, 3.0, len(angles)).double().sin()  # moves by itself, finely resolved
    return Transitions.from_trajectory(torch.stack([torch.tensor(angles).double(), way], -1), u, dt)


def test_a_state_that_moves_by_a_few_steps_is_quiet():
    moved = low_signal_states(pendulum(0.001))
    assert list(moved) == [0]
    # A sine of 0.25 Hz is a third more than at rest, as the pendulum has 0.5 Hz: twice 12 u / 9.81 / (1 - 1 / 4).
    assert moved[0] == pytest.approx(2 * 12 * 0.001 / 9.81 / 0.75 / STEP, abs=1.5)
    assert moved[0] < FEW


def test_a_loud_log_is_not_quiet_nor_is_what_does_not_move():
    assert not low_signal_states(pendulum(0.2))
    assert not low_signal_states(pendulum(0.0))
    assert not low_signal_states(pendulum(0.001), {0})
    assert low_signal_findings(pendulum(0.2), SIGNATURE) == []


def in_stretches(x, length):
    """Return a log of samples `(T, n_x)` of which each `length + 1`-th row is missing, under an input of zero."""
    n = len(x) - 1
    rows = Transitions.from_trajectory(x, torch.zeros(n, 1).double(), 0.02)
    return rows.select(torch.arange(n) % (length + 1) < length)


def test_a_log_in_short_stretches_is_judged_by_all_of_them():
    t = 0.02 * torch.arange(361).double()
    swing = torch.stack([t.sin(), (1.7 * t).cos()], -1)
    assert len(in_stretches(swing, 8)) == 320 and not low_signal_states(in_stretches(swing, 8))
    # By two steps to either side, so by four.
    moved = low_signal_states(in_stretches(STEP * (2.4 * swing).round(), 8))
    assert moved == pytest.approx({0: 4.0, 1: 4.0})


def test_it_is_told_which_input_to_move_and_how_much_further():
    log = pendulum(0.001)
    count = low_signal_states(log)[0]
    times = 100 / count
    (told,) = low_signal_findings(log, SIGNATURE)
    assert (told.code, told.severity) == ("log.low_signal", "weak") and told.values["steps"] == {"angle": round(count)}
    assert told.values["inputs"] == {"u": pytest.approx(times)}
    # Where it moves that much further the log is loud, as the pendulum is nearly linear.
    assert not low_signal_states(pendulum(0.001 * times))


def test_no_input_is_to_go_beyond_its_actuator():
    motor = Signature(("angle", "way"), ("rad", "m"), ("u",), (1.0, 1.0), ((-12.0, 12.0),), ((-0.002, 0.002),), ("V",))
    assert low_signal_findings(pendulum(0.001), motor)[0].values["inputs"] == {"u": pytest.approx(2, rel=1e-3)}
    log = pendulum(0.001)
    still = replace(log, u=torch.zeros_like(log.u))
    (told,) = low_signal_findings(still, SIGNATURE)
    assert told.values["inputs"] == {"u": None}


def test_errors_of_what_is_quiet_are_not_judged():
    one = torch.ones(3, 2)
    forecasts = ForecastErrors((0.1, 0.2, 0.4), 0.2, 9, one, one, one, torch.ones(2), 1)
    assert forecasts.without([0, 1]) is None
    left = forecasts.without([0])
    assert left.held[:, 0].isnan().all() and left.model[:, 0].isnan().all()
    assert torch.equal(left.held[:, 1], torch.ones(3)) and torch.equal(forecasts.held, torch.ones(3, 2))


DT, ROWS = 0.02, 1500


@pytest.fixture(scope="module")
def swing():
    """Time, input, a gust as random as it, and angle and rate of a pendulum that both push."""
    random = np.random.default_rng(3)
    u, gust = (np.repeat(random.uniform(-1, 1, ROWS // 10), 10) for _ in range(2))
    gust = np.convolve(gust, np.ones(8) / 8, "same")
    rates = lambda _, x, push: (x[1], -0.9 * x[1] - 12 * np.sin(x[0]) + push)  # noqa: E731
    return DT * np.arange(ROWS), u, gust, *scipy_motion(rates, [0, 0], (7 * u + 9 * gust)[:-1], DT, 1e-8, 1e-6).T


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
    voltage = 12 + 3 * np.sin(0.18 * 0.05 * np.arange(2000))

    def rates(_, x, k):
        along, across = speed[k] * np.cos(x[2]), speed[k] * np.sin(x[2])
        return along, across, 2 * turn[k], voltage[k] / 12 * turn[k] - x[3]

    x = scipy_motion(rates, np.zeros(4), range(1999), 0.05, 1e-6, 1e-6)
    x, voltage = (value + random.normal(0, 3e-3, value.shape) for value in (x, voltage))
    names = ("east", "north", "heading")
    log = {"time": 0.05 * np.arange(2000), **dict(zip(names, x.T[:3], strict=True)), "u_speed": speed, "u_turn": turn}
    assert states_of(tmp_path, **log) == (names, [])
    log = {"time": log["time"], "w": x[:, 3], "voltage": voltage, "u": turn}
    assert states_of(tmp_path, **log) == (("w", "voltage"), [])
