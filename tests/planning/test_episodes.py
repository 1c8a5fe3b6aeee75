"""How imagined episodes begin and go on, against shares and times by hand."""

import pytest
import torch

from dynasindy.planning import GradientPlanning
from dynasindy.planning.gradient_planning import _Episodes


@torch.no_grad()
def flown(env, agent, steps=20):
    return env.rollout(steps, agent.policy)


def test_a_quarter_begins_at_real_states_and_another_goes_on(setting, small):
    env, agent, replay = setting()
    real = flown(env, agent)
    real["state"] = torch.arange(20.0).unsqueeze(-1).expand(20, 6) + 1
    replay.extend_real(real)
    planner = GradientPlanning(env, agent, replay, **(small | {"rollouts": 4000}))
    episodes = _Episodes(planner)
    x = torch.full((4000, 6), -5.0)
    lost = torch.arange(4000) < 2000
    starts = episodes._starts(x, lost)[:, 0]
    for diverged, rows in ((False, starts[2000:]), (True, starts[:2000])):
        from_real, from_rest, on = rows > 0, rows == 0, rows == -5
        assert bool((from_real | from_rest | on).all())
        assert from_real.float().mean().item() == pytest.approx(0.25, abs=0.04)
        # Where the model diverged nothing goes on.
        assert on.float().mean().item() == pytest.approx(0.0 if diverged else 0.25, abs=0.0 if diverged else 0.04)
    assert starts[starts > 0].unique().tolist() == [float(n) for n in range(1, 21)]


def test_one_episode_of_two_is_late_by_as_much_as_may_be(setting, small):
    env, agent, _ = setting()
    planner = GradientPlanning(env, agent, **(small | {"rollouts": 4000, "input_delay": 0.7}))
    drawn = _Episodes(planner)._draw_delays()
    assert drawn.shape == (4000, 1) and sorted(drawn.unique().tolist()) == pytest.approx([0.0, 0.7])
    assert float((drawn > 0).float().mean()) == pytest.approx(0.5, abs=0.03)  # of 4000 throws of a coin
