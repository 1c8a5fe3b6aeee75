"""The order of Algorithm 1, recorded with fakes, and the whole loop on the true plant."""

import json
from functools import partial

import torch
from recipes import make_recipe
from torchrl.envs.utils import exploration_type

from dynasindy.agents import TD3
from dynasindy.dyna.callback import Callback, Place
from dynasindy.dyna.loop import LoopSettings, train
from dynasindy.dyna.refit import Refit
from dynasindy.envs import Chirp
from dynasindy.planning import Gate, ImaginedReplay, Planned, Planner
from dynasindy.sindy import Oracle
from dynasindy.systems import Tras, Xi


class Recording(Planner):
    """Write down what happens, in order."""

    def __init__(self, log, every=2, **parts):
        super().__init__(every)
        self.log = log

    def plan(self):
        self.log.append("plan")
        return Planned(imagined=7)

    def distrust(self):
        self.log.append("distrust")


def recipe(planning, gate=None, seed=0, model=None, **settings):
    log = []
    plant = Tras()

    class Model(Oracle):
        def fit(self, transitions):
            log.append(f"fit {len(transitions)}")

    class Agent(TD3):
        def update(self, batch):
            log.append("update")
            return super().update(batch)

    return log, make_recipe(
        plant,
        steps=6,
        excitation=partial(Chirp, duration=0.25),
        world_model=lambda signature: Model(signature, model or plant),
        agent=partial(Agent, hidden=(8,)),
        planning=lambda **parts: planning(log=log, **parts),
        gate=gate or Gate(),
        train=LoopSettings(**({"episodes": 2, "updates_per_step": 0.5} | settings)),
        seed=seed,
    )


class Listener(Callback):
    def __init__(self, log):
        self.log, self.episodes = log, []

    def fitted(self, report, excited, cost):
        self.log.append(f"fitted after {cost.real_steps}")

    def episode(self, episode, cost):
        self.episodes.append(episode)
        self.log.append(
            f"episode {episode.number}: {cost.real_steps} real, {cost.imagined} imagined, {cost.updates} updates"
        )


def test_the_phases_come_in_the_order_of_algorithm_1():
    log, made = recipe(Recording)
    listener = Listener(log)
    train(made.build(), made.train, listener)
    assert [(episode.trusted, type(episode.refit)) for episode in listener.episodes] == [
        (True, type(None)),
        (True, Refit),
    ]
    assert log == [
        "fit 25",  # the excitation: 5 control periods of 5 samples, model learning
        "fitted after 5",
        "plan",
        *["update"] * 3,  # policy learning of 0.5 updates for each of 6 steps
        "episode 1: 11 real, 7 imagined, 3 updates",
        *["update"] * 3,
        "fit 85",  # planning after every second episode, on all real transitions
        "plan",
        "episode 2: 17 real, 14 imagined, 6 updates",
    ]


def test_a_closed_gate_lets_nothing_in():
    # The paper's plant is no model of this one: its reward error never falls to 0, so a shut gate stays shut.
    log, made = recipe(Recording, gate=Gate(0.0, 0.0, is_open=False), model=Xi())
    train(made.build(), made.train, Callback())
    assert log[-1] == "distrust" and log.count("plan") == 1


def test_no_planning_neither_plans_nor_fits_again():
    log, made = recipe(lambda log, **parts: ImaginedReplay(rollouts=0, every=10**6, **parts))
    parts = made.build()
    train(parts, made.train, Callback())
    assert [entry for entry in log if entry.startswith("fit")] == ["fit 25"]
    assert len(parts.replay.model) == 0


def test_the_same_seed_gives_the_same_run_and_another_does_not():
    def weights(seed):
        _, made = recipe(lambda log, **parts: ImaginedReplay(rollouts=4, horizon=3, **parts), seed=seed)
        return torch.cat([p.flatten() for p in train(made.build(), made.train, Callback()).parameters()])

    assert torch.equal(weights(1), weights(1))
    assert not torch.equal(weights(1), weights(2))


def test_the_global_exploration_type_is_left_alone():
    before = exploration_type()
    _, made = recipe(Recording)
    train(made.build(), made.train, Callback())
    assert exploration_type() == before


def test_a_place_that_is_restored_is_the_same_place_and_the_same_cost():
    here = Place(9, 3000, 20, 5)
    other = Place()
    other.load_state_dict(json.loads(json.dumps(here.state_dict())))
    assert other == here and here.episodes == 7
    other.add(Planned(imagined=1, updates=2))
    assert (other.imagined, other.updates) == (21, 7) and here.updates == 5
