"""The value of what follows a window: its slope, and what the critics learn."""

import torch
from tensordict import TensorDict

from dynasindy.agents import TD3
from dynasindy.envs import ControlEnv
from dynasindy.planning.terminal import TerminalValue
from dynasindy.planning.window import Rows, imagine
from dynasindy.systems.xi import Xi
from dynasindy.tasks import RandomStep, Tracking

STEPS = 10


def setting(**agent):
    plant = Xi()
    task = Tracking(plant.signature, RandomStep([-0.5, -0.5], [0.5, 0.4]))
    env = ControlEnv(plant, task, substeps=1)
    td3 = TD3(task.n_o, 2, hidden=(32, 32), **agent)
    rng = torch.Generator().manual_seed(3)
    rows = Rows(torch.zeros(8, 6), torch.zeros(8, 2), task.sample(torch.Size((8,)), rng), torch.zeros(8, 1))
    window = imagine(env, plant, td3.policy.module, rows, STEPS, False, rng)
    return env, td3, rows, window, rng


def test_the_slope_is_that_of_the_first_critic_along_the_policy():
    env, td3, rows, window, rng = setting()
    slope = TerminalValue(env, td3, 1, rng).slope(rows, window)
    first = td3.loss.qvalue_network_params.get("module")[0]
    x = window.states[-1].clone().requires_grad_()
    seen = env.task.observation(x, rows.params, window.times[-1])
    with first.to_module(td3.loss.qvalue_network.module):
        value = td3.loss.qvalue_network.module(seen, td3.policy.module(seen)).mean()
    # The value adds to the rewards, of which the cost is the negative mean.
    (expected,) = torch.autograd.grad(-value / STEPS, x)
    torch.testing.assert_close(slope, expected)


def test_the_critics_come_to_value_a_constant_reward_at_its_discounted_sum():
    env, td3, rows, window, rng = setting(
        gamma=0.5, critic_lr=1e-2, policy_noise=0.0, tau=0.2, target_update_interval=1
    )
    env.task.reward = lambda x, x_next, params, t_next, free: torch.ones(len(x))
    before = [p.clone() for p in td3.policy.parameters()]
    TerminalValue(env, td3, 300, rng).learn(rows, window)
    seen = env.task.observation(window.states[-1], rows.params, window.times[-1])
    values = -td3.loss.actor_loss(TensorDict({"observation": seen}, [8]))[0]
    assert abs(values.item() - 1 / (1 - 0.5)) < 0.05
    assert all(torch.equal(old, new) for old, new in zip(before, td3.policy.parameters()))
