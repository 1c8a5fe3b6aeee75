"""Sparse models of controlled systems, identified from transitions."""

from dynasindy.world_models.libraries import build_library
from dynasindy.world_models.libraries.functions import register_function
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.models.base import WorldModel
from dynasindy.world_models.models.oracle import Oracle
from dynasindy.world_models.models.own_reward import OwnReward
from dynasindy.world_models.models.report import FitReport
from dynasindy.world_models.models.sindy import SindyModel
from dynasindy.world_models.refinement.refine import Refinement
from dynasindy.world_models.regression.regression import Regression

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
