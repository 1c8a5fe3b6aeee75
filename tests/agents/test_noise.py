"""Exploration noise: distribution, decay, own generator."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dynasindy.agents.td3 import DecayingGaussian


def zeros(n=20000):
    return TensorDict({"action": torch.zeros(n, 1)}, [n])


def test_sigma_decays_by_its_rate_each_step_down_to_the_minimum():
    noise = DecayingGaussian(sigma=0.15, decay=1e-3, minimum=0.05)
    for _ in range(400):
        noise(zeros(1))
    assert noise.sigma == pytest.approx(0.15 * math.exp(400 * math.log1p(-1e-3)))
    for _ in range(1000):
        noise(zeros(1))
    assert noise.sigma == 0.05


def test_imagined_steps_use_the_noise_without_advancing_its_decay():
    noise = DecayingGaussian(sigma=0.15, decay=0.5)
    frozen = noise.frozen()
    assert frozen(zeros())["action"].std().item() == pytest.approx(0.15, rel=0.02)
    assert noise.sigma == 0.15
    assert not frozen.state_dict()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert frozen(zeros(8))["action"].abs().max() == 0
    noise.sigma = 0.05
    assert frozen(zeros())["action"].std().item() == pytest.approx(0.05, rel=0.02)


def test_actions_are_clipped():
    noise = DecayingGaussian(sigma=5.0)
    assert noise(zeros())["action"].abs().max() == 1


def test_state_is_restored():
    noise, other = DecayingGaussian(seed=1), DecayingGaussian(seed=2)
    noise(zeros(4))
    other.load_state_dict(noise.state_dict())
    assert other.sigma == noise.sigma
    assert torch.equal(other(zeros(4))["action"], noise(zeros(4))["action"])


def test_a_draw_is_the_action_plus_sigma_times_its_generators_numbers():
    noise = DecayingGaussian(sigma=0.3, decay=0.1, seed=4)
    drawn = torch.randn(5, 2, generator=torch.Generator().manual_seed(4))
    action = torch.linspace(-0.9, 0.9, 10).reshape(5, 2)
    given = noise(TensorDict({"action": action.clone()}, [5]))["action"]
    torch.testing.assert_close(given, (action + 0.3 * drawn).clamp(-1, 1))
    assert noise.sigma == pytest.approx(0.27)
