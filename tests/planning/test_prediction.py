import pytest
import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from dynasindy.envs import ControlEnv
from dynasindy.planning import ModelPrediction
from dynasindy.systems import Tras, Xi
from dynasindy.tasks import Step, Tracking, Wave


def predicted_by(model):
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Step([[0.1, 0.1]])), dtype=torch.float64)
    return TransformedEnv(env, ModelPrediction(env.with_system(model, torch.float32)))


def test_specs_hold():
    check_env_specs(predicted_by(Xi()))


def test_the_true_model_predicts_every_step_exactly():
    following = predicted_by(Tras()).rollout(20)["next"]
    assert torch.allclose(following["predicted_state"], following["state"])
    assert torch.allclose(following["predicted_reward"], following["reward"])


def test_another_model_errs_by_one_step_only():
    # Each prediction starts from the real state, so the error does not build up.
    following = predicted_by(Xi()).rollout(400)["next"]
    error = (following["predicted_state"] - following["state"])[:, 0].abs()
    assert 0 < error.max() < 0.1


def test_a_prediction_is_one_step_of_the_model_from_the_real_state_with_its_reward():
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, Wave([0.3, 0.2], [0.5, 0.4])), dtype=torch.float64)
    model_env = env.with_system(Xi())
    rollout = TransformedEnv(env, ModelPrediction(model_env)).rollout(5)
    for k in range(5):
        row = rollout[k]
        x = model_env.advance(row["state"], row["action"].double())[0][-1]
        t = torch.tensor([(k + 1) * 0.05]).double()
        reward = env.task.reward(row["state"], x, row["task_params"], t, torch.tensor(False))
        torch.testing.assert_close(row["next", "predicted_state"], x)
        assert row["next", "predicted_reward"].item() == pytest.approx(reward.item(), rel=1e-6)


def test_after_a_reset_the_predictions_repeat_what_is():
    env = predicted_by(Xi())
    env.base_env.task.initial_state = lambda batch, rng: torch.full((*batch, 6), 0.2)
    start = env.reset()
    assert start["predicted_state"].tolist() == start["state"].tolist() == [pytest.approx(0.2)] * 6
    assert start["predicted_reward"].tolist() == [0.0]
