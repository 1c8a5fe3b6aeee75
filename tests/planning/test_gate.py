import math

import pytest
import torch

from dynasindy.envs import ControlEnv, Step, Tracking, Wave
from dynasindy.planning import Gate, ModelError, replay_error
from dynasindy.systems import System, Tras, Xi


def errors(*rewards):
    return [ModelError(r, 0.0, torch.zeros(0)) for r in rewards]


def test_the_gate_has_hysteresis():
    gate = Gate(open_below=0.1, close_above=0.3, is_open=True)
    decisions = [gate.judge(error) for error in errors(0.2, 0.29, 0.31, 0.2, 0.11, 0.1, 0.2)]
    assert decisions == [True, True, False, False, False, True, True]
    assert [gate.judge(each) for each in errors(math.nan, 0.4, math.nan)] == [True, False, False]


def test_the_true_model_has_no_error_and_another_has():
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])), dtype=torch.float64)
    episode = env.rollout(100)
    right, wrong = replay_error(env, episode), replay_error(env.with_system(Xi()), episode)
    assert right.reward_error == pytest.approx(0, abs=1e-6) and right.state_error == 0
    assert wrong.state_error > 0.01
    assert torch.equal(right.states, episode["next", "state"])


def test_a_model_that_overflows_has_an_infinite_error():
    class Runaway(System):
        def forward(self, x, u):
            return torch.full_like(x, 1e38)

    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])))
    episode, wild = env.rollout(10), env.with_system(Runaway(plant.signature))
    assert replay_error(wild, episode).state_error == float("inf")
    assert replay_error(wild, episode, torch.tensor([0]), 5).state_error == float("inf")


def test_the_errors_are_those_of_a_loop_over_windows_and_periods():
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Wave([0.4, 0.3], [0.7, 0.9])), dtype=torch.float64)
    episode, model_env, scale = env.rollout(30), env.with_system(Xi()), plant.signature.x_scale
    rewards, states, ends = [], [], []
    for start in (3, 17):
        x = episode["state"][start]
        for k in range(start, start + 9):
            following = model_env.advance(x, episode["action"][k].double())[0][-1]
            t = torch.tensor([(k + 1) * 0.05]).double()
            reward = env.task.reward(x, following, episode["task_params"][k], t, torch.tensor(False))
            rewards.append(abs(reward.item() - episode["next", "reward"][k].item()))
            real = episode["next", "state"][k].tolist()
            states += [((a - b) / c) ** 2 for a, b, c in zip(following.tolist(), real, scale, strict=True)]
            ends.append(following)
            x = following
    found = replay_error(model_env, episode, torch.tensor([3, 17]), 9)
    assert found.reward_error == pytest.approx(sum(rewards) / len(rewards), rel=1e-5)
    assert found.state_error == pytest.approx((sum(states) / len(states)) ** 0.5, rel=1e-5)
    torch.testing.assert_close(found.states, torch.stack(ends))


def test_a_stop_that_the_model_meets_costs_what_it_costs_the_plant():
    plant = Tras(azimuth_stop=0.001)
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])), dtype=torch.float64)
    episode = env.rollout(40)
    assert episode["next", "at_stop"].any()
    assert replay_error(env, episode).reward_error < 1e-6
