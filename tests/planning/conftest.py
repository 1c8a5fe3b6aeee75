"""What several tests of planning are about: the twin rotor `xi` with a small agent, and a pole to be held upright."""

import pytest
from alternating import Mapped
from plants import Upright

from dynasindy.agents import TD3, DynaReplay
from dynasindy.envs import ControlEnv, RandomStep, Tracking, TrackingReward
from dynasindy.planning import GradientPlanning
from dynasindy.planning.plan_settings import find_task_equilibria
from dynasindy.systems.xi import Xi


@pytest.fixture
def small():
    """Settings of a planning that takes no time."""
    return {"rollouts": 16, "window": 20, "check_every": 4}


@pytest.fixture(scope="session")
def setting():
    """Make an environment of `xi`, an agent and empty storages."""

    def make(max_steps=60, **agent):
        plant = Xi()
        task = Tracking(plant.signature, RandomStep([-0.3, -0.3], [0.3, 0.3]), max_steps=max_steps)
        env = ControlEnv(plant, task)
        return env, TD3(task.n_o, 2, hidden=(32, 32), **agent), DynaReplay(1000, 16)

    return make


@pytest.fixture(scope="session")
def mapped():
    """Make an environment of x[k+1] = a x[k] + b u[k], by steps of 0.5 s, with targets to both sides of zero."""

    def make(a, b, dt=0.5, box=0.5):
        plant, ends = Mapped(a, b), {"low": [-box], "high": [box]}
        task = Tracking(plant.signature, RandomStep(**ends), ["x"], [], TrackingReward([1.0]), **ends)
        return ControlEnv(plant, task, dt, 1)

    return make


@pytest.fixture
def planned(setting, small):
    """Make a planner of a small setting."""

    def make(**settings):
        env, agent, replay = setting()
        return GradientPlanning(env, agent, replay, **(small | {"updates": 1} | settings))

    return make


@pytest.fixture(scope="session")
def inverted():
    """Make an environment of the pole, with targets to both sides of upright, and its rests."""

    def make(pull=6.0, start=None, box=0.4, max_steps=60):
        plant, ends = Upright(4.0, pull), {"low": [-box], "high": [box]}
        reward = TrackingReward((4.0,), error_shape="linear")
        outputs = ("theta",), ("Omega",)
        task = Tracking(plant.signature, RandomStep(**ends), *outputs, reward, max_steps, **ends, start=start)
        env = ControlEnv(plant, task, 0.05, 1)
        return env, find_task_equilibria(env)

    return make
