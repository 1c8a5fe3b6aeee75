"""Plants out of textbooks rest, balance and respond as their sources say."""

import math

import pytest
import torch
from benchmarks.logged import CASES as FAMILIAR
from benchmarks.logs import words
from benchmarks.unseen_plants import CASES, WIND


def moved(name, x, *u):
    given = (torch.tensor(values, dtype=torch.float64) for values in (x, u))
    return CASES[name].plant(*given).tolist()


def test_no_name_is_used_twice_and_every_case_fits_its_states():
    assert not set(CASES) & set(FAMILIAR) and len(CASES) == 10
    for case in CASES.values():
        assert set(case.sensors) | set(case.targets) | set(case.known) | set(case.start) <= set(case.states)
        assert set(case.columns).union(*case.loop) <= set(case.sensors) and len(case.loop) <= len(case.inputs)
        assert case.plant(case.begins, sum(case.ends) / 2).shape == case.begins.shape


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


def test_a_turbine_takes_less_than_the_limit_of_betz_and_slows_with_pitch():
    speeds = [moved("turbine", [12.0, pitch], pitch)[0] for pitch in (20.0, 25.0)]
    assert speeds[0] > 0 > speeds[1]
    w = 12 * 2 * math.pi / 60
    power = (speeds[0] * 2 * math.pi / 60 * 4.4e7 + 4.1e6) * w
    assert power < 16 / 27 * 0.5 * 1.225 * math.pi * 63**2 * WIND**3


def test_a_twisted_shaft_pulls_both_ends_together():
    rates = moved("drivetrain", [0.2, 0.0, 0.0, 0.0], 0.0)
    assert rates == pytest.approx([0, 0, -16.0, 20.0])
    assert moved("drivetrain", [1.0, 1.0, 0.0, 0.0], 0.0) == pytest.approx([0.0] * 4)


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


def test_a_car_rests_where_the_spring_bears_the_force():
    assert moved("suspension", [100 / 16.2, 0.0, 0.0, 0.0], 100.0) == pytest.approx([0.0] * 4)
    rising = moved("suspension", [0.0, 0.0, 0.0, 10.0], 0.0)[2]
    falling = moved("suspension", [0.0, 0.0, 0.0, -10.0], 0.0)[2]
    assert rising == pytest.approx(1000 / 290 * 5.8) and falling == pytest.approx(-1000 / 290 * 13.8)


def test_a_column_comes_to_the_gains_of_wood_and_berry():
    reflux, steam = 0.1, -0.05
    d, b = 12.8 * reflux - 18.9 * steam, 6.6 * reflux - 19.4 * steam
    x = [d, b, 12.8 * reflux, -18.9 * steam, 6.6 * reflux, -19.4 * steam, *[reflux] * 4, *[steam] * 3]
    assert moved("column", x, 2.45 + reflux, 1.71 + steam) == pytest.approx([0.0] * 13, abs=1e-12)


def test_ends_are_told_where_the_user_knows_them(tmp_path):
    assert "data.inputs={torque1:{name:torque1,low:-12,high:12},torque2:{name:torque2,low:-4,high:4}}" in words(
        CASES["manipulator"], tmp_path
    )
    assert "data.inputs={reflux:reflux,steam:steam}" in words(CASES["column"], tmp_path)
    assert words(CASES["balanced"], tmp_path)[-1].startswith("data.states={cart:cart,lean:{name:lean,unit:rad,scale:")


def test_a_log_holds_inputs_within_their_actuators():
    case = CASES["column"]
    y, u = type(case)(**{**vars(case), "seconds": 6000.0}).record(0)
    low, high = case.ends
    assert bool(((u >= low) & (u <= high)).all()) and u.shape == (100, 2)
    assert not torch.equal(u[:, 0] - 2.45, u[:, 1] - 1.71) and not bool(y[:, :2].isnan().any())
