"""The benchmark of real logs: simple models on plants made by SciPy, whose constants they are to find, and scores."""

import math

import numpy as np
import pytest
import torch
from benchmark import parse
from benchmarks import rigs
from benchmarks.opponents import Arx, HeatedBodies, Held, InverseDynamics, Log, StateSpace, choose
from benchmarks.pysindy_regression import pysindy_of
from benchmarks.rigs import Case, errors_ahead, errors_simulated, read_log, rms
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, dlsim, lfilter

from dynasindy.identification import log_fit
from dynasindy.safe_io import read_rows
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

A = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.7]])
B = np.array([[0.0, 0.1], [0.2, 0.0], [1.0, 0.5]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
EIGENVALUES = [0.7, 0.9 - 0.2j, 0.9 + 0.2j]


def linear_log(n=600, seed=0, noise=0.0):
    """A plant of three states, of which two sums are measured, around a level that is not zero."""
    random = np.random.default_rng(seed)
    u = random.normal(size=(n, 2))
    y = dlsim((A, B, C, np.zeros((2, 2)), 0.1), u)[1] + [3.0, -1.0]
    return Log(y + noise * random.normal(size=y.shape), u, 0.1)


def axis(t, x, force):
    return [x[1], (force(t) - 203.5034 * x[1] - 20.3935 * math.tanh(1000 * x[1]) + 3.1648) / 95.1089]


@pytest.mark.parametrize(("noise", "close"), [(0.0, 1e-6), (0.02, 0.02)])
def test_the_subspace_method_finds_the_eigenvalues_of_a_plant(noise, close):
    model = StateSpace.fit([linear_log(noise=noise), linear_log(seed=1, noise=noise)], 3)
    assert np.sort_complex(np.linalg.eigvals(model.a)) == pytest.approx(EIGENVALUES, abs=close)


def test_arx_finds_the_weights_of_a_difference_equation():
    u = np.random.default_rng(0).normal(size=(400, 1))
    # y[t] = 1.5 y[t-1] - 0.7 y[t-2] + 0.5 u[t-2] + 0.25 u[t-3], and a level of 2.
    y = 2 + lfilter([0, 0, 0.5, 0.25], [1, -1.5, 0.7], u, axis=0)
    log = Log(y, u, 0.1)
    model = Arx.fit([log], 2, delay=1)
    assert model.own[:, 0] == pytest.approx([1.5, -0.7]) and list(model.lags) == [2, 3]
    assert model.driven[:, 0, 0] == pytest.approx([0.5, 0.25]) and model.constant == pytest.approx([0.2 * 2])
    assert Arx.fit([log], 2, delay=0, direct=True).driven[:, 0, 0] == pytest.approx([0, 0, 0.5], abs=0.3)
    assert np.abs(errors_ahead(model, log, 0, 50)).max() < 1e-9
    direct = Log(2 + lfilter([0.3, 0.5], [1, -0.5], u, axis=0), u, 0.1)
    assert Arx.fit([direct], 1, direct=True).driven[:, 0, 0] == pytest.approx([0.3, 0.5])
    with pytest.raises(ValueError, match="few"):
        Arx.fit([log.part(0, 0.1)], 20)


def test_arx_with_a_cubic_finds_a_spring_that_stiffens():
    u, y = np.random.default_rng(0).normal(size=(500, 1)), np.zeros((500, 1))
    for t in range(2, 500):
        y[t] = 1.2 * y[t - 1] - 0.6 * y[t - 2] + 0.3 * u[t - 1] - 0.1 * y[t - 1] ** 3
    model = Arx.fit([Log(y, u, 0.1)], 2, cubes=1)
    assert model.own[:, 0] == pytest.approx([1.2, -0.6]) and model.cubes[:, 0] == pytest.approx([-0.1])
    assert np.abs(errors_simulated(model, Log(y, u, 0.1), 0)).max() < 1e-9


def test_heated_bodies_are_found():
    t, dt = np.arange(300), 3.0
    u = np.where((t // 40) % 2 == 0, 80.0, 20.0)[:, None]
    gain, loss, air, speed = 0.006, 0.008, 21.0, 0.06
    a, b, c = np.array([[-loss, gain], [0, -speed]]), np.array([[0], [speed]]), np.array([[1, 0]])
    plant = cont2discrete((a, b, c, np.zeros((1, 1))), dt)[:4]
    log = Log(air + dlsim((*plant, dt), u)[1], u, dt)
    model = HeatedBodies.fit([log])
    assert model.numbers[:, 0] == pytest.approx([gain, loss, air, speed], rel=0.03)
    assert rms(errors_simulated(model, log, 0)) < 0.05


def test_orders_are_chosen_without_the_last_quarter_and_fitted_with_it():
    lengths = []

    def _fit(logs, order):
        lengths.append((order, [len(log) for log in logs]))
        if order == 3:
            raise ValueError("few")
        return Held(order)

    found = choose([lambda logs, k=k: _fit(logs, k) for k in (1, 2, 3)], [linear_log(100)], lambda m: -m.coefficients)
    assert found.coefficients == 2 and lengths == [(1, [75]), (2, [75]), (3, [75]), (2, [100])]


def test_errors_are_those_of_samples_that_are_scored():
    ramp = Log(np.arange(200.0)[:, None], np.zeros((200, 1)), 1.0)
    errors = errors_ahead(Held(), ramp, 150, 10)
    assert errors.shape == (40, 10, 1) and (errors[..., 0] == range(-1, -11, -1)).all()
    late = errors_ahead(Held(), ramp, 150, 30)
    assert late.shape == (50, 30, 1) and np.isnan(late[0, :-1]).all() and (late[:, -1] == -30).all()
    assert not len(errors_ahead(Held(), ramp, 150, 180))
    assert errors_simulated(Held(), ramp, 0)[:2, 0].tolist() == [-1, -2]
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(12.5**0.5) and rms(np.array([1.0, np.inf])) == math.inf


def test_a_log_is_read_at_even_times(tmp_path):
    path = tmp_path / "log.csv"
    times = [0, 10, 21, 30, 40, 60]
    path.write_text("tempo_ms,angulo_deg,u_pct\n" + "".join(f"{t},{2 * t},{t}\n" for t in times))
    log, units = read_log(path, {"time": "tempo_ms", "states": ["angulo"], "inputs": ["u"]})
    assert units == {"angulo": "deg"} and log.dt == pytest.approx(0.01)
    assert log.y[:, 0].tolist() == pytest.approx([0, 20, 40, 60, 80, 100, 120])
    assert log.u[:, 0].tolist() == [0, 10, 21, 30, 40, 40, 60]
    path.write_text("time [s],y [V],u [V]\n" + "".join(f"{0.1 * k:.1f},{k},{-k}\n" for k in range(5)))
    log, units = read_log(path, {})
    assert units == {"y": "V"} and (log.y[:, 0] == -log.u[:, 0]).all() and log.dt == pytest.approx(0.1)


@pytest.mark.slow
def test_the_command_scores_models_of_an_axis(tmp_path, monkeypatch):
    monkeypatch.setattr(log_fit, "FOLDS", 1)  # of candidates, of which there are many
    t = 1e-3 * np.arange(5001)
    for name, hertz in (("train", 0.7), ("test", 0.5)):
        force = lambda t, hertz=hertz: 90 * np.sign(np.sin(2 * np.pi * hertz * t + 0.3))  # noqa: E731
        q = solve_ivp(axis, (0, 5), [0.1, 0.0], "LSODA", t, args=(force,), max_step=1e-3, rtol=1e-9, atol=1e-12).y[0]
        rows = np.stack([t, q, force(t)], -1)
        np.savetxt(tmp_path / f"emps_{name}.csv", rows, delimiter=",", header="t [s],q [m],u_force [N]", comments="")
    case = Case.of("emps", tmp_path, tmp_path)
    constants = InverseDynamics.fit(case.training, 40.0).constants
    assert constants == pytest.approx([95.1089, 203.5034, 20.3935, -3.1648], rel=0.05)
    out, models = tmp_path / "rigs.csv", ["ours with structure", "inverse dynamics", "ARX", "last value held"]
    words = ["--data", str(tmp_path), "--rigs", "emps", "--models", *models, "--out", str(out)]
    rigs.main(parse("rigs", words))
    found = {(row["model"], row["metric"]): float(row["value"]) for row in read_rows(out)}
    assert tuple(read_rows(out)[0]) == rigs.COLUMNS and {model for model, _ in found} == set(models)
    for metric in ("test simulated, RMSE", "position 2 s ahead, RMSE", "position over 2 s, RMSE"):
        held = found["last value held", metric]
        assert found["inverse dynamics", metric] < 0.1 * held and found["ours with structure", metric] < 0.1 * held


DT, UPPER, LOWER, GAIN = 4.0, 0.02, 0.01, 0.03
"""Sampling time [s], rates at which either tank empties [1/s], and what the pump gives [V/s per V]."""


def test_pysindy_finds_linear_tanks_by_the_reading_and_its_rate():
    a, b = np.array([[-UPPER, 0.0], [0.04, -LOWER]]), np.array([[GAIN], [0.0]])
    system = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), DT)
    held = np.random.default_rng(0).uniform(0, 1, 12).repeat(10)[:, None]
    path = dlsim(system, np.vstack([held, held[-1:]]), x0=np.array([2.0, 3.0]))[1]
    y = torch.full((len(path), 2), math.nan, dtype=torch.float64)
    y[:, 0] = torch.from_numpy(path[:, 1])
    data = Transitions.from_trajectory(y, torch.from_numpy(held), DT)
    signature = Signature(("reading", "rate"), ("V", "V/s"), ("u",), (10.0, 0.1))
    words = ["1", "u", "reading", "rate"]
    model = pysindy_of(SindyModel(signature, words, known={"reading": "rate"}), data, 1e-3)
    # r'' = 0.04 GAIN u - UPPER LOWER r - (UPPER + LOWER) r'.
    found = dict(zip(words, model.coefficients[:, 1].tolist(), strict=True))
    assert found["rate"] == pytest.approx(-(UPPER + LOWER), rel=0.1)
    assert found["u"] == pytest.approx(0.04 * GAIN, rel=0.1)
    with pytest.raises(ValueError, match="equation"):
        pysindy_of(SindyModel(signature, words, known={"reading": "rate"}), data, 10.0)
