"""Planning, in Dyna's sense: learning from imagined experience."""

from dynasindy.planning.base import Planned, Planner
from dynasindy.planning.gradient import GradientPlanning
from dynasindy.planning.imagine import Imagination
from dynasindy.planning.prediction import ModelPrediction
from dynasindy.planning.replayed import ImaginedReplay, NoPlanning
from dynasindy.planning.trust import Gate, ModelError, replay_error
from dynasindy.planning.variation import Variation, Varied

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
    "Variation",
    "Varied",
    "replay_error",
]
