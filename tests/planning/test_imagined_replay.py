import math
from functools import cache

import pytest
import torch

from dynasindy.agents import TD3
from dynasindy.data import DynaReplay
from dynasindy.envs import ControlEnv
from dynasindy.planning import ImaginedReplay, NoPlanning, Planned, imagined_replay
from dynasindy.planning.imagined_replay import _schedule
from dynasindy.systems import Diverged, Tras
from dynasindy.tasks import RandomStep, Tracking

PLANT = Tras()
ENV = ControlEnv(PLANT, Tracking(PLANT.signature, RandomStep([-0.5, -0.5], [0.5, 0.4])))


@cache
def flown():
    with torch.no_grad():
        return ENV.rollout(60, TD3(ENV.task.n_o, 2, hidden=(8,)).explore)


def make(**settings):
    agent, replay = TD3(ENV.task.n_o, 2, hidden=(8,)), DynaReplay(5000, 32)
    replay.extend_real(flown().clone())
    return replay, ImaginedReplay(ENV, agent, replay, **settings), agent


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


def test_what_lies_beyond_the_states_of_the_plant_is_not_stored():
    _, planner, _ = make(rollouts=12, horizon=5, state_bound=1e-9)
    assert planner.plan().imagined == 0
    _, planner, _ = make(rollouts=12, horizon=5, state_bound=1e9)
    assert planner.plan().imagined == 60


def test_the_limit_is_so_many_times_the_largest_state_that_a_period_ended_in():
    replay, planner, _ = make(rollouts=12, horizon=5, state_bound=2.5)
    planner.plan()
    largest = replay.real_in_order()["next", "state"].abs().amax(0)
    torch.testing.assert_close(planner.imagination.limit, 2.5 * largest)


@pytest.mark.parametrize("wrong", [0.0, -1.0, torch.nan])
def test_a_bound_that_is_not_positive_is_refused(wrong):
    with pytest.raises(ValueError, match="state_bound"):
        make(rollouts=1, horizon=1, state_bound=wrong)


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


def starts_of(replay, rows=slice(None)):
    return replay.model[:]["observation"][rows, :6]


@pytest.mark.parametrize(("recent_steps", "newest"), [(1, 1), (4, 4), (None, 60), (500, 60)])
def test_branches_begin_at_every_one_of_the_newest_states_and_at_no_other(recent_steps, newest):
    replay, planner, _ = make(rollouts=600, horizon=1, recent_steps=recent_steps)
    planner.plan()
    real = replay.real_in_order()["observation"][:, :6]
    same = (starts_of(replay).unsqueeze(1) == real).all(-1)
    assert same.any(0).nonzero().flatten().tolist() == [*range(60 - newest, 60)]
    # Each as often as any other: the counts of 600 draws deviate by the root of their mean.
    assert float((same.sum(0)[-newest:] - 600 / newest).abs().max()) <= 5 * (600 / newest) ** 0.5


def test_the_seed_of_the_planner_chooses_the_starts_and_nothing_else_does():
    chosen = []
    for seed, drawn_elsewhere in ((3, 0), (3, 7), (4, 0)):
        replay, planner, _ = make(rollouts=20, horizon=1, seed=seed)
        torch.rand(drawn_elsewhere)
        planner.plan()
        chosen.append(starts_of(replay))
    assert torch.equal(chosen[0], chosen[1]) and not torch.equal(chosen[0], chosen[2])


def test_cut_rollouts_are_counted_as_stored_and_evicted_as_counted(monkeypatch):
    replay, planner, _ = make(rollouts=12, horizon=5, generations=3)
    kept = iter([3, 4, 1, 2, 5, 5])

    def first(finite):
        believed = (torch.arange(5) < next(kept)).expand(finite.shape)
        return believed, believed & ~torch.cat([believed[:, 1:], torch.zeros_like(believed[:, :1])], -1)

    monkeypatch.setattr(imagined_replay, "_kept", first)
    found = []
    for _ in range(4):
        found.append((planner.plan().imagined, len(replay.model)))
    # 12 rollouts of 3, 4, 1 and 2 steps; of four phases the newest three stay.
    assert found == [(36, 36), (48, 84), (12, 96), (24, 84)] and planner.made == [36, 48, 12, 24]
    planner.distrust()
    assert len(replay.model) == 0
    assert [(planner.plan().imagined, len(replay.model)) for _ in range(2)] == [(60, 60), (60, 120)]


def test_the_first_horizon_holds_until_a_phase_counts():
    _, planner, _ = make(rollouts=0, horizon=[2, 8, 4])
    assert [planner.plan().imagined for _ in range(3)] == [0, 0, 0] and planner.made == []
    assert [planner.horizons(phase) for phase in range(6)] == [2, 4, 6, 8, 8, 8]
    assert planner.imagination.horizon == 2


@pytest.mark.parametrize(("horizon", "grown"), [([9, 3, 1], [9, 3, 3]), ([9, 3, 5], [9, 8, 3]), (7, [7, 7, 7])])
def test_a_horizon_may_shrink_and_stays_at_its_end(horizon, grown):
    assert [_schedule(horizon)(phase) for phase in (0, 1, 5)] == grown


@pytest.mark.parametrize("fine", [{"rollouts": 0}, {"generations": 1}, {"recent_steps": 1}, {"horizon": [1, 1, 1]}])
def test_the_smallest_plans_are_allowed(fine):
    assert make(**({"rollouts": 1, "horizon": 1} | fine))[1].plan().imagined <= 1


def test_by_default_four_hundred_rollouts_of_a_hundred_periods_are_kept_for_five_phases():
    _, planner, _ = make()
    assert (planner.rollouts, planner.horizons(0), planner.every, planner.generations) == (400, 100, 1, 5)
    assert planner.state_bound == 1.5 and planner.recent_steps is None


def test_no_planning_costs_nothing():
    planner = NoPlanning()
    assert planner.plan() == Planned(0, 0) and planner.distrust() is None and planner.learns_by_td3


def test_the_memory_of_the_rollouts_is_that_of_what_a_step_writes(monkeypatch):
    sizes = []
    monkeypatch.setattr(imagined_replay, "check_memory", lambda size, what: sizes.append(size))
    make(rollouts=12, horizon=[2, 5, 3])
    rows = ENV.rollout(60)
    parts = [rows[key] for key in ("observation", "state", ("next", "observation"), ("next", "state"))]
    written = sum(part.numel() for part in (*parts, rows["next", "samples"])) / 60
    assert sizes == [4 * 12 * 5 * written]
