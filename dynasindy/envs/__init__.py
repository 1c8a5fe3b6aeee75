"""The environment around a system and a task."""

from dynasindy.envs.control_env import ControlEnv
from dynasindy.envs.foreign import Foreign, GymnasiumEnv
from dynasindy.envs.late import LateEnv

__all__ = ["ControlEnv", "Foreign", "GymnasiumEnv", "LateEnv"]
