"""A recipe of a training that takes no time, and what is heard of one."""

import copy
from functools import partial

from dynasindy.agents import TD3, DynaReplay
from dynasindy.dyna.callback import Callback, Place
from dynasindy.dyna.experiment import LoopSettings, Recipe
from dynasindy.dyna.loop import train
from dynasindy.envs import Chirp, ControlEnv, RandomStep, Tracking
from dynasindy.planning import Gate, ImaginedReplay
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
        "planning": partial(ImaginedReplay, rollouts=0, every=10**6),
        "gate": Gate(),
        "train": LoopSettings(1),
    }
    return Recipe(**(own | given))


class Heard(Callback):
    """Keep the excitation and the episodes of a run, and the state of its parts, if given, at each place."""

    def __init__(self, parts=None):
        self.parts, self.excited, self.episodes, self.states = parts, None, [], []

    def fitted(self, report, excited, place):
        self.excited = excited

    def episode(self, episode, place):
        self.episodes.append(episode)

    def reached(self, place):
        if self.parts is not None:
            self.states.append(copy.deepcopy((place.state_dict(), self.parts.state_dict())))


def resumed(made, where, state):
    """Return the parts of a run that goes on to its end from a place that was kept."""
    parts, place = made.build(), Place()
    parts.load_state_dict(state)
    place.load_state_dict(where)
    train(parts, made.train, Callback(), place)
    return parts
