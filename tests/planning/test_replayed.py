import math

import pytest
import torch

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.envs import ControlEnv
from dynasindy.planning import Bounds, ImaginedReplay, NoPlanning
from dynasindy.systems import Diverged, Tras
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
    for generations, stored in ((1, [60, 60, 60]), (2, [60, 120, 120]), (None, [60, 120, 180])):
        replay, planner, _ = make(rollouts=12, horizon=5, generations=generations)
        found = []
        for _ in stored:
            planner.plan()
            found.append(len(replay.model))
        assert found == stored


def test_the_newest_generations_are_the_ones_that_stay():
    replay, planner, _ = make(rollouts=12, horizon=5, generations=2)
    planner.plan()
    planner.plan()
    before = replay.model[:].clone()
    planner.plan()
    assert torch.equal(replay.model[:]["action"][:60], before["action"][60:])


def test_the_horizon_grows_over_the_phases_and_stays():
    _, planner, _ = make(rollouts=2, horizon=[1, 7, 4])
    assert [planner.plan().imagined for _ in range(6)] == [2, 6, 10, 14, 14, 14]


def test_distrust_does_not_set_the_horizon_back():
    _, planner, _ = make(rollouts=2, horizon=[1, 7, 4])
    planner.plan()
    planner.distrust()
    assert planner.plan().imagined == 6


def test_branches_may_be_limited_to_recent_states():
    replay, planner, _ = make(rollouts=40, horizon=1, recent_steps=3)
    planner.plan()
    recent = replay.real_in_order()["observation"][-3:, :6]
    starts = replay.model[:]["observation"][:, :6]
    assert (starts.unsqueeze(1) == recent).all(-1).any(-1).all()


def test_what_lies_far_from_the_data_is_not_stored():
    _, planner, _ = make(rollouts=12, horizon=5, bounds=Bounds(distance=1e-9))
    # Exploring actions differ from the real ones, so even the first steps are far.
    assert planner.plan().imagined == 0
    _, planner, _ = make(rollouts=12, horizon=5, bounds=Bounds(distance=100.0))
    assert planner.plan().imagined == 60


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


IMPOSSIBLE = [{"rollouts": -1}, {"every": 0}, {"horizon": 0}, {"horizon": [1, 0, 3]}]
IMPOSSIBLE += [{"generations": 0}, {"recent_steps": 0}]


@pytest.mark.parametrize("settings", IMPOSSIBLE)
def test_impossible_plans_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        make(**settings)


class Nowhere(Tras):
    """A model that is nowhere from where the pitch is above a limit."""

    def __init__(self, limit):
        super().__init__()
        self.limit = limit

    def forward(self, x, u):
        return torch.where(x[..., 1:2] > self.limit, math.nan, super().forward(x, u))


def test_a_phase_in_which_every_rollout_diverges_at_once_is_told():
    replay, planner, _ = make(rollouts=12, horizon=5)
    pitches = replay.real_in_order()["state"][:, 1]
    planner.imagination.env = planner.env.with_system(Nowhere(-math.inf))
    with pytest.raises(Diverged, match=r"planning by imagined replay: all 12 rollouts.*first control period"):
        planner.plan()
    assert not len(replay.model)
    # Where the model is sound at some real states, their rollouts are stored.
    planner.imagination.env = planner.env.with_system(Nowhere(pitches.median().item()))
    assert 0 < planner.plan().imagined < 60
    assert 0 < planner.imagination.diverged < 12


def test_an_actor_without_finite_weights_is_not_laid_on_the_model():
    _, planner, agent = make(rollouts=12, horizon=5)
    with torch.no_grad():
        next(agent.policy.parameters()).fill_(math.nan)
    with pytest.raises(Diverged, match=r"weights of actor_network\S* are not finite"):
        planner.plan()


def test_rollouts_that_memory_cannot_hold_are_refused():
    with pytest.raises(ValueError, match=r"planning\.rollouts=1000000000 of planning\.horizon=100 periods would take"):
        make(rollouts=10**9, horizon=100)
