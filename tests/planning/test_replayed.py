import pytest
import torch

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.envs import ControlEnv
from dynasindy.planning import ImaginedReplay, NoPlanning
from dynasindy.systems import Tras
from dynasindy.tasks import RandomStep, Tracking


def make(**settings):
    plant = Tras()
    env = ControlEnv(plant, Tracking(plant.signature, RandomStep([-0.5, -0.5], [0.5, 0.4])))
    agent = TD3(env.task.n_o, 2, hidden=(8,))
    replay = DynaReplay(5000, 32)
    with torch.no_grad():
        replay.extend_real(env.rollout(60, agent.explore))
    return replay, ImaginedReplay(env, agent, replay, **settings), agent


def test_rollouts_times_horizon_are_stored_and_counted():
    replay, planner, _ = make(rollouts=12, horizon=5)
    assert planner.plan().imagined == len(replay.model) == 60


def test_what_older_models_imagined_is_evicted_or_kept():
    for evict, stored in ((True, 60), (False, 120)):
        replay, planner, _ = make(rollouts=12, horizon=5, evict=evict)
        planner.plan()
        planner.plan()
        assert len(replay.model) == stored


def test_distrust_empties_the_model_storage_only():
    replay, planner, _ = make(rollouts=12, horizon=5)
    planner.plan()
    planner.distrust()
    assert len(replay.model) == 0 and len(replay.real) == 60


def test_no_rollouts_leave_the_model_storage_empty():
    replay, planner, _ = make(rollouts=0)
    assert planner.plan().imagined == 0 and len(replay.model) == 0
    assert len(replay.sample()) == 32


def test_imagining_does_not_use_up_the_exploration_noise():
    _, planner, agent = make(rollouts=12, horizon=5)
    sigma = agent.noise.sigma
    planner.plan()
    assert agent.noise.sigma == sigma


def test_branches_begin_at_real_states():
    replay, planner, _ = make(rollouts=40, horizon=1)
    planner.plan()
    real = replay.real[:]["observation"][:, :6]
    starts = replay.model[:]["observation"][:, :6]
    assert (starts.unsqueeze(1) == real).all(-1).any(-1).all()


def test_no_planning_is_never_due():
    planner = NoPlanning(env=None, agent=None)
    assert not any(planner.due(episode) for episode in range(1, 10))


@pytest.mark.parametrize("settings", [{"rollouts": -1}, {"every": 0}, {"horizon": 0}, {"reach": 0.0}])
def test_impossible_plans_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        make(**settings)
