"""The Gymnasium adapter against Gymnasium's own checker and against the environment it adapts."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import dynasindy  # noqa: F401 (registers the environments)
from dynasindy.envs import ControlEnv
from dynasindy.envs.gym import GymControl, twin_rotor
from dynasindy.systems import Tras
from dynasindy.tasks import Step, Tracking

IDS = ["dynasindy/TwinRotor-v0", "dynasindy/Pendulum-v0"]


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_check_env_passes(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # States have no bounds (rotor speeds follow from the physics), so neither has their space.
        warnings.filterwarnings("ignore", message=".*Box observation space (min|max)imum value is -?infinity.*")
        # The id ends in -v0 on purpose.
        warnings.filterwarnings("ignore", message=".*is out of date.*")
        env = gymnasium.make(name, render_mode="rgb_array")
        check_env(env.unwrapped)


def test_the_adapter_plays_what_the_control_env_plays() -> None:
    system = Tras()
    task = Tracking(system.signature, Step([[0.3, 0.2]]), max_steps=5)
    actions = torch.rand(5, 2, generator=torch.Generator().manual_seed(0)) - 0.5
    expected = ControlEnv(system, task).rollout(5, actions=actions)

    env = GymControl(ControlEnv(system, task))
    observation, _ = env.reset(seed=0)
    for k in range(5):
        np.testing.assert_array_equal(observation, expected["observation"][k].numpy())
        observation, reward, terminated, truncated, info = env.step(actions[k].numpy())
        np.testing.assert_array_equal(observation, expected["next", "observation"][k].numpy())
        np.testing.assert_array_equal(info["state"], expected["next", "state"][k].numpy())
        assert reward == pytest.approx(expected["next", "reward"][k].item())
        assert not terminated
        assert truncated == (k == 4)


def test_seeds_repeat_sequences_of_episodes_and_leave_the_global_generator_alone() -> None:
    env = twin_rotor()
    before = torch.random.get_rng_state()
    first = [env.reset(seed=5)[1]["reference"], env.reset()[1]["reference"]]
    second = [env.reset(seed=5)[1]["reference"], env.reset()[1]["reference"]]
    assert torch.equal(before, torch.random.get_rng_state())
    np.testing.assert_array_equal(first, second)
    assert (first[0] != first[1]).any()


def test_actions_out_of_range_are_clipped() -> None:
    env = twin_rotor(plant="xi")
    results = []
    for size in (1.0, 7.0):
        env.reset(seed=1)
        results.append(env.step(np.array([size, -size], dtype=np.float32))[0])
    np.testing.assert_array_equal(*results)


def test_mistakes_get_one_line() -> None:
    with pytest.raises(ValueError, match="plant 'helicopter' is unknown; use one of tras, xi, trms33"):
        twin_rotor(plant="helicopter")
    with pytest.raises(ValueError, match="render_mode 'human' is unknown"):
        twin_rotor(render_mode="human")
    with pytest.raises(RuntimeError, match="call reset first"):
        twin_rotor().step(np.zeros(2, dtype=np.float32))
    system = Tras()
    with pytest.raises(ValueError, match="one row"):
        GymControl(ControlEnv(system, Tracking(system.signature, Step([[0.0, 0.0]])), batch_size=(3,)))


def test_importing_the_package_does_not_import_torch() -> None:
    code = "import sys, dynasindy; assert 'torch' not in sys.modules and 'torchrl' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
