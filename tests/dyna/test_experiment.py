from dataclasses import replace
from functools import partial

import pytest
import torch

from dynasindy.agents import TD3, DynaReplay
from dynasindy.dyna import experiment
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.loop import LoopSettings
from dynasindy.envs import Chirp, ControlEnv, RandomStep, Tracking
from dynasindy.planning import Gate, NoPlanning
from dynasindy.sindy import Oracle
from dynasindy.systems import Tras


def recipe(seed=0):
    return Recipe(
        system=Tras(azimuth_stop=2.0),
        task=partial(Tracking, reference=RandomStep([-0.5, -0.5], [0.5, 0.4])),
        env=partial(ControlEnv, dtype=torch.float64),
        excitation=Chirp,
        world_model=partial(Oracle, system=Tras(azimuth_stop=2.0)),
        agent=partial(TD3, hidden=(8,)),
        replay=partial(DynaReplay, 1000, 16),
        planning=NoPlanning,
        gate=Gate(),
        train=LoopSettings(1),
        seed=seed,
    )


def weights(parts):
    return torch.cat([p.flatten() for p in parts.agent.deployed.parameters()])


def test_one_seed_decides_everything():
    one, same, other = recipe(1).build(), recipe(1).build(), recipe(2).build()
    assert torch.equal(weights(one), weights(same)) and not torch.equal(weights(one), weights(other))
    assert torch.equal(one.env.reset()["reference"], same.env.reset()["reference"])
    assert not torch.equal(one.env.reset()["reference"], other.env.reset()["reference"])


def test_imagined_and_real_environment_share_task_and_stops():
    parts = recipe().build()
    assert parts.model_env.task is parts.plant.task
    assert parts.model_env.stops is parts.plant.system.stops
    assert parts.model_env.float_type == torch.float32 and parts.plant.float_type == torch.float64


def test_every_part_draws_from_a_seed_of_its_own():
    given = {}

    def planning(**parts):
        given.update(parts)
        return NoPlanning()

    def agent(**settings):
        given["agent_seed"] = settings["seed"]
        return TD3(**settings, hidden=(8,))

    parts = replace(recipe(3), planning=planning, agent=agent).build()
    seeds = [parts.plant.rng.initial_seed(), parts.model_env.rng.initial_seed(), parts.replay.generator.initial_seed()]
    seeds += [given["seed"], given["agent_seed"]]
    assert len(set(seeds)) == 5
    assert given["env"] is parts.model_env and given["agent"] is parts.agent and given["replay"] is parts.replay


def test_the_parts_fit_each_other():
    parts = recipe().build()
    assert parts.env is parts.plant and parts.sensing is None
    assert parts.excitation.dt == parts.plant.dt and parts.agent.deployed is not None


@pytest.mark.parametrize("substeps", [1, 3])
def test_the_memory_of_the_storages_is_that_of_their_full_rows(monkeypatch, substeps):
    sizes = []
    monkeypatch.setattr(experiment, "check_memory", lambda size, what: sizes.append(size))
    env = partial(ControlEnv, dtype=torch.float64, substeps=substeps)
    parts = replace(recipe(), env=env, replay=partial(DynaReplay, 1000, 16, model_capacity=300)).build()
    n_o = parts.plant.task.n_o
    # Two observations, two inputs and a reward, of four bytes; state, next state and samples of six, of eight bytes.
    assert sizes == [(1000 + 300 + 16) * 4 * (n_o + n_o + 2 + 1) + 1000 * 8 * 6 * (1 + 1 + substeps)]
