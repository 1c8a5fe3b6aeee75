"""The agent: update frequencies, seeds, resume, settings."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from dynasindy.agents.td3 import TD3, Hyperparameters
from dynasindy.systems import Diverged

pytestmark = pytest.mark.filterwarnings("error")


def batches(n, size=32, seed=0):
    rng = torch.Generator().manual_seed(seed)
    flags = {key: torch.zeros(size, 1, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
    for _ in range(n):
        x, x_next = torch.randn(2, size, 4, generator=rng)
        u, reward = torch.rand(size, 2, generator=rng) * 2 - 1, torch.randn(size, 1, generator=rng)
        following = {"observation": x_next, "reward": reward, **flags}
        yield TensorDict({"observation": x, "action": u, "next": following}, [size])


def tensors(agent):
    return torch.cat([p.detach().flatten() for p in agent.loss.state_dict().values() if p.is_floating_point()])


def small(**settings):
    return TD3(4, 2, **{"hidden": (16, 12), "seed": 3} | settings)


def test_same_seed_gives_the_same_agent_whatever_the_global_generator():
    finals = []
    for seed, other in ((3, 1), (3, 2), (4, 1)):
        torch.manual_seed(other)
        agent = small(seed=seed)
        for batch in batches(6):
            agent.update(batch)
        finals.append(tensors(agent))
    assert torch.equal(finals[0], finals[1])
    assert not torch.equal(finals[0], finals[2])


def test_resumed_agent_equals_an_uninterrupted_one(tmp_path):
    settings = {"policy_average": 0.1, "policy_delay": 2, "target_update_interval": 3}
    agent, resumed = small(**settings), small(**settings, seed=9)
    data = list(batches(14))
    explored = TensorDict({"observation": torch.zeros(5, 4)}, [5])
    for batch in data[:7]:
        agent.update(batch)
        agent.explore(explored.clone())
    torch.save(agent.state_dict(), tmp_path / "agent.pt")
    resumed.load_state_dict(torch.load(tmp_path / "agent.pt", weights_only=True))
    for batch in data[7:]:
        expected, given = agent.update(batch), resumed.update(batch)
        assert {k: v.item() for k, v in expected.items()} == {k: v.item() for k, v in given.items()}
    assert torch.equal(tensors(agent), tensors(resumed))
    actions = [a.explore(explored.clone())["action"] for a in (agent, resumed)]
    assert torch.equal(*actions)
    assert torch.equal(*[a.deployed(explored.clone())["action"] for a in (agent, resumed)])


@pytest.mark.parametrize("reward", [math.nan, math.inf])
def test_a_reward_that_is_not_finite_stops_the_update_before_any_weight_moves(reward):
    agent = small()
    first, second = batches(2)
    agent.update(first)
    before = tensors(agent)
    second["next", "reward"][3] = reward
    with pytest.raises(Diverged, match="critic_lr=0"):
        agent.update(second)
    assert torch.equal(tensors(agent), before)
    with pytest.raises(Diverged, match="update 3"):
        agent.update(second)


def test_an_actor_without_finite_weights_is_told_and_its_critics_are_checked_too():
    agent = small()
    agent.check()
    for weights, name in ((agent.loss.actor_layers, "actor_network"), (agent.loss.critic_layers, "qvalue_network")):
        spoilt = small()
        layers = spoilt.loss.actor_layers if weights is agent.loss.actor_layers else spoilt.loss.critic_layers
        with torch.no_grad():
            layers[1].weight.view(-1)[0] = math.nan
        with pytest.raises(Diverged, match=name):
            spoilt.check()
    lost = small(policy_delay=1)
    with torch.no_grad():
        lost.loss.actor_layers[1].weight.fill_(math.nan)
    with pytest.raises(Diverged, match="update"):
        lost.update(next(batches(1)))


class Plain:
    """Algorithm 1 of Fujimoto 2018 with modules of torch alone, and what our settings add to it, line by line."""

    def __init__(self, agent, seed):
        s = self.settings = agent.settings
        actor = agent.loss.actor_layers
        self.actor = self.network([(layer.weight, layer.bias) for layer in actor], nn.Tanh())
        stack = agent.loss.critic_layers
        self.critics = [self.network([(layer.weight[i], layer.bias[i]) for layer in stack]) for i in range(s.critics)]
        self.target_actor, self.target_critics = copy.deepcopy(self.actor), copy.deepcopy(self.critics)
        self.average = copy.deepcopy(self.actor)
        self.noise = torch.Generator().manual_seed(seed + 1)
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), s.actor_lr)
        weights = [p for critic in self.critics for p in critic.parameters()]
        self.critic_optimizer = torch.optim.Adam(weights, s.critic_lr)
        self.updates = 0

    def network(self, layers, *last):
        modules = []
        for weight, bias in layers:
            linear = nn.Linear(weight.shape[1], weight.shape[0])
            linear.weight.data, linear.bias.data = weight.detach().clone(), bias.detach().clone()
            modules += [linear, nn.LeakyReLU(0.01)]
        return nn.Sequential(*modules[:-1], *last)

    def descend(self, loss, optimizer):
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def update(self, batch):
        s = self.settings
        x, u, then = batch["observation"], batch["action"], batch["next"]
        with torch.no_grad():
            noise = torch.empty_like(u).normal_(generator=self.noise) * s.policy_noise
            u_then = (self.target_actor(then["observation"]) + noise.clamp(-s.noise_clip, s.noise_clip)).clamp(-1, 1)
            inputs = torch.cat([then["observation"], u_then], -1)
            least = torch.stack([critic(inputs) for critic in self.target_critics]).amin(0)
            wanted = then["reward"] + s.gamma * least * (1 - then["terminated"].float())
        values = [critic(torch.cat([x, u], -1)) for critic in self.critics]
        loss = sum((value - wanted).square().mean() for value in values)
        self.descend(loss, self.critic_optimizer)
        self.updates += 1
        if self.updates % s.policy_delay == 0:
            self.descend(-self.critics[0](torch.cat([x, self.actor(x)], -1)).mean(), self.actor_optimizer)
            self.follow(self.average, self.actor, s.policy_average)
        if self.updates % s.target_update_interval == 0:
            for target, critic in zip(self.target_critics, self.critics, strict=True):
                self.follow(target, critic, s.tau)
            self.follow(self.target_actor, self.actor, s.tau)
        return loss.item(), torch.stack(values).mean().item()

    def follow(self, slow, fast, share):
        for a, b in zip(slow.parameters(), fast.parameters(), strict=True):
            a.data = share * b.data + (1 - share) * a.data


@pytest.mark.parametrize("machine_code", [True, False])
def test_updates_are_those_of_the_algorithm_written_with_torch_alone(machine_code):
    settings = {"gamma": 0.9, "tau": 0.3, "policy_delay": 2, "target_update_interval": 3, "critics": 3}
    settings |= {"actor_lr": 2e-3, "critic_lr": 3e-3, "policy_average": 0.2}
    agent = small(**settings, policy_noise=0.4, noise_clip=0.3, machine_code=machine_code)
    plain = Plain(agent, seed=3)
    generator = torch.Generator().manual_seed(11)
    for batch in batches(8):
        batch["next", "terminated"] = torch.rand(32, 1, generator=generator) < 0.3
        batch["next", "truncated"] = torch.rand(32, 1, generator=generator) < 0.3
        metrics, (loss, value) = agent.update(batch), plain.update(batch)
        assert metrics["critic_loss"].item() == pytest.approx(loss, rel=1e-5)
        assert metrics["q_value"].item() == pytest.approx(value, rel=1e-4, abs=1e-6)
    for ours, theirs in (
        (agent.policy, plain.actor),
        (agent.deployed, plain.average),
    ):
        for a, b in zip(ours.parameters(), theirs.parameters(), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)
    for stack, nets in (
        (agent.loss.critic_layers, plain.critics),
        (agent.loss.target_critic_layers, plain.target_critics),
    ):
        for i, net in enumerate(nets):
            for layer, linear in zip(stack, net[::2], strict=True):
                torch.testing.assert_close(layer.weight[i], linear.weight, rtol=1e-4, atol=1e-6)
                torch.testing.assert_close(layer.bias[i], linear.bias, rtol=1e-4, atol=1e-6)
    for layer, linear in zip(agent.loss.target_actor_layers, plain.target_actor[::2], strict=False):
        torch.testing.assert_close(layer.weight, linear.weight, rtol=1e-4, atol=1e-6)
    assert agent.updates == 8


@pytest.mark.parametrize(
    ("name", "edges", "beyond"),
    [
        ("actor_lr", (1e-9, 1), (0, 0.0)),
        ("gamma", (1, 1e-9), (0.0, 1.0001, math.nan)),
        ("tau", (1, 1e-9), (0, 1.0001, "fast")),
        ("policy_noise", (0, 3), (-1e-9,)),
        ("policy_delay", (1,), (0, 1.0, 2.5)),
        ("critics", (2,), (1, 2.0)),
    ],
)
def test_ranges_are_met_at_their_edges(name, edges, beyond):
    for value in edges:
        assert getattr(Hyperparameters(**{name: value}), name) == value
    for value in beyond:
        with pytest.raises(ValueError, match=name):
            Hyperparameters(**{name: value})


def test_critics_learn_a_known_value():
    # Reward 1 for ever, gamma 0.5: the value is 2 everywhere.
    agent = small(gamma=0.5, critic_lr=3e-3, target_update_interval=1, tau=0.05)
    for batch in batches(600):
        batch["next", "reward"] = torch.ones(32, 1)
        metrics = agent.update(batch)
    assert metrics["q_value"].item() == pytest.approx(2.0, abs=0.1)


def test_actor_climbs_the_critic():
    # Reward -(u - 0.5)^2 at once, gamma ~ 0: the best action is 0.5 everywhere.
    agent = small(gamma=1e-6, critic_lr=3e-3, actor_lr=1e-3, hidden=(32, 32))
    assert (agent.policy(next(batches(1, seed=5)))["action"] - 0.5).abs().mean().item() > 0.4
    for batch in batches(1500, size=64):
        batch["next", "reward"] = -(batch["action"] - 0.5).square().sum(-1, keepdim=True)
        agent.update(batch)
    action = agent.policy(next(batches(1, seed=5)))["action"]
    assert (action - 0.5).abs().mean().item() < 0.2
