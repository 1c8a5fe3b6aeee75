"""Planning, in Dyna's sense: learning from imagined experience."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynasindy.planning.gate import Gate, ModelError, ModelPrediction, replay_error
    from dynasindy.planning.gradient_planning import GradientPlanning
    from dynasindy.planning.imagined_replay import Imagination, ImaginedReplay, NoPlanning, Planned, Planner
    from dynasindy.planning.randomization import Randomization, RandomizedSystem

_PLACES = {
    **dict.fromkeys(("Gate", "ModelError", "ModelPrediction", "replay_error"), "gate"),
    "GradientPlanning": "gradient_planning",
    **dict.fromkeys(("Imagination", "ImaginedReplay", "NoPlanning", "Planned", "Planner"), "imagined_replay"),
    **dict.fromkeys(("Randomization", "RandomizedSystem"), "randomization"),
}
__all__ = [
    "Gate",
    "GradientPlanning",
    "Imagination",
    "ImaginedReplay",
    "ModelError",
    "ModelPrediction",
    "NoPlanning",
    "Planned",
    "Planner",
    "Randomization",
    "RandomizedSystem",
    "replay_error",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for: equilibria, by which a fit is judged, need no TorchRL.

    Raises:
        AttributeError: There is nothing of that name.
    """
    if name not in _PLACES:
        raise AttributeError(f"module 'dynasindy.planning' has no attribute '{name}'; it has {', '.join(__all__)}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
