"""Planning, in Dyna's sense: learning from imagined experience."""

from dynasindy.planning.gate import Gate, ModelError, replay_error
from dynasindy.planning.gradient_planning import GradientPlanning
from dynasindy.planning.imagined_replay import ImaginedReplay, NoPlanning, Planned, Planner, imagine_transitions

__all__ = [
    "Gate",
    "GradientPlanning",
    "ImaginedReplay",
    "ModelError",
    "NoPlanning",
    "Planned",
    "Planner",
    "imagine_transitions",
    "replay_error",
]
