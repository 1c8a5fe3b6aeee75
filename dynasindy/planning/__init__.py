"""Planning, in Dyna's sense: learning from imagined experience."""

from dynasindy.planning.gate import Gate, ModelError, replay_error
from dynasindy.planning.gradient_planning import GradientPlanning
from dynasindy.planning.imagined_replay import Imagination, ImaginedReplay, Planned, Planner

__all__ = [
    "Gate",
    "GradientPlanning",
    "Imagination",
    "ImaginedReplay",
    "ModelError",
    "Planned",
    "Planner",
    "replay_error",
]
