"""How imagined episodes go on: those that begin anew are of other strengths, the others of the same."""

import torch

from dynasindy.agents import TD3
from dynasindy.planning import GradientPlanning
from dynasindy.planning.episodes import Episodes, references
from dynasindy.planning.margin import Margin


def planner_of(env):
    agent = TD3(env.task.n_o, 1, hidden=(8, 8), seed=0)
    return GradientPlanning(env, agent, rollouts=16, window=10, updates=2, seed=3)


def test_an_episode_keeps_its_strength_until_it_begins_anew(inverted):
    env, rests = inverted()
    planner = planner_of(env)
    episodes = Episodes(planner)
    assert episodes.rows.strength is None
    episodes.vary(Margin.of(planner.env, rests, 0.1))
    before = episodes.rows.strength
    lost = torch.arange(16) < 5
    episodes.end = torch.full((16, 1), torch.inf)
    episodes.carry_on(episodes.rows.x, episodes.rows.held, ~lost)
    after = episodes.rows.strength
    assert torch.equal(after.factor[5:], before.factor[5:]) and torch.equal(after.rest[5:], before.rest[5:])
    assert bool((after.factor[:5] != before.factor[:5]).all())
    # The new ones rest where their own targets do.
    rest = Margin.of(planner.env, rests, 0.1).ends(episodes.rows.params).rest
    assert torch.equal(after.rest, rest)


def test_references_begin_as_the_task_does(inverted):
    env, _ = inverted()
    rows = references(env, 32, torch.Generator().manual_seed(0))
    assert rows.x.shape == (32, 2) and not rows.held.any() and not rows.t.any()
    targets = env.task.reference(rows.params, rows.t)
    assert targets.abs().max() <= 0.4 + 1e-6 and targets.std() > 0.1
