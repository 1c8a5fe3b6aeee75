"""Planning, in Dyna's sense: learning from imagined experience."""

from dynasindy.planning.base import Planned, Planner
from dynasindy.planning.imagine import Imagination
from dynasindy.planning.prediction import ModelPrediction
from dynasindy.planning.replayed import ImaginedReplay, NoPlanning
from dynasindy.planning.trust import Gate, ModelError, replay_error

__all__ = [
    "Gate",
    "ImaginedReplay",
    "Imagination",
    "ModelError",
    "ModelPrediction",
    "NoPlanning",
    "Planned",
    "Planner",
    "replay_error",
]
