"""The environment around a system and a task."""

from dynasindy.envs.control_env import ControlEnv
from dynasindy.envs.foreign import Foreign, GymnasiumEnv

__all__ = [
    "ControlEnv",
    "Foreign",
    "GymnasiumEnv",
]
