import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from dynasindy.envs import ControlEnv
from dynasindy.planning import ModelPrediction
from dynasindy.systems import Tras, Xi
from dynasindy.tasks import Step, Tracking


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
