"""Dyna-style reinforcement learning with identified SINDy world models, built on TorchRL.

Importing the package imports no heavy library; each subpackage imports what it needs. It registers the
Gymnasium environments `dynasindy/TwinRotor-v0` and `dynasindy/Pendulum-v0` by name.
"""

import os

import gymnasium

__all__ = ["__version__"]

__version__ = "0.1.0"

os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # torchrl reads it when it is imported, and chats at INFO

# Entry points as text: torch is imported when such an environment is made, not here.
gymnasium.register("dynasindy/TwinRotor-v0", entry_point="dynasindy.envs.gym:twin_rotor")
gymnasium.register("dynasindy/Pendulum-v0", entry_point="dynasindy.envs.gym:pendulum")
