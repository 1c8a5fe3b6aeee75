"""Agents that learn side by side come to what each comes to alone."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from dynasindy.agents import TD3
from dynasindy.agents.steps import kept_by
from dynasindy.data import DynaReplay
from dynasindy.data.replay import LEARN_KEYS
from dynasindy.systems import Diverged
from dynasindy.together import Company, learn

GPU = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU"))
SETTINGS = [
    {},
    {"policy_average": 0.01, "lr_decay": 1e-3, "max_grad_norm": 0.5},
    {"layer_norm": True, "critics": 3, "target_update_interval": 3, "policy_delay": 3},
]


def rows(count, seed):
    rng = torch.Generator().manual_seed(seed)
    draw = {"observation": 8, "action": 2, "following": 8, "reward": 1}
    drawn = {key: torch.randn(count, width, generator=rng) for key, width in draw.items()}
    ended, never = torch.rand(count, 1, generator=rng) < 0.2, torch.zeros(count, 1, dtype=torch.bool)
    following = {"observation": drawn["following"], "reward": drawn["reward"], "done": ended}
    following |= {"terminated": ended, "truncated": never}
    batch = {"observation": drawn["observation"], "action": drawn["action"].clamp(-1, 1)}
    return TensorDict({**batch, "next": TensorDict(following, [count])}, [count])


def agent_and_replay(seed, device="cpu", real_ratio=0.25, **settings):
    replay = DynaReplay(500, 64, real_ratio=real_ratio, seed=seed, keys=LEARN_KEYS, device=device)
    replay.extend_real(rows(300, seed))
    replay.model.extend(rows(200, seed + 50))
    return TD3(8, 2, seed=seed, hidden=(32, 24), **settings), replay


def weights(agent):
    return torch.cat([w.flatten() for w in (*agent.loss.state_dict().values(), *agent.deployed.state_dict().values())])


def moments(agent):
    return kept_by(
        agent.critic_optimizer, [part for layer in agent.loss.critic_layers for part in layer if part is not None]
    )


@pytest.mark.parametrize("device", ["cpu", GPU])
@pytest.mark.parametrize("settings", SETTINGS)
def test_each_agent_learns_what_it_learns_alone(settings, device):
    def _learn(agent, replay):
        learn(agent, replay, 37)  # more than one call, and more than one chunk, none of them round
        learn(agent, replay, 60)

    alone = [agent_and_replay(seed, **settings) for seed in range(3)]
    for each in alone:
        _learn(*each)
    together = [agent_and_replay(seed, device, **settings) for seed in range(3)]
    assert Company(device).run([lambda each=each: _learn(*each) for each in together]) == [None] * 3
    for (one, its), (other, others) in zip(alone, together, strict=True):
        untrained = agent_and_replay(0, **settings)[0]
        assert (weights(one) - weights(untrained)).abs().max() > 1e-3
        torch.testing.assert_close(weights(other), weights(one), rtol=0, atol=1e-6)
        assert other.updates == one.updates == 97
        torch.testing.assert_close(other.actor_loss, one.actor_loss, rtol=1e-5, atol=1e-6)
        assert torch.equal(others.generator.get_state(), its.generator.get_state())
        assert torch.equal(other.loss.generator.get_state(), one.loss.generator.get_state())
        for mine, theirs in zip(*(moments(agent) for agent in (other, one)), strict=True):
            torch.testing.assert_close(mine["exp_avg_sq"], theirs["exp_avg_sq"], rtol=1e-4, atol=1e-9)
            assert mine["step"] == theirs["step"] == 97
        rates = [agent.actor_optimizer.param_groups[0]["lr"] for agent in (one, other)]
        assert rates[1] == pytest.approx(rates[0], rel=1e-5)


def test_weights_that_a_plan_has_set_between_two_calls_are_learnt_from():
    def _learn(agent, replay):
        learn(agent, replay, 4)
        with torch.no_grad():
            agent.loss.actor_layers[0].weight.mul_(0.5)
        learn(agent, replay, 4)

    (one, its), (other, others) = (agent_and_replay(1) for _ in range(2))
    _learn(one, its)
    with Company().alone():
        _learn(other, others)
    torch.testing.assert_close(weights(other), weights(one), rtol=0, atol=1e-6)


def test_an_agent_that_was_changed_between_two_calls_learns_from_what_it_is_now():
    def _learn(agent, replay, begun):
        learn(agent, replay, 4)
        agent.load_state_dict({**begun, "updates": 4})  # as many as it has learnt by
        learn(agent, replay, 4)

    (one, its), (other, others) = (agent_and_replay(1) for _ in range(2))
    begun = TD3(8, 2, seed=9, hidden=(32, 24)).state_dict()
    _learn(one, its, begun)
    with Company().alone():
        _learn(other, others, begun)
    torch.testing.assert_close(weights(other), weights(one), rtol=0, atol=1e-6)


def test_real_data_alone_are_learnt_from():
    def _pair():
        replay = DynaReplay(500, 64, real_ratio=None, seed=3, keys=LEARN_KEYS)
        replay.extend_real(rows(300, 3))
        return TD3(8, 2, seed=3, hidden=(32, 24)), replay

    (one, its), (other, others) = _pair(), _pair()
    learn(one, its, 6)
    with Company().alone():
        learn(other, others, 6)
    torch.testing.assert_close(weights(other), weights(one), rtol=0, atol=1e-6)


def test_an_agent_that_diverges_is_told_so_and_the_others_go_on():
    def _learn(agent, replay):
        learn(agent, replay, 5)

    runs = [agent_and_replay(seed) for seed in range(2)]
    with torch.no_grad():
        next(iter(runs[1][0].loss.critic_layers)).weight.fill_(torch.inf)
    fine, lost = Company().run([lambda each=each: _learn(*each) for each in runs])
    assert fine is None
    assert isinstance(lost, Diverged)
    assert "at update 1 " in str(lost)
    assert runs[0][0].updates == 5


def test_a_weight_that_no_loss_reads_is_checked_as_that_of_an_agent_alone():
    runs = [agent_and_replay(seed, policy_average=0.01) for seed in range(2)]
    one, its = agent_and_replay(1, policy_average=0.01)
    with torch.no_grad():
        for agent in (runs[1][0], one):
            agent.deployed.module.layers()[0].weight[0, 0] = torch.inf
    with pytest.raises(Diverged, match="weights of") as alone:
        learn(one, its, 5)
    fine, lost = Company().run([partial(learn, *each, 5) for each in runs])
    assert fine is None
    assert isinstance(lost, Diverged) and str(lost) == str(alone.value)


def test_learning_that_diverges_later_ends_at_the_update_at_which_it_does_alone():
    # The first steps of Adam are as long as the learning rate, so that the values overflow soon after the first one.
    one, its = agent_and_replay(0, critic_lr=1e9)
    with pytest.raises(Diverged) as alone:
        learn(one, its, 40)
    assert "at update 1 " not in str(alone.value)
    (lost,) = Company().run([partial(learn, *agent_and_replay(0, critic_lr=1e9), 40)])
    assert str(lost) == str(alone.value)
