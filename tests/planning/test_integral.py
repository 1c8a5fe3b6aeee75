"""Integral action, on a plant that a proportional policy leaves with a steady error."""

import pytest
import torch

from dynasindy.envs import ControlEnv
from dynasindy.planning.integral import IntegralAction
from dynasindy.systems.pendulum import Pendulum
from dynasindy.tasks import Step, Tracking, TrackingReward


def setting():
    plant = Pendulum()
    task = Tracking(plant.signature, Step([[0.2]]), ("theta",), ("Omega",), TrackingReward((4.0,)), max_steps=600)
    env = ControlEnv(plant, task)

    def proportional(tensordict):
        error = tensordict["observation"][..., 2:3] * task.error_scale
        rate = tensordict["state"][..., 1:2].float()
        return tensordict.set("action", (error - 0.5 * rate).clamp(-1, 1))

    return env, proportional


def final_error(env, policy):
    state = env.rollout(600, policy)["next", "state"][-20:, 0]
    return float((0.2 - state).abs().mean())


def test_integral_removes_the_steady_error():
    env, proportional = setting()
    without = final_error(env, proportional)
    assert without > 0.02
    assert final_error(env, IntegralAction(proportional, env, gain=1.0, band=1.0)) < 0.1 * without


def test_errors_beyond_the_band_are_not_integrated():
    env, proportional = setting()
    action = IntegralAction(proportional, env, band=0.1)
    action(env.reset())
    assert action.integral is not None
    assert float(action.integral.abs().max()) == 0.0


def test_half_of_an_error_that_changes_at_the_given_rate_is_integrated():
    env, proportional = setting()
    action = IntegralAction(proportional, env, gain=2.0, band=1.0, rate=0.4)
    for rate, integrated in ((0.0, 0.02), (0.4, 0.01)):  # gain 2/s * 0.05 s * error 0.2 rad, and half of it
        start = env.start_from(torch.tensor([0.0, rate]))
        action(start)
        torch.testing.assert_close(action.integral, torch.tensor([integrated]))


def test_the_first_step_forgets_the_last_episode():
    env, proportional = setting()
    action = IntegralAction(proportional, env, band=1.0)
    start = env.reset()
    first = action(start.clone())["action"]
    for _ in range(5):
        action(start.clone().set("step_count", torch.ones(1, dtype=torch.int64)))
    torch.testing.assert_close(action(start.clone())["action"], first)


def test_gains_must_be_positive():
    env, proportional = setting()
    with pytest.raises(ValueError, match="positive"):
        IntegralAction(proportional, env, gain=0.0)
