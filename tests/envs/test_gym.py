"""The Gymnasium adapter against Gymnasium's own checker and against the environment it adapts."""

import copy
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch

import dynasindy  # noqa: F401 (registers the environments)
from dynasindy.envs import ControlEnv, Foreign, GymnasiumEnv, Step, Tracking, TrackingReward, Wave
from dynasindy.envs.drawing import draw
from dynasindy.envs.gym import _GymControl, pendulum, twin_rotor
from dynasindy.systems import Tras

IDS = ["dynasindy/TwinRotor-v0", "dynasindy/Pendulum-v0"]


def test_the_adapter_plays_what_the_control_env_plays() -> None:
    system = Tras()
    task = Tracking(system.signature, Step([[0.3, 0.2]]), max_steps=5)
    actions = torch.rand(5, 2, generator=torch.Generator().manual_seed(0)) - 0.5
    expected = ControlEnv(system, task).rollout(5, actions=actions)

    env = _GymControl(ControlEnv(system, task))
    observation, _ = env.reset(seed=0)
    for k in range(5):
        np.testing.assert_array_equal(observation, expected["observation"][k].numpy())
        observation, reward, terminated, truncated, info = env.step(actions[k].numpy())
        np.testing.assert_array_equal(observation, expected["next", "observation"][k].numpy())
        np.testing.assert_array_equal(info["state"], expected["next", "state"][k].numpy())
        assert reward == pytest.approx(expected["next", "reward"][k].item())
        assert not terminated
        assert truncated == (k == 4)


def test_the_adapter_plays_moving_references_in_double_precision_and_pays_for_stops() -> None:
    system = Tras(azimuth_stop=0.05)
    reward = TrackingReward(stop_penalty=3.0)
    task = Tracking(system.signature, Wave((0.3, 0.2), (0.9, 0.7)), reward=reward, observe_rate=True, max_steps=40)
    plain = ControlEnv(system, task, dtype=torch.float64)
    actions = torch.full((40, 2), 0.6)
    expected = plain.rollout(40, actions=actions)["next"]
    assert 0 < int(expected["at_stop"].sum()) < 40
    env = _GymControl(ControlEnv(system, task, dtype=torch.float64))
    env.reset(seed=0)
    for k in range(40):
        observation, reward, _, _, info = env.step(actions[k].numpy())
        np.testing.assert_array_equal(observation, expected["observation"][k].numpy())
        np.testing.assert_array_equal(info["state"], expected["state"][k].numpy())
        np.testing.assert_array_equal(info["reference"], expected["reference"][k].numpy())
        assert reward == expected["reward"][k].item()


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


def test_spaces_and_the_papers_references_are_those_documented() -> None:
    env = twin_rotor(render_mode="rgb_array")
    assert env.observation_space.shape == (8,) and env.action_space.shape == (2,)
    assert (env.action_space.low == -1).all() and (env.action_space.high == 1).all()
    assert (env.observation_space.low < -1e38).all() and (env.observation_space.high > 1e38).all()
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 20}  # a control period is 0.05 s
    drawn = np.array([env.reset(seed=k)[1]["reference"] for k in range(60)])
    np.testing.assert_allclose(np.abs(drawn).max(0), [0.4, 0.25], atol=0.03)
    np.testing.assert_allclose(drawn.min(0), [-0.4, -0.25], atol=0.05)
    narrow = twin_rotor(low=(0.1, 0.2), high=(0.1, 0.2)).reset()[1]["reference"]
    np.testing.assert_allclose(narrow, [0.1, 0.2], rtol=1e-6)


def test_the_pendulum_tracks_its_angle_for_the_papers_weights() -> None:
    env = pendulum(low=0.5, high=0.5)
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation, [0, 0, 1.0])  # an error of 0.5 rad counts as 1
    _, reward, _, _, after = env.step(np.array([0.3], dtype=np.float32))
    theta, rate = after["state"]
    assert reward == pytest.approx(-4 * (0.5 - theta) ** 2 - 0.1 * rate**2, rel=1e-5)
    drawn = np.array([pendulum().reset(seed=k)[1]["reference"].item() for k in range(60)])
    assert -1 < drawn.min() < -0.9 and 0.9 < drawn.max() < 1


def test_pictures_show_the_present_and_are_made_only_when_asked_for() -> None:
    env = twin_rotor(render_mode="rgb_array")
    assert env.render() is None  # nothing to show before the first reset
    env.reset(seed=0)
    for _ in range(3):
        _, _, _, _, info = env.step(np.array([1.0, 0.5], dtype=np.float32))
    expected = draw(Tras().signature, info["state"].tolist(), info["reference"].tolist(), [0, 1], "t = 0.15 s")
    np.testing.assert_array_equal(env.render(), expected)
    silent = twin_rotor()
    silent.reset(seed=0)
    assert silent.render() is None


def test_an_environment_that_steps_in_its_own_way_is_played_as_it_is() -> None:
    """Pendulum-v1 itself, put to where the episode begins, moves alike; cosine and sine tell the error."""
    system = Foreign("Pendulum-v1", {"c": 1.0, "s": 1.0, "w": 8.0}, ["torque"])
    task = Tracking(system.signature, Step([[1.0, 0.0]]), ("c", "s"), (), TrackingReward((4.0,)), max_steps=3)
    env, bare = _GymControl(GymnasiumEnv(system, task)), gymnasium.make("Pendulum-v1")
    bare.reset()
    c, s, w = env.reset(seed=5)[1]["state"]
    bare.unwrapped.state = np.array([np.arctan2(s, c), w])
    for k in range(1, 4):
        _, reward, terminated, truncated, info = env.step(np.array([0.5], dtype=np.float32))
        seen, *_ = bare.step(np.array([1.0], dtype=np.float32))  # torques of -2 to 2
        np.testing.assert_allclose(info["state"], seen, rtol=1e-5)
        paid = -4 * ((1 - seen[0]) ** 2 + seen[1] ** 2)
        assert reward == pytest.approx(paid, rel=1e-5) and (terminated, truncated) == (False, k == 3)


@pytest.mark.parametrize(
    "order",
    [
        "import dynasindy, gymnasium",
        "import gymnasium, dynasindy",
        "import dynasindy, importlib.util; importlib.util.find_spec('gymnasium'); import gymnasium",
    ],
)
def test_gymnasium_has_the_environments_whichever_is_imported_first(order: str) -> None:
    code = f"{order}; print(*(name for name in gymnasium.registry if name.startswith('dynasindy/')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == set(IDS)


def test_the_package_alone_imports_neither_gymnasium_nor_numpy() -> None:
    code = "import sys, dynasindy; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"gymnasium", "numpy"} & set(done.stdout.split())


@pytest.mark.parametrize("name", IDS)
def test_copies_within_an_episode_go_on_by_themselves(name):
    env = gymnasium.make(name).unwrapped
    action = np.full(env.action_space.shape, 0.3, np.float32)
    env.reset(seed=1)
    env.step(action)
    copies = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    expected = [env.step(action)[0] for _ in range(3)]
    for each in copies:
        assert all(np.array_equal(each.step(action)[0], seen) for seen in expected)


@pytest.mark.parametrize("name", IDS)
def test_an_action_of_another_shape_is_refused(name):
    env = gymnasium.make(name).unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(3))
