"""Policies: the TD3 agent, its networks, its exploration noise and its replay."""

from dynasindy.agents.loss import TD3Loss
from dynasindy.agents.networks import MLP, Actor, actor
from dynasindy.agents.replay import LEARN_KEYS, MEASURED_KEYS, REAL_KEYS, DynaReplay
from dynasindy.agents.td3 import TD3, DecayingGaussian, Hyperparameters

__all__ = [
    "LEARN_KEYS",
    "MEASURED_KEYS",
    "MLP",
    "REAL_KEYS",
    "TD3",
    "Actor",
    "DecayingGaussian",
    "DynaReplay",
    "Hyperparameters",
    "TD3Loss",
    "actor",
]
