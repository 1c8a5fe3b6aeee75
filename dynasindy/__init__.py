"""Dyna-style reinforcement learning with identified SINDy world models, built on TorchRL.

Importing the package imports no heavy library; each subpackage imports what it needs. It registers the
Gymnasium environments `dynasindy/TwinRotor-v0` and `dynasindy/Pendulum-v0` by name.
"""

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynasindy.control import Controller as Controller
    from dynasindy.control import load as load
    from dynasindy.identification.identify import identify as identify
    from dynasindy.identification.identify import read as read
    from dynasindy.progress import Progress as Progress
    from dynasindy.simulation import excite as excite
    from dynasindy.simulation import simulate as simulate
    from dynasindy.workbench import forecast as forecast
    from dynasindy.workbench import plan as plan

_PLACES = {
    "Controller": "dynasindy.control",
    "load": "dynasindy.control",
    "Progress": "dynasindy.progress",
    "excite": "dynasindy.simulation",
    "forecast": "dynasindy.workbench",
    "identify": "dynasindy.identification.identify",
    "plan": "dynasindy.workbench",
    "read": "dynasindy.identification.identify",
    "simulate": "dynasindy.simulation",
}
__all__ = ["__version__", *_PLACES]
__version__ = "0.1.0"

os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # torchrl reads it when it is imported, and chats at INFO


_EPISODE = 400
"""Control periods of an episode (paper: 400)."""


def _register() -> None:
    """Register our environments; entry points are text, as torch is imported when such an environment is made."""
    import gymnasium

    for name, entry_point in (("TwinRotor", "twin_rotor"), ("Pendulum", "pendulum")):
        gymnasium.register(
            f"dynasindy/{name}-v0",
            entry_point=f"dynasindy.envs.gym:{entry_point}",
            max_episode_steps=_EPISODE,
        )


class _Gymnasium:
    """Finder of Gymnasium, which has our environments once it is imported: that takes longer than all the rest here."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return where Gymnasium lies, with the registration behind its import; nothing of other modules."""
        spec = PathFinder.find_spec(name, path) if name == "gymnasium" else None
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            execute(module)
            _register()

        spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec


if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _Gymnasium)


def __dir__() -> list[str]:
    """Return the public names, which `dir` lists."""
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Import what is asked for, so that the package itself imports in no time.

    Raises:
        AttributeError: The package has nothing of that name.
    """
    if name not in _PLACES:
        raise AttributeError(f"module 'dynasindy' has no attribute '{name}'; it has {', '.join(__all__)}")
    return getattr(import_module(_PLACES[name]), name)
