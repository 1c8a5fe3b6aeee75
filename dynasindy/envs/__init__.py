"""The environment around a system, its task (references, reward, initial states), its sensors and its excitation.

What needs TorchRL is imported where it is asked for: a log is identified without.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dynasindy.envs.references import RandomStep, Reference, Step, Wave, target, wave
from dynasindy.envs.reward import TrackingReward
from dynasindy.envs.sensors import Channel, Sensors
from dynasindy.envs.task import Task, Tracking

if TYPE_CHECKING:
    from dynasindy.envs.control_env import ControlEnv
    from dynasindy.envs.excitation import Aprbs, Chirp, Excitation, Multisine
    from dynasindy.envs.gym import Foreign, GymnasiumEnv

__all__ = [
    "Aprbs",
    "Channel",
    "Chirp",
    "ControlEnv",
    "Excitation",
    "Foreign",
    "GymnasiumEnv",
    "Multisine",
    "RandomStep",
    "Reference",
    "Sensors",
    "Step",
    "Task",
    "Tracking",
    "TrackingReward",
    "Wave",
    "target",
    "wave",
]


def __getattr__(name: str) -> Any:
    """Import what needs TorchRL.

    Raises:
        AttributeError: The package has nothing of that name.
    """
    if name not in __all__:
        raise AttributeError(f"module 'dynasindy.envs' has no attribute '{name}'; it has {', '.join(__all__)}")
    module = {"ControlEnv": "control_env", "Foreign": "gym", "GymnasiumEnv": "gym"}.get(name, "excitation")
    return getattr(import_module(f"dynasindy.envs.{module}"), name)
