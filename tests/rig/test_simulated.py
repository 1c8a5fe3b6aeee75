"""A simulated rig moves by its clock, as an independent integration says."""

import time

import numpy as np
import pytest
import torch
from fast_clock import FastClock
from scipy.integrate import solve_ivp
from tank import Tank

from dynasindy.envs import Sensors
from dynasindy.rig.simulated import SimulatedRig, rehearsal
from dynasindy.systems import Pendulum, rk4


def by_hand(x, inputs, dt):
    plant, x = Pendulum(), torch.tensor(x, dtype=torch.float64)
    for u in inputs:
        x = rk4(plant, x, torch.tensor([u], dtype=torch.float64), dt)
    return x


def test_the_plant_moves_under_the_inputs_of_each_span_of_time():
    clock = FastClock()
    rig = SimulatedRig(Pendulum(), clock=clock)
    clock.sleep(0.03)  # the safe input, until others are given
    rig.write(np.array([0.5]))
    clock.sleep(0.02)
    np.testing.assert_allclose(rig.read(0.1), by_hand([0.0, 0.0], [0.0] * 3 + [0.5] * 2, 0.01), atol=1e-12)
    rig.rest()
    clock.sleep(0.01)
    np.testing.assert_allclose(rig.read(0.1), by_hand([0.0, 0.0], [0.0] * 3 + [0.5] * 2 + [0.0], 0.01), atol=1e-12)
    assert rig.u.tolist() == [0.0]


@pytest.mark.parametrize("step", [0.05, 0.01])
def test_a_span_is_cut_into_steps(step):
    clock = FastClock()
    rig = SimulatedRig(Pendulum(), clock=clock, step=step)
    rig.write(np.array([0.8]))
    clock.sleep(0.1)
    np.testing.assert_allclose(rig.read(0.1), by_hand([0.0, 0.0], [0.8] * round(0.1 / step), step), atol=1e-13)


def test_sensors_stand_between_the_plant_and_who_asks():
    rig = SimulatedRig(Pendulum(), Sensors({"theta": {"resolution": 0.01}}), FastClock())
    rig.x = torch.tensor([0.234, 1.0], dtype=torch.float64)
    np.testing.assert_allclose(rig.read(0.1), [0.23, np.nan])
    assert rig.x.tolist() == [0.234, 1.0]


def test_a_late_rig_moves_by_the_inputs_of_some_time_before():
    clock = FastClock()
    rig = SimulatedRig(Pendulum(), clock=clock, delay=0.03)
    rig.write(np.array([0.5]))
    clock.sleep(0.02)
    rig.write(np.array([-0.5]))
    clock.sleep(0.04)
    np.testing.assert_allclose(rig.read(0.1), by_hand([0.0, 0.0], [0.0] * 3 + [0.5] * 2 + [-0.5], 0.01), atol=1e-12)


def test_a_rehearsal_moves_by_the_clock_and_ends_in_the_safe_input():
    with rehearsal(Pendulum(), 0.05) as rig:
        rig.begin()
        assert rig.read(60.0).tolist() == [0.0, 0.0]
        rig.write(np.array([1.0]))
        time.sleep(0.1)
        assert rig.read(10.0)[0] > 0.01
    assert rig.u.tolist() == [0.0]


def test_a_command_reaches_the_plant_as_many_periods_late_as_its_sensors_say():
    late = Sensors({"theta": {}, "Omega": {}}, actuator_delay=2)
    with rehearsal(Pendulum(), 0.05, late) as rig:
        assert rig.delay == pytest.approx(0.1)


def test_a_rehearsal_follows_its_plant_within_long_periods():
    plant, clock = Pendulum(), FastClock()
    with rehearsal(plant, 0.5, start={"theta": 1.2}) as rig:
        clock.sleep(rig.clock.monotonic() + 1.0)
        rig.clock = clock
        begin = rig.read(0.5)
        clock.sleep(0.5)
        end = rig.read(0.5)
    exact = solve_ivp(lambda t, x: (x[1], -9.81 * np.sin(x[0]) - 0.5 * x[1]), (0, 0.5), begin, rtol=1e-9).y[:, -1]
    np.testing.assert_allclose(end, exact, atol=1e-3)


@pytest.mark.filterwarnings("error")
def test_a_rehearsal_begins_where_its_user_says_and_asks_the_plant_about_nothing_beyond_its_bounds():
    with rehearsal(Tank(), 0.05, bounds={"h": [0.0, 2.0]}, start={"h": 0.25}) as rig:
        rig.begin()
        samples = [rig.read(60.0).item() for _ in range(3)]
    assert samples == pytest.approx([0.25] * 3, abs=1e-9)  # where 0.1 flows in and 0.2 sqrt(0.25) out


def test_a_rehearsal_without_bounds_warns_of_where_the_plant_cannot_be():
    words = r"not finite, of h, where h is -0\.98 m"
    with pytest.warns(UserWarning, match=words), rehearsal(Tank(), 0.05):
        pass
    with pytest.raises(ValueError, match=r"bounds.* depth"), rehearsal(Tank(), 0.05, bounds={"depth": 1.0}):
        pass
