"""The model's one-step prediction beside every real step: the paper's reward-error curve."""

from __future__ import annotations

from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import Transform

from dynasindy.envs import ControlEnv


class ModelPrediction(Transform):
    """Transform of the real environment that writes what the model predicted for each step.

    It adds `predicted_state` and `predicted_reward`; their distance to `state` and `reward` in the next
    tensordict is the model's one-step error (paper, figure "SINDy Model Learning Progress"). After a reset both
    repeat what is: the state, and a reward of zero.

    Args:
        model_env: The same environment around the world model, `env.with_system(world_model)`.
    """

    def __init__(self, model_env: ControlEnv) -> None:
        super().__init__(in_keys=[], out_keys=["predicted_state", "predicted_reward"])
        self.__dict__["model_env"] = model_env  # not a part of the real environment

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        predicted = self.model_env._step(tensordict)
        next_tensordict["predicted_state"] = predicted["state"].to(next_tensordict["state"])
        next_tensordict["predicted_reward"] = predicted["reward"]
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        tensordict_reset["predicted_state"] = tensordict_reset["state"].clone()
        tensordict_reset["predicted_reward"] = tensordict_reset["observation"][..., :1] * 0
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the two predictions to the specs."""
        assert isinstance(observation_spec, Composite)
        batch = observation_spec.shape
        observation_spec["predicted_state"] = observation_spec["state"].clone()
        observation_spec["predicted_reward"] = Unbounded(shape=(*batch, 1))
        return observation_spec
