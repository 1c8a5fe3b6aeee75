"""Sparse models of controlled systems, identified from transitions."""

from dynasindy.sindy.fit_report import FitReport
from dynasindy.sindy.functions import register_function
from dynasindy.sindy.learned_reward import LearnedReward
from dynasindy.sindy.library import Library
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.named_libraries import build_library
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.sindy.world_model import Oracle, WorldModel

__all__ = [
    "FitReport",
    "LearnedReward",
    "Library",
    "Oracle",
    "Refinement",
    "Regression",
    "SindyModel",
    "WorldModel",
    "build_library",
    "register_function",
]
