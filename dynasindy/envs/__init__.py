"""The environment around a system and a task."""

from dynasindy.envs.control_env import ControlEnv
from dynasindy.envs.foreign import Foreign, GymnasiumEnv
from dynasindy.envs.input_delay import DelayedEnv

__all__ = [
    "ControlEnv",
    "DelayedEnv",
    "Foreign",
    "GymnasiumEnv",
]
