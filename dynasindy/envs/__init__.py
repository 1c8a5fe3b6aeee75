"""The environment around a system and a task."""

from dynasindy.envs.control_env import ControlEnv

__all__ = ["ControlEnv"]
