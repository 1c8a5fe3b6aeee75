"""Dyna-style reinforcement learning with identified SINDy world models, built on TorchRL.

Importing the package imports no heavy library; each subpackage imports what it needs. It registers the
Gymnasium environments `dynasindy/TwinRotor-v0` and `dynasindy/Pendulum-v0` by name.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from dynasindy.control import Controller, load
    from dynasindy.progress import Progress
    from dynasindy.workbench import forecast, identify, plan, read

__all__ = ["Controller", "Progress", "__version__", "forecast", "identify", "load", "plan", "read"]

__version__ = "0.1.0"

os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # torchrl reads it when it is imported, and chats at INFO

# Entry points as text: torch is imported when such an environment is made, not here.
gymnasium.register("dynasindy/TwinRotor-v0", entry_point="dynasindy.envs.gym:twin_rotor")
gymnasium.register("dynasindy/Pendulum-v0", entry_point="dynasindy.envs.gym:pendulum")

_PLACES = {
    "Controller": "dynasindy.control",
    "load": "dynasindy.control",
    "Progress": "dynasindy.progress",
    "forecast": "dynasindy.workbench",
    "identify": "dynasindy.workbench",
    "plan": "dynasindy.workbench",
    "read": "dynasindy.workbench",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for, so that the package itself imports in no time.

    Raises:
        AttributeError: The package has nothing of that name.
    """
    if name not in _PLACES:
        raise AttributeError(f"module 'dynasindy' has no attribute '{name}'; it has {', '.join(__all__)}")
    return getattr(import_module(_PLACES[name]), name)
