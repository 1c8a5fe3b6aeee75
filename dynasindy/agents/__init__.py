"""Policies: the TD3 agent, its networks and its exploration noise."""

from dynasindy.agents.loss import TD3Loss
from dynasindy.agents.networks import MLP, Actor, actor, critic
from dynasindy.agents.noise import DecayingGaussian
from dynasindy.agents.td3 import TD3, Hyperparameters

__all__ = ["MLP", "TD3", "Actor", "DecayingGaussian", "Hyperparameters", "TD3Loss", "actor", "critic"]
