"""A log whose states move by a few steps of their sensors tells nothing of how they move."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from dynasindy.identification.forecast_errors import ForecastErrors
from dynasindy.identification.recording_diagnostics import (
    FEW,
    low_signal_findings,
    low_signal_states,
)
from dynasindy.systems import Pendulum, Signature, rk4
from dynasindy.systems.transitions import Transitions

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
