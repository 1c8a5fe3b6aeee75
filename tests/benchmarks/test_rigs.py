"""The benchmark of real logs: its rows on a log made by SciPy, published physics, predictions and their errors."""

import math

import numpy as np
import pytest
import torch
from benchmark import parse
from benchmarks import rigs
from benchmarks.rigs import (
    FACTS,
    Log,
    ahead,
    ahead_rows,
    axis_errors,
    build_model,
    published_physics,
    pysindy_tanks,
    reading_errors,
    replay_rmse,
    rms,
    states_of,
    steady_force,
)
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, dlsim

from dynasindy.safe_io import read_rows
from dynasindy.sindy import SindyModel
from dynasindy.systems import rk4
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


def axis(t, x, force):
    return [x[1], (force(t) - 203.5034 * x[1] - 20.3935 * math.tanh(1000 * x[1]) + 3.1648) / 95.1089]


@pytest.mark.slow
def test_the_command_scores_models_of_an_axis_whose_physics_are_the_published_ones(tmp_path):
    t = 1e-3 * np.arange(3001)
    for name, hertz in (("train", 0.7), ("test", 0.5)):
        force = lambda t, hertz=hertz: 90 * np.sign(np.sin(2 * np.pi * hertz * t + 0.3))  # noqa: E731
        q = solve_ivp(axis, (0, 3), [0.1, 0.0], "LSODA", t, args=(force,), max_step=1e-3, rtol=1e-9, atol=1e-12).y[0]
        rows = np.stack([t, q, force(t)], -1)
        np.savetxt(tmp_path / f"emps_{name}.csv", rows, delimiter=",", header="t [s],q [m],u_force [N]", comments="")
    out = tmp_path / "rigs.csv"
    rigs.main(parse("rigs", ["--data", str(tmp_path), "--rigs", "emps", "--out", str(out)]))
    found = {(row["model"], row["metric"]): float(row["value"]) for row in read_rows(out)}
    assert tuple(read_rows(out)[0]) == rigs.COLUMNS
    assert found["published physics", "test simulated, RMSE"] < 1 < found["last value held", "test simulated, RMSE"]
    assert found["ours", "force at 0.125 m/s"] == pytest.approx(203.5034 * 0.125 + 20.3935 - 3.1648, rel=0.05)
    assert found["ours", "force at -0.125 m/s"] == pytest.approx(-203.5034 * 0.125 - 20.3935 - 3.1648, rel=0.05)
    courses = read_rows(tmp_path / "rigs_over_time.csv")
    assert tuple(courses[0]) == rigs.COURSES and {"ours", "linear", "pysindy"} <= {row["model"] for row in courses}


def test_a_thinned_log_keeps_samples_and_the_means_of_inputs():
    log = Log(np.arange(8.0)[:, None], np.arange(8.0)[:, None] ** 2, 0.1)
    data = log.thinned(3)
    assert data.dt == pytest.approx(0.3)
    assert data.x[:, 0].tolist() == [0, 3] and data.x_next[:, 0].tolist() == [3, 6]
    assert data.u[:, 0].tolist() == [pytest.approx((0 + 1 + 4) / 3), pytest.approx((9 + 16 + 25) / 3)]


def test_errors_ahead_are_told_together_and_of_each_angle():
    found = {row["metric"]: row["value"] for row in ahead_rows("ours", torch.tensor([[0.03, 0.04], [0.3, 0.5]]))}
    assert found["theta 0.2 s ahead, RMSE"] == 30 and found["alpha 0.2 s ahead, RMSE"] == 40
    assert found["both angles 0.2 s ahead, RMSE"] == pytest.approx(25 * 2**0.5, rel=1e-3)
    assert found["both angles 0.5 s ahead, RMSE"] == pytest.approx(1e3 * (0.34 / 2) ** 0.5, rel=1e-3)
    # A log that is replayed counts as far as both go, here missed by 3 mm and 1 mm: the root of 5.
    assert replay_rmse(np.array([0.0, 0.101, 9.0]), np.array([0.003, 0.1])) == pytest.approx(5**0.5)


def test_the_error_of_an_axis_is_simulated_less_measured():
    """An axis without any force that is pushed on by 1 mm: a model of it stays behind."""
    model = SindyModel(Signature(("q", "v"), ("m", "m/s"), ("u",), (0.25, 0.15)), ["v", "u"], known={"q": "v"})
    model.set_coefficients(torch.tensor([[1.0, 0.0], [0.0, 0.0]], dtype=torch.float64))
    q = np.where(np.arange(60) < 30, 0.0, 1e-3)
    errors = axis_errors(model, Log(np.stack([q, np.full(60, np.nan)], -1), np.zeros((60, 1)), 1e-3))
    assert errors.tolist() == pytest.approx([0.0] * 15 + [-1.0] * (len(errors) - 15), abs=1e-9)


@pytest.mark.parametrize(
    ("speed", "newton", "acceleration"),
    [
        # 203.5034 * .1 + 20.3935 - 3.1648 = 37.57904 keeps .1 m/s forth, -43.90864 back: the push helps one way.
        (0.1, 37.57904, 0.0),
        (-0.1, -43.90864, 0.0),
        # One mass in newtons more is 1 m/s^2 more.
        (0.1, 37.57904 + 95.1089, 1.0),
        (0.0, -3.1648, 0.0),
    ],
)
def test_the_force_that_keeps_a_speed(speed, newton, acceleration):
    x = torch.tensor([0.2, speed], dtype=torch.float64)
    dx = published_physics("emps")(x, torch.tensor([newton / 100], dtype=torch.float64))
    assert dx.tolist() == pytest.approx([speed, acceleration], abs=1e-9)


def test_the_force_at_a_speed_is_read_from_any_model():
    assert steady_force(published_physics("emps"), 0.1) == pytest.approx(37.57904)
    assert steady_force(published_physics("emps"), -0.1) == pytest.approx(-43.90864)


def energy(x: torch.Tensor) -> torch.Tensor:
    """Energy of the arm and of 2000 pieces of the pendulum, from where they are and how they move."""
    theta, alpha, dtheta, dalpha = x
    pieces = (torch.arange(2000, dtype=torch.float64) + 0.5) / 2000 * 0.129

    def places(t: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        out = pieces * torch.sin(a)
        return torch.stack(
            (
                0.085 * torch.cos(t) - out * torch.sin(t),
                0.085 * torch.sin(t) + out * torch.cos(t),
                pieces * torch.cos(a),
            )
        )

    velocity = torch.func.jvp(places, (theta, alpha), (dtheta, dalpha))[1]
    rod = 0.024 / 2000 * (0.5 * velocity.square().sum() + 9.81 * places(theta, alpha)[2].sum())
    return rod + 0.5 * 0.095 * 0.085**2 / 3 * dtheta.square()


def test_energy_changes_by_the_power_of_the_motor_alone():
    for x in torch.from_numpy(np.random.default_rng(0).normal(size=(5, 4)) * [1, 1, 5, 5]):
        u = torch.tensor([0.3], dtype=torch.float64)
        dx = published_physics("qube")(x, u)
        gained = torch.func.jvp(energy, (x,), (dx,))[1]
        power = 0.042 * (10 * 0.3 - 0.042 * x[2]) / 8.4 * x[2]
        assert gained.item() == pytest.approx(power.item(), rel=1e-4, abs=1e-6)


def test_the_plant_itself_predicts_what_its_encoders_can_tell():
    plant, generator = published_physics("qube"), torch.Generator().manual_seed(0)
    x, states, inputs = torch.tensor([0.0, math.pi, 0.0, 0.0]).double(), [], []
    for _ in range(400):
        u = 0.1 * torch.randn(1, generator=generator).double()
        states.append(x)
        inputs.append(u)
        for _ in range(5):
            x = rk4(plant, x, u, 0.002)
    y = torch.full((401, 4), torch.nan, dtype=torch.float64)
    step = 2 * math.pi / 2048
    y[:, :2] = ((torch.stack([*states, x]) / step).round() * step)[:, :2]
    log = Transitions.from_trajectory(y, torch.stack(inputs), 0.01)
    errors, held = ahead(plant, log, log)
    moved = y[70:-81:10, :2] - y[50:-101:10, :2]  # from every 0.1 s after the first half second, 20 samples on
    torch.testing.assert_close(held[0], moved.square().mean(0).sqrt())
    assert errors.shape == held.shape == (2, 2)
    assert (errors < 0.2 * held).all() and (errors[0] < 5 * step).all()


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
    model = build_model("tanks", "linear")
    model.fit(states_of(_log()[0], [0, -1]))
    assert _of(model, "level_1", "u") == pytest.approx(GAIN, rel=1e-3)
    assert _of(model, "level_1", "level_1") == pytest.approx(-UPPER, rel=1e-3)
    assert _of(model, "reading", "reading") == pytest.approx(-LOWER, rel=1e-3)
    other, seen = _log((3.0, 1.0), seed=1)
    assert rms(reading_errors(model, other, seen)) < 1e-3


def test_pysindy_finds_linear_tanks_by_the_reading_and_its_rate():
    data, level = _log()
    model = pysindy_tanks(data, level, FACTS["tanks"]["pysindy"][:1])
    # r'' = 0.04 GAIN u - UPPER LOWER r - (UPPER + LOWER) r'.
    assert _of(model, "rate", "rate") == pytest.approx(-(UPPER + LOWER), rel=0.1)
    assert _of(model, "rate", "u") == pytest.approx(0.04 * GAIN, rel=0.1)
    assert rms(reading_errors(model, data, level)) < 0.1
