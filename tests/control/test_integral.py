"""Integral action, on a plant that a proportional policy leaves with a steady error."""

import math

import pytest
import torch

from dynasindy.control.controller import IntegralAction
from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward, Wave
from dynasindy.systems.pendulum import Pendulum


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


def test_an_output_without_a_rate_is_integrated_as_if_it_stood_still():
    plant = Pendulum()
    outputs, reward = ("Omega", "theta"), TrackingReward((4.0,))
    task = Tracking(plant.signature, Step([[0.6, 0.2]]), outputs, (None, "Omega"), reward)
    env = ControlEnv(plant, task)
    action = IntegralAction(setting()[1], env, gain=2.0, band=10.0, rate=0.4, limit=10.0)
    action.policy = lambda tensordict: tensordict.set("action", torch.zeros(1))
    action(env.start_from(torch.tensor([0.0, 0.4])))
    error, box = torch.tensor([0.2, 0.2]), task.boxes().float()
    share = torch.tensor([1.0, 1 / (1 + (1 / float(box[1])) ** 2)])  # of theta, whose rate is Omega = 0.4 rad/s
    torch.testing.assert_close(action.integral, 2.0 * env.dt * share * error / box)


def test_shift_and_integral_are_those_of_the_formulas_on_a_moving_reference():
    plant = Pendulum()
    task = Tracking(plant.signature, Wave([0.3], [0.2]), ("theta",), ("Omega",), TrackingReward((4.0,)))
    env = ControlEnv(plant, task, dtype=torch.float64)
    seen = []

    def policy(tensordict):
        seen.append(tensordict["observation"].clone())
        return tensordict.set("action", torch.tensor([0.123]))

    action = IntegralAction(policy, env, gain=3.0, band=0.25, limit=0.02, rate=0.5)
    integral = 0.0
    for k, (angle, speed) in enumerate([(-0.2, 0.1), (-0.1, 0.3), (0.0, 0.5), (0.1, 0.2), (0.4, 0.2), (0.5, -1.0)]):
        now = env.start_from(torch.tensor([angle, speed]))
        now["task_params"] = task.sample(torch.Size(()), torch.Generator()).double()
        now["step_count"] = torch.tensor([5 * k])
        t = 0.25 * k  # the count in control periods of 0.05 s
        true = task.observation(now["state"], now["task_params"], torch.tensor([t])).float()
        now["observation"] = true.clone()
        out = action(now)
        expected = true.clone()
        expected[2] += integral / 0.5  # states first, then the error over 0.5 rad
        torch.testing.assert_close(seen[-1], expected)
        torch.testing.assert_close(out["observation"], true)
        assert out["action"].item() == pytest.approx(0.123)
        error = 0.3 * math.sin(2 * math.pi * 0.2 * t) - angle
        moving = (0.3 * 2 * math.pi * 0.2 * math.cos(2 * math.pi * 0.2 * t) - speed) / 0.5
        step = 3.0 * 0.05 * error / (1 + moving**2) if abs(error) < 0.25 else 0.0
        integral = max(-0.02, min(0.02, integral + step))
        assert action.integral.item() == pytest.approx(integral, abs=1e-7)
    assert len({round(o[2].item(), 3) for o in seen}) == 6 and integral != 0.02  # the limit was met, and left again


def test_a_row_that_begins_anew_forgets_alone():
    env, proportional = setting()
    action = IntegralAction(proportional, env, gain=2.0, band=1.0)
    start = env.start_from(torch.zeros(2, 2))
    action(start.clone().set("step_count", torch.tensor([[3], [3]])))
    action(start.clone().set("step_count", torch.tensor([[4], [0]])))
    assert action.integral.flatten().tolist() == pytest.approx([0.04, 0.02])  # twice and once 2/s * 0.05 s * 0.2 rad
    action(env.start_from(torch.zeros(3, 2)).set("step_count", torch.ones(3, 1, dtype=torch.int64)))
    assert action.integral.flatten().tolist() == pytest.approx([0.02] * 3)  # another batch begins at zero


def test_band_limit_and_rate_count_in_boxes_of_targets():
    """Half the box and twice the numbers are the same controller."""
    plant, states = Pendulum(), []
    for box, factor in ((0.5, 2.0), (1.0, 1.0)):
        task = Tracking(
            plant.signature,
            Step([[0.2]]),
            ("theta",),
            ("Omega",),
            TrackingReward((4.0,)),
            max_steps=100,
            error_scale=0.5 * factor,
            low=[0.0],
            high=[box],
        )
        env = ControlEnv(plant, task)

        def proportional(tensordict):
            return tensordict.set("action", (0.5 * tensordict["observation"][..., 2:3]).clamp(-1, 1))

        numbers = {"band": 0.15 * factor, "limit": 0.06 * factor, "rate": 0.3 * factor}
        states.append(env.rollout(100, IntegralAction(proportional, env, gain=2.0, **numbers))["next", "state"])
        assert not torch.allclose(states[-1], env.rollout(100, proportional)["next", "state"], atol=1e-2)
    torch.testing.assert_close(*states)
