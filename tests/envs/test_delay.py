"""An environment whose inputs are late moves as an independent integration of the late inputs says."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torchrl.envs.utils import check_env_specs

from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward
from dynasindy.systems import Pendulum, Signature, System

DT = 0.05


def late(delay, substeps=5):
    plant = Pendulum()
    task = Tracking(plant.signature, Step([[0.3]]), ("theta",), ("Omega",), TrackingReward((4.0,)), max_steps=40)
    return ControlEnv(plant, task, DT, substeps, delay=delay, dtype=torch.float64)


def test_specs_hold():
    check_env_specs(late(0.12))


@pytest.mark.parametrize("periods", [0.0, 1.0, 2.0, 2.5])
def test_each_sample_is_where_the_late_inputs_have_brought_the_plant(periods):
    """Omega' = 12 u(t - delay) - 9.81 sin(theta) - 0.5 Omega, by SciPy from one change of the input to the next."""
    inputs = np.sin(0.7 * np.arange(20))
    env = late(periods * DT)
    rows = env.rollout(20, lambda td: td.set("action", torch.from_numpy(inputs)[td["step_count"]].float()))
    seen = rows["next", "samples"].reshape(-1, 2).numpy()
    x, truth = np.zeros(2), []
    for k in range(len(seen)):
        for half in (0.0, 0.5):  # an input changes in the middle of a sample at 2.5 periods
            begun = int(np.floor((k + half) / 5 - periods + 1e-9))
            u = inputs[begun] if begun >= 0 else 0.0
            x = solve_ivp(
                lambda t, x, u=u: [x[1], 12 * u - 9.81 * np.sin(x[0]) - 0.5 * x[1]], (0, 0.005), x, rtol=1e-9
            ).y[:, -1]
        truth.append(x)
    np.testing.assert_allclose(seen, truth, atol=2e-3 if periods == 2.5 else 1e-5)


def test_another_plant_and_another_task_have_the_same_delay():
    env = late(0.1)
    assert env.with_task(env.task).delay == env.with_system(Pendulum()).delay == 0.1
    with pytest.raises(ValueError, match="delay"):
        late(-0.1)


@pytest.mark.parametrize(("delay", "late_steps"), [(0.05, 2), (0.075, 3)])
def test_a_difference_equation_gets_its_inputs_whole_steps_late(delay, late_steps):
    """x[k+1] = -0.5 x[k] + u[k - late], two steps of 0.025 s to a control period."""

    class Alternating(System):
        step = 0.025

        def forward(self, x, u):
            return (-1.5 * x + u) / 0.025

    signature = Signature(("x",), ("-",), ("u",), (1.0,))
    task = Tracking(signature, Step([[0.3]]), ("x",), (), TrackingReward((4.0,)), max_steps=40)
    env = ControlEnv(Alternating(signature), task, DT, 2, delay=delay, dtype=torch.float64)
    inputs = torch.sin(torch.arange(20.0))
    rows = env.rollout(20, lambda td: td.set("action", inputs[td["step_count"]]))
    x, seen = 0.0, []
    for k in range(40):
        x = -0.5 * x + (float(inputs[(k - late_steps) // 2]) if k >= late_steps else 0.0)
        seen.append(x)
    np.testing.assert_allclose(rows["next", "state"].flatten(), seen[1::2], rtol=1e-6)
    with pytest.raises(ValueError, match="cannot"):
        ControlEnv(Alternating(signature), task, DT, 2, delay=0.06, dtype=torch.float64).rollout(3)
