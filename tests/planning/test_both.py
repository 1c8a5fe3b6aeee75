"""Planning by the gradient and by replay in one phase: who learns what, and when the critics are warmed."""

from functools import partial

import pytest
import torch

from dynasindy.planning import Bounds, GradientPlanning, GradientThenReplay, ImaginedReplay, Planned, Planner


@torch.no_grad()
def flown(env, agent, steps=20):
    return env.rollout(steps, agent.policy)


def weights(policy):
    return torch.cat([p.detach().reshape(-1).clone() for p in policy.parameters()])


def test_both_ways_of_planning_share_one_phase(setting, small):
    env, agent, replay = setting()
    replay.extend_real(flown(env, agent))
    gradient = partial(GradientPlanning, updates=2, **small)
    planner = GradientThenReplay(
        env, agent, replay, gradient, partial(ImaginedReplay, rollouts=3, horizon=2, bounds=Bounds(reach=1e6))
    )
    assert planner.plan().imagined == 2 * 16 * 20 + 6
    assert len(replay.model) == 6
    planner.distrust()
    assert not len(replay.model)


def test_critics_learn_the_planned_actor_and_leave_it_alone(setting, small):
    planned = {}
    for critic_updates in (0, 300):
        env, agent, replay = setting(target_update_interval=1)
        replay.extend_real(flown(env, agent))
        gradient = partial(GradientPlanning, updates=2, **small)
        imagined = partial(ImaginedReplay, rollouts=3, horizon=2, bounds=Bounds(reach=1e6))
        planner = GradientThenReplay(env, agent, replay, gradient, imagined, critic_updates=critic_updates)
        assert planner.plan().updates == 2 + critic_updates
        error = agent.loss.value_loss(replay.real[:])[0].item()
        target = agent.loss.target_actor_network_params.flatten_keys().values()
        actor = agent.loss.actor_network_params.flatten_keys().values()
        apart = max(float((a - b).detach().abs().max()) for a, b in zip(actor, target))
        planned[critic_updates] = weights(agent.policy), error, apart
    torch.testing.assert_close(planned[0][0], planned[300][0], rtol=0, atol=0)
    assert planned[300][1] < 0.5 * planned[0][1]  # the temporal-difference error, with the planned actor's next actions
    assert planned[300][2] < 0.5 * planned[0][2]


def test_a_negative_number_of_critic_updates_is_refused(setting):
    env, agent, replay = setting()
    with pytest.raises(ValueError, match="critic_updates"):
        GradientThenReplay(env, agent, replay, GradientPlanning, ImaginedReplay, critic_updates=-1)


def test_warming_the_critics_waits_for_a_plan(setting):
    class Idle(Planner):
        def __init__(self, updates=0, every=1, **_):
            super().__init__(every)
            self.updates, self.dropped = updates, 0

        def plan(self):
            return Planned(imagined=7, updates=self.updates)

        def distrust(self):
            self.dropped += 1

    env, agent, replay = setting()
    replay.sample, warmed = (lambda: "batch"), []
    agent.update_critics = warmed.append
    for updates, total in ((0, 3), (5, 12)):
        parts = (partial(Idle, updates=updates, every=4), partial(Idle, updates=3, every=6))
        both = GradientThenReplay(env, agent, replay, *parts, critic_updates=4)
        assert both.plan() == Planned(14, total) and both.every == 4
        both.distrust()
        assert [planner.dropped for planner in both.planners] == [1, 1]
    assert warmed == ["batch"] * 4
