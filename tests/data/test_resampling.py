"""Uneven samples of a plant whose solution is known, taken to even times, and the equations that come of them."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dynasindy
from dynasindy.identification.identify import LoggedData
from dynasindy.identification.source import Source

DT = 0.02


def swung(held, n=1500):
    """Return times with 20 % jitter, angle and rate of a pendulum, and inputs that change every few samples."""
    rng = np.random.default_rng(0)
    t = DT * (np.arange(n) + 0.2 * rng.uniform(-1, 1, n))
    u = np.repeat(rng.uniform(-0.5, 0.5, n // held + 1), held)[:n]
    x = np.zeros((n, 2))
    for k in range(n - 1):
        push = 12 * u[k]
        x[k + 1] = solve_ivp(
            lambda _, s, push=push: [s[1], push - 9.81 * math.sin(s[0]) - 0.5 * s[1]],
            (t[k], t[k + 1]),
            x[k],
            rtol=1e-7,
            atol=1e-9,
        ).y[:, -1]
    return t, x, u


def resampled(folder, t, u, dt, **states):
    """Return what is read of samples at uneven times, and the even ones."""
    rows = np.stack([t, *states.values(), u], -1)
    np.savetxt(folder / "log.csv", rows, "%.17g", ",", header=",".join(["time", *states, "u"]), comments="")
    found = LoggedData(str(folder / "log.csv"), dt=dt).recording(None)
    assert "log.resampled" in [each.code for each in found.findings] and not found.transitions.segment.any()
    return found, t[0] + dt * np.arange(len(found.transitions))


@pytest.mark.parametrize("held", [1, 5])
def test_a_log_with_a_fifth_of_jitter_tells_the_equations_of_its_plant(tmp_path, held):
    t, x, u = swung(held)
    found, _ = resampled(tmp_path, t, u, DT, a=x[:, 0], w=x[:, 1])
    words = ["a", "w", "u", "sin(a)", "u sin(a)", "w^2", "u cos(a)"]
    model = dynasindy.identify(Source.of(found), words, {"a": "w"}, "one_step", longest_delay=0)
    told = dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True))
    true = {"u": 12.0, "sin(a)": -9.81, "w": -0.5}
    for name, value in told.items():
        assert value == pytest.approx(true.get(name, 0.0), rel=0.01), name


def test_states_between_two_jumps_of_the_input_are_a_smooth_curve_and_bend_at_the_jump(tmp_path):
    """A rate that grows by t cubed, and falls from the jump on: a spline over the jump would swing by a hundredth."""
    rng = np.random.default_rng(1)
    t = 0.1 * (np.arange(60) + 0.2 * rng.uniform(-1, 1, 60))
    jump = t[30]

    def rate(time):
        return np.where(time < jump, time**3 / 8, jump**3 / 8 - 5 * (time - jump))

    found, times = resampled(tmp_path, t, np.where(t < jump, 1.0, -1.0), 0.1, w=rate(t))
    assert found.transitions.x[:, 0].numpy() == pytest.approx(rate(times), abs=1e-9)
    share = (jump - times) / 0.1  # of the step in which the input jumps
    assert found.transitions.u[:, 0].numpy() == pytest.approx(2 * share.clip(0, 1) - 1, abs=1e-9)


def test_under_an_input_that_moves_smoothly_states_are_one_curve(tmp_path):
    """Each sample has another input, and lines between them would be off by a thousandth."""
    t = 0.1 * (np.arange(100) + 0.2 * np.random.default_rng(2).uniform(-1, 1, 100))
    found, times = resampled(tmp_path, t, np.cos(0.5 * t), 0.1, x=np.sin(t))
    assert found.transitions.x[:, 0].numpy() == pytest.approx(np.sin(times), abs=5e-5)
