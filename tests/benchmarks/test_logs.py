"""A benchmark of logs writes what a rig would, says what the user of a plant says, and scores flights by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from benchmarks.logs import CASES, TARGETS, Case, simulate_targets, write_log

import dynasindy
from dynasindy import Controller
from dynasindy.agents.networks import actor
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Channel, RandomStep, Tracking, TrackingReward
from dynasindy.systems import Signature


class Given:
    """A controller whose input is what a function of measurement and target says."""

    def __init__(self, rule, names, units="rad/s"):
        signature = Signature(names, (units,) * len(names), ("u",), (100.0,) * len(names))
        task = Tracking(signature, RandomStep([0.0], [1.0]), [names[0]], [], TrackingReward((1.0,)))
        self.inner = Controller(actor(task.n_o, 1, (4,)), ControlSetup(task, 0.05))
        self.signature, self.dt, self.rule = self.inner.signature, 0.05, rule

    def reset(self):
        pass

    def act(self, y, r):
        return np.array([self.rule(y, r)])


def test_of_functions_that_a_fit_drops_no_regression_is_left_for_the_equations_of_a_noisy_fan(tmp_path):
    """Of single steps one was, and predicted as well within the noise: it had the fan driven by its own friction."""
    write_log(CASES["fan"], tmp_path / "log.csv", 0)
    model = dynasindy.identify(dynasindy.read(tmp_path / "log.csv"))
    w, u = torch.tensor([[40.0], [90.0], [140.0]]).double(), torch.tensor([[0.3], [0.0], [-0.3]]).double()
    torch.testing.assert_close(model(w, u), CASES["fan"].plant(w, u), atol=2.0, rtol=0.0)  # of -270 to 220 rad/s^2


def test_a_log_holds_what_sensors_tell_and_inputs_within_their_actuators():
    y, _ = replace(CASES["oven"], seconds=500.0).record(0)
    np.testing.assert_allclose(10 * y[:, 0], (10 * y[:, 0]).round(), atol=1e-6)
    assert y[:, 1].isnan().all()
    case = CASES["column"]
    y, u = replace(case, seconds=6000.0).record(0)
    low, high = case.ends
    assert bool(((u >= low) & (u <= high)).all()) and u.shape == (100, 2)
    assert not torch.equal(u[:, 0] - 2.45, u[:, 1] - 1.71) and not bool(y[:, :2].isnan().any())


def test_what_a_controller_reads_in_flight_is_in_its_own_radians():
    """A table turns by 30 deg/s for each 1 of the input; from 60 deg on an input of 0.5 takes it 0.75 deg a period."""
    table = Case(
        "a table", {"tilt": "deg"}, {"tilt": "30 * u"}, {"tilt": Channel()}, {"tilt": (60, 90)}, 0.05, 1, 0.1, (1, 1)
    )
    table, read = replace(table, flight=0.2, start={"tilt": 60.0}), []

    def rule(y, r):
        read.append(y["tilt"])
        return 0.5

    simulate_targets(table, Given(rule, ("tilt",), "rad"), 0)
    turned = np.array([60.0, 60.75, 61.5, 62.25]) * math.pi / 180
    np.testing.assert_allclose(np.array(read).reshape(4, TARGETS), np.tile(turned[:, None], TARGETS), rtol=1e-12)
    read.clear()
    simulate_targets(table, Given(rule, ("tilt",), "deg"), 0)
    np.testing.assert_allclose(read[::TARGETS], [60.0, 60.75, 61.5, 62.25], rtol=1e-12)


def test_a_flight_that_runs_away_is_infinitely_wrong(monkeypatch):
    monkeypatch.setattr("benchmarks.logs.FAR", 100.0)
    assert np.isinf(simulate_targets(CASES["fan"], Given(lambda y, r: 1.0, ("w",)), 0)).all()


def moved(name, x, *u):
    given = (torch.tensor(values, dtype=torch.float64) for values in (x, u))
    return CASES[name].plant(*given).tolist()


def test_the_plants_rest_where_their_equations_are_solved_by_hand():
    rest = pytest.approx([0.0] * 4, abs=1e-9)
    assert [*moved("arm", [math.asin(25 * 0.3 / 19.6), 0.0], 0.3), *[0.0] * 2] == rest
    assert [*moved("propeller", [math.asin(8 * 0.25 / 9), 0.0, 0.5], 0.5), 0.0] == rest
    level = (0.55 * 1.2 / 0.16) ** 2
    assert [*moved("tanks", [level, level], 0.2), *[0.0] * 2] == rest
    # 0.12 (1 + u) flows from the air into the wall, and a 900th of the wall's excess out of it, in units of the air.
    wall = 20 + 900 * 0.12 * 200 / 600
    assert [*moved("oven", [wall + 24.0, wall], 0.0), *[0.0] * 2] == rest
    assert [*moved("ship", [0.3, 0.0, 0.0], 0.0), 0.0] == rest
    assert [*moved("beam", [0.1, 0.0, 0.0], 0.0), 0.0] == rest
    assert [*moved("fan", [100.0], (200 + 80 + 10) / 250 - 1), *[0.0] * 3] == rest


def test_two_links_keep_their_energy_without_friction_and_torque():
    """Power of gravity and friction is the change of kinetic energy: friction is subtracted by hand."""
    x = torch.tensor([0.4, -0.7, 1.1, -2.0], dtype=torch.float64, requires_grad=True)
    m1, m2, l1, c1, c2, g = 2.0, 1.2, 0.4, 0.2, 0.18, 9.81

    def energy(x):
        a, b, v, w = x
        d11 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * b.cos()) + 0.03 + 0.016 + 0.05
        d12, d22 = m2 * (c2**2 + l1 * c2 * b.cos()) + 0.016, m2 * c2**2 + 0.016 + 0.02
        potential = -(m1 * c1 + m2 * l1) * g * a.cos() - m2 * g * c2 * (a + b).cos()
        return 0.5 * (d11 * v**2 + 2 * d12 * v * w + d22 * w**2) + potential

    (slope,) = torch.autograd.grad(energy(x), x)
    v, w = 1.1, -2.0
    lost = v * (0.8 * v + 0.3 * math.tanh(40 * v)) + w * (0.3 * w + 0.1 * math.tanh(40 * w))
    gained = v * 2.0 - w * 1.0
    dx = torch.tensor(moved("manipulator", [0.4, -0.7, v, w], 2.0, -1.0), dtype=torch.float64)
    assert float(slope.double() @ dx) == pytest.approx(gained - lost)


def test_water_that_is_as_warm_as_the_shell_stays_so():
    """In the steady state the pipe is as warm as the last cell; cell by cell (a - b) / 2.5 + 0.06 (S - b) = 0."""
    shell, water, cells = 20 + 1.1 * 50, 15.0, []
    for _ in range(4):
        water = (water / 2.5 + 0.06 * shell) / (1 / 2.5 + 0.06)
        cells.append(water)
    assert moved("exchanger", [water, shell, *cells, *[water] * 3], 50.0) == pytest.approx([0.0] * 9, abs=1e-12)


def test_a_magnet_pulls_the_more_the_nearer_and_by_the_square_of_the_current():
    assert moved("bearing", [0.0, 0.0], 0.0) == [0.0, 0.0]
    near = 1e-4
    # Linearised, 4 K / s^3 z + 4 K / (s^2 i0) i in units of the gap s = 1 mm and i0 = 2 A, K = 900 mm/s^2.
    assert moved("bearing", [near, 0.0], 0.0)[1] / near == pytest.approx(3600, rel=1e-4)
    assert moved("bearing", [0.0, 0.0], near)[1] / near == pytest.approx(1800, rel=1e-4)


def test_a_piston_moves_as_fast_as_its_valve_lets_oil_through():
    assert moved("cylinder", [0.0, 250.0, 0.0], 5.0)[2] == pytest.approx(0.0)
    half = moved("cylinder", [0.0, 0.0, 75.0], 10.0)[2] + 2 * 75
    assert half == pytest.approx(16 * 500 * 0.5)  # a quarter of the pressure is left, and half of the flow


def test_water_with_neither_acid_nor_base_is_neutral():
    """The slope of pH by charge is that of charge + h - 10^-14 / h = 0 at its zero, pH 7, without carbonate."""
    _, charge, _ = moved("neutral", [7.0, 0.0, 0.0], 15.0)
    by_ph = 2 * math.log(10) * 1e-7
    assert moved("neutral", [7.0, 0.0, 0.0], 15.0)[1] == charge
    carbon = moved("neutral", [7.0, 0.0, 0.0], 15.0)[2]
    share = (1 + 2 * 10 ** (7 - 10.25)) / (1 + 10 ** (6.35 - 7) + 10 ** (7 - 10.25))
    assert moved("neutral", [7.0, 0.0, 0.0], 15.0)[0] == pytest.approx(-(charge + share * carbon) / by_ph)


def test_a_pole_on_a_cart_balances_upright_alone_and_falls_by_its_own_weight():
    assert moved("balanced", [0.3, 0.0, 0.0, 0.0], 0.0) == pytest.approx([0.0] * 4)
    small = 1e-4
    total, turned, coupled = 0.8, 0.006 + 0.2 * 0.3**2, 0.2 * 0.3
    falls = total * 0.2 * 0.3 * 9.81 / (total * turned - coupled**2)
    assert moved("balanced", [0.0, small, 0.0, 0.0], 0.0)[3] / small == pytest.approx(falls, rel=1e-4)


def test_a_column_comes_to_the_gains_of_wood_and_berry():
    reflux, steam = 0.1, -0.05
    d, b = 12.8 * reflux - 18.9 * steam, 6.6 * reflux - 19.4 * steam
    x = [d, b, 12.8 * reflux, -18.9 * steam, 6.6 * reflux, -19.4 * steam, *[reflux] * 4, *[steam] * 3]
    assert moved("column", x, 2.45 + reflux, 1.71 + steam) == pytest.approx([0.0] * 13, abs=1e-12)
