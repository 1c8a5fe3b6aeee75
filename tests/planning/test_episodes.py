"""How imagined episodes begin and go on, against shares and times by hand."""

import math

import pytest
import torch

from dynasindy.planning import GradientPlanning
from dynasindy.planning.gradient_planning import _Episodes


@torch.no_grad()
def flown(env, agent, steps=20):
    return env.rollout(steps, agent.policy)


def test_episodes_begin_staggered_and_anew_where_they_end_or_diverge(planned):
    planner = planned(real_starts=0.0, jumps=0.0, rollouts=500)
    episodes = _Episodes(planner)
    length = 60 * 0.05
    # The first ends lie evenly over an episode.
    assert episodes.end.min() < 0.05 * length and 0.95 * length < episodes.end.max() <= length
    assert episodes.end.mean().item() == pytest.approx(length / 2, rel=0.1)
    rows, ends, params = episodes.rows, episodes.end.clone(), episodes.rows.params.clone()
    x, held = torch.full((500, 6), 0.2), torch.full((500, 2), 0.3)
    alive = torch.arange(500) % 5 != 0
    episodes.carry_on(x, held, alive)  # a window of 20 periods: 1 s
    over = (ends.squeeze(-1) <= 1.0) | ~alive
    assert 0 < int((ends.squeeze(-1) <= 1.0).sum()) < 500
    torch.testing.assert_close(rows.t.squeeze(-1), torch.where(over, 0.0, 1.0))
    torch.testing.assert_close(episodes.end, torch.where(over.unsqueeze(-1), length, ends))
    torch.testing.assert_close(rows.x, torch.where(over.unsqueeze(-1), 0.0, x))
    # The delayed input goes on into the next episode unless its row diverged.
    torch.testing.assert_close(rows.held, torch.where(alive.unsqueeze(-1), held, 0.0))
    changed = (rows.params != params).flatten(1).any(-1)
    assert torch.equal(changed, over)


def test_shares_of_the_starts_are_those_asked_for(setting, small):
    env, agent, replay = setting()
    real = flown(env, agent)
    real["state"] = torch.arange(20.0).unsqueeze(-1).expand(20, 6) + 1
    replay.extend_real(real)
    planner = GradientPlanning(env, agent, replay, real_starts=0.3, jumps=0.2, **(small | {"rollouts": 4000}))
    episodes = _Episodes(planner)
    x = torch.full((4000, 6), -5.0)
    lost = torch.arange(4000) < 2000
    starts = episodes._starts(x, lost)[:, 0]
    for diverged, rows in ((False, starts[2000:]), (True, starts[:2000])):
        from_real, from_rest, on = rows > 0, rows == 0, rows == -5
        assert bool((from_real | from_rest | on).all())
        assert from_real.float().mean().item() == pytest.approx(0.3, abs=0.04)
        # Where the model diverged nothing goes on.
        assert on.float().mean().item() == pytest.approx(0.0 if diverged else 0.2, abs=0.0 if diverged else 0.04)
    assert starts[starts > 0].unique().tolist() == [float(n) for n in range(1, 21)]


def test_divergence_is_a_hundred_times_the_largest_real_value_and_nothing_where_a_state_never_moved(setting, small):
    env, agent, replay = setting()
    real = flown(env, agent)
    real["state"] = torch.tensor([1.0, -2.0, 0.0, 4.0, 50.0, 0.5]) * torch.linspace(0, 1, 20).unsqueeze(-1)
    replay.extend_real(real)
    reach = _Episodes(GradientPlanning(env, agent, replay, **small)).rows.reach
    assert reach.tolist() == pytest.approx([100.0, 200.0, math.inf, 400.0, 5000.0, 50.0])
