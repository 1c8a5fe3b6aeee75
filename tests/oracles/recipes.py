"""A recipe of a training that takes no time."""

from functools import partial

from dynasindy.agents import TD3, DynaReplay
from dynasindy.dyna.experiment import LoopSettings, Recipe
from dynasindy.envs import Chirp, ControlEnv, RandomStep, Tracking
from dynasindy.planning import Gate, NoPlanning
from dynasindy.sindy import Oracle
from dynasindy.systems import Tras


def make_recipe(plant=None, steps=20, **given):
    """Return a recipe of a twin rotor whose model is the plant, with what is given in place of its own."""
    plant = plant or Tras()
    own = {
        "system": plant,
        "task": partial(Tracking, reference=RandomStep([-0.5, -0.5], [0.5, 0.4]), max_steps=steps),
        "env": ControlEnv,
        "excitation": partial(Chirp, duration=1.0),
        "world_model": partial(Oracle, system=plant),
        "agent": partial(TD3, hidden=(8,)),
        "replay": partial(DynaReplay, 1000, 16),
        "planning": NoPlanning,
        "gate": Gate(),
        "train": LoopSettings(1),
    }
    return Recipe(**(own | given))
