"""The environments are what TorchRL and Gymnasium expect, and pay and move as the equations say."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs.utils import check_env_specs

import dynasindy  # noqa: F401 (registers the environments)
from dynasindy.envs import ControlEnv, Foreign, GymnasiumEnv, RandomStep, Step, Tracking, TrackingReward
from dynasindy.systems import Pendulum, Tras, Xi

IDS = ["dynasindy/TwinRotor-v0", "dynasindy/Pendulum-v0"]


def rotor(system=None, reference=None, **settings):
    system = system or Tras()
    task = Tracking(system.signature, reference or RandomStep([-0.5, -0.5], [0.5, 0.4]))
    return ControlEnv(system, task, **settings)


def pendulum(reference=None, **settings):
    system, reward = Pendulum(), TrackingReward((2.0,), 0.5, 0.0)
    task = Tracking(system.signature, reference or RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), reward)
    return ControlEnv(system, task, **settings)


@pytest.mark.parametrize(("system", "dtype", "batch_size"), [(Tras, torch.float32, ()), (Xi, torch.float64, (4,))])
def test_torchrl_accepts_the_specs_of_two_rotors(system, dtype, batch_size):
    check_env_specs(rotor(system(), dtype=dtype, batch_size=batch_size))


@pytest.mark.parametrize(("dtype", "batch_size"), [(torch.float32, ()), (torch.float64, (4,))])
def test_torchrl_accepts_the_specs_of_one_input(dtype, batch_size):
    check_env_specs(pendulum(dtype=dtype, batch_size=batch_size))


def test_torchrl_accepts_the_specs_of_a_model_and_of_a_gymnasium_environment():
    env = rotor()
    check_env_specs(env.with_system(Tras()))
    system = Foreign("Pendulum-v1", {"c": 1.0, "s": 1.0, "w": 8.0}, ["torque"])
    task = Tracking(system.signature, Step([[1.0, 0.0]]), ("c", "s"), (), TrackingReward((4.0,)), max_steps=3)
    check_env_specs(GymnasiumEnv(system, task))


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_accepts_the_environments_that_it_makes(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The id ends in -v0 on purpose.
        warnings.filterwarnings("ignore", message=".*is out of date.*")
        env = gymnasium.make(name, render_mode="rgb_array")
        check_env(env.unwrapped)
    state = np.asarray(env.reset(seed=0)[1]["state"], dtype=float)
    for _ in range(4):
        _, reward, terminated, truncated, info = env.step(np.full(env.action_space.shape, 0.4, dtype=np.float32))
        assert reward < 0 and not terminated and not truncated
    assert np.abs(np.asarray(info["state"]) - state).max() > 1e-3


def constant(*u):
    return lambda tensordict: tensordict.set("action", torch.tensor(u).expand(*tensordict.batch_size, len(u)))


def test_the_real_plant_and_the_imagined_one_pay_and_move_alike_if_the_model_is_true():
    env = rotor(dtype=torch.float64, batch_size=(2,))
    starts = env.reset()
    flights = [
        each.rollout(50, constant(0.3, 0.9), auto_reset=False, tensordict=starts.clone())
        for each in (env, env.with_system(Tras()))
    ]
    for key in ("state", "observation", "reward", "at_stop", "reference"):
        assert torch.equal(flights[0]["next", key], flights[1]["next", key]), key
    other = env.with_system(Xi()).rollout(50, constant(0.3, 0.9), auto_reset=False, tensordict=starts.clone())
    assert not torch.allclose(other["next", "state"], flights[0]["next", "state"], atol=1e-3)
