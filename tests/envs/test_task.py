import pytest
import torch
from torchrl.envs import check_env_specs

from dynasindy.envs import ControlEnv
from dynasindy.systems import Pendulum, rk4


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
