"""The value of what follows a window: its slope, and what the critics learn."""

from dataclasses import replace

import torch
from tensordict import TensorDict

from dynasindy.agents import TD3
from dynasindy.envs import ControlEnv
from dynasindy.planning.terminal import TerminalValue
from dynasindy.planning.window import Rows, imagine
from dynasindy.systems.xi import Xi
from dynasindy.tasks import RandomStep, Tracking, Wave

STEPS = 10


def setting(**agent):
    plant = Xi()
    task = Tracking(plant.signature, RandomStep([-0.5, -0.5], [0.5, 0.4]))
    env = ControlEnv(plant, task, substeps=1)
    td3 = TD3(task.n_o, 2, hidden=(32, 32), **agent)
    rng = torch.Generator().manual_seed(3)
    rows = Rows(torch.zeros(8, 6), torch.zeros(8, 2), task.sample(torch.Size((8,)), rng), torch.zeros(8, 1))
    window = imagine(env, plant, td3.policy.module, rows, STEPS, rng)
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


def test_the_transitions_of_a_window_are_the_steps_of_the_environment():
    env, td3, rows, _, rng = setting()
    env.task = Tracking(env.system.signature, Wave([0.3, 0.2], [0.5, 0.4]))
    rows.x, rows.t = 0.1 * torch.randn(8, 6, generator=rng), 0.05 * torch.arange(8.0).unsqueeze(-1)
    rows.params = env.task.sample(torch.Size((8,)), rng)
    rows.params[..., 3] = torch.rand(8, 2, generator=rng)  # a phase of its own for each row
    window = imagine(env, env.system, td3.policy.module, rows, STEPS, rng)
    k, i = torch.tensor([0, 3, STEPS - 1, 3]), torch.tensor([7, 0, 2, 5])
    found = TerminalValue(env, td3, 1, rng)._transitions(rows, window, k, i)
    for place, (step, row) in enumerate(zip(k.tolist(), i.tolist())):
        start = env.start_from(window.states[step, row])
        start["task_params"], t = rows.params[row], 0.05 * (row + step)
        start["observation"] = env.task.observation(start["state"], rows.params[row], torch.tensor([t]))
        start["step_count"] = torch.tensor([row + step])
        step_of = env.step(start.set("action", window.actions[step, row]))
        for key in ("observation", "action", ("next", "observation"), ("next", "reward"), ("next", "terminated")):
            torch.testing.assert_close(found[place][key], step_of[key], rtol=1e-4, atol=1e-5)


def test_critics_learn_from_what_lives_only_and_as_often_as_asked():
    env, td3, rows, window, rng = setting()
    alive = torch.zeros_like(window.alive)
    alive[0], alive[: STEPS // 2 + 1, 3] = True, True  # one row lives for half of the window
    seen = []
    td3.update_critics = seen.append
    TerminalValue(env, td3, 4, rng).learn(rows, replace(window, alive=alive))
    assert [len(batch) for batch in seen] == [256] * 4
    expected = env.task.observation(window.states[: STEPS // 2, 3], rows.params[3], window.times[: STEPS // 2, 0])
    for batch in seen:  # all of its five periods, and no others
        torch.testing.assert_close(batch["observation"].unique(dim=0), expected.unique(dim=0))
    seen.clear()
    alive[1:] = False
    TerminalValue(env, td3, 4, rng).learn(rows, replace(window, alive=alive))
    assert seen == []
