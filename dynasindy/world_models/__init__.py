"""Sparse models of controlled systems, identified from transitions."""

from dynasindy.world_models.base import WorldModel
from dynasindy.world_models.functions import register_function
from dynasindy.world_models.libraries import build_library
from dynasindy.world_models.library import Library
from dynasindy.world_models.oracle import Oracle
from dynasindy.world_models.own_reward import OwnReward
from dynasindy.world_models.refine import Refinement
from dynasindy.world_models.regression import Regression
from dynasindy.world_models.report import FitReport
from dynasindy.world_models.sindy import SindyModel

__all__ = [
    "FitReport",
    "Library",
    "Oracle",
    "OwnReward",
    "Refinement",
    "Regression",
    "SindyModel",
    "WorldModel",
    "build_library",
    "register_function",
]
