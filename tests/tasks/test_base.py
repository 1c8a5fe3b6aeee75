import pytest
import torch
from torchrl.envs import check_env_specs

from dynasindy.envs import ControlEnv
from dynasindy.systems import Pendulum, Tras, rk4
from dynasindy.tasks import Step, Tracking


def test_an_episode_has_at_least_one_step():
    with pytest.raises(ValueError, match="max_steps"):
        Tracking(Tras().signature, Step([[0.0, 0.0]]), max_steps=0)
    task = Tracking(Tras().signature, Step([[0.0, 0.0]]), max_steps=1)
    assert task.max_steps == 1 and task.signature == Tras().signature


@pytest.mark.parametrize("batch", [(), (4,)])
def test_a_task_without_references_is_an_environment_with_none(settle, batch):
    env = ControlEnv(Pendulum(), settle(Pendulum().signature), batch_size=batch)
    check_env_specs(env)
    rollout = env.rollout(3)
    assert rollout["reference"].shape == (*batch, 3, 0)
    assert rollout["task_params"].shape == (*batch, 3, 0)


def test_a_period_earns_its_reward_less_its_effort(settle):
    plant = Pendulum()
    env = ControlEnv(plant, settle(plant.signature, price=0.7), dtype=torch.float64)
    rollout = env.rollout(4)
    for row in rollout:
        x = row["state"]
        for _ in range(5):
            x = rk4(plant, x, row["action"].double(), 0.01)
        # Ranges of 1 rad and 3 rad/s.
        paid = -(x[0] ** 2) - (x[1] / 3.0) ** 2 - 0.7 * row["action"].double() ** 2
        torch.testing.assert_close(row["next", "reward"].double(), paid, rtol=1e-5, atol=1e-6)


def test_inputs_cost_nothing_where_no_price_is_named():
    task = Tracking(Tras().signature, Step([[0.1, 0.0]]))
    rng = torch.Generator().manual_seed(0)
    x, x_next = torch.randn(2, 5, 6, generator=rng)
    params, t, stopped = task.sample(torch.Size((5,)), rng), torch.zeros(5, 1), torch.zeros(5, dtype=torch.bool)
    earned = task.earned(x, torch.ones(5, 2), x_next, params, t, stopped)
    assert torch.equal(earned, task.reward(x, x_next, params, t, stopped))
