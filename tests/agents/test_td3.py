"""The agent, its steps in machine code and its noise: the algorithm written with torch alone, seeds, resume."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dynasindy.agents import TD3, DecayingGaussian, Hyperparameters
from dynasindy.agents.loss import MachineSteps
from dynasindy.systems import Diverged
from dynasindy.systems.compiler import compiler

pytestmark = pytest.mark.filterwarnings("error")


def transitions(rows=32, n_obs=4, n_u=2, seed=0):
    rng = torch.Generator().manual_seed(seed)
    seen, then = torch.randn(2, rows, n_obs, generator=rng)
    acted, reward = torch.rand(rows, n_u, generator=rng) * 2 - 1, torch.randn(rows, 1, generator=rng)
    flags = {key: torch.rand(rows, 1, generator=rng) < 0.3 for key in ("terminated", "truncated")}
    following = TensorDict({"observation": then, "reward": reward, **flags}, [rows])
    return TensorDict({"observation": seen, "action": acted, "next": following}, [rows])


def batches(n):
    return [transitions(seed=seed) for seed in range(n)]


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
    data = batches(14)
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
    small().check()
    for layers, name in (("actor_layers", "actor_network"), ("critic_layers", "qvalue_network")):
        spoilt = small()
        with torch.no_grad():
            getattr(spoilt.loss, layers)[1].weight.view(-1)[0] = math.nan
        with pytest.raises(Diverged, match=name):
            spoilt.check()
    lost = small(policy_delay=1)
    with torch.no_grad():
        lost.loss.actor_layers[1].weight.fill_(math.nan)
    with pytest.raises(Diverged, match="update"):
        lost.update(transitions())


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
    for batch in batches(8):
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


needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def pair(n_obs=4, n_u=2, **settings):
    settings = {"hidden": (6, 5), "seed": 3, "target_update_interval": 2, "tau": 0.3} | settings
    return tuple(TD3(n_obs, n_u, **settings, machine_code=code) for code in (True, False))


@needs_compiler
@pytest.mark.parametrize("rows", [1, 33])
@pytest.mark.parametrize(
    ("n_obs", "n_u", "hidden", "critics"),
    [(3, 2, (6, 5), 2), (1, 1, (1,), 2), (20, 3, (17, 40, 33), 3), (31, 2, (16, 32), 2), (40, 9, (64,), 4)],
)
def test_losses_gradients_and_steps_are_those_of_automatic_differentiation(rows, n_obs, n_u, hidden, critics):
    """The moments of Adam hold the gradients of all steps, so each of them is compared."""
    ours, torchs = pair(n_obs, n_u, hidden=hidden, critics=critics, critic_lr=1e-3, actor_lr=1e-3)
    for seed in range(4):
        batch = transitions(rows, n_obs, n_u, seed)
        found, wanted = ours.update(batch), torchs.update(batch)
        for name, value in wanted.items():
            assert found[name].item() == pytest.approx(value.item(), rel=2e-5, abs=1e-6)
    assert isinstance(ours._steps, MachineSteps) and not isinstance(torchs._steps, MachineSteps)
    for kind in ("critic_optimizer", "actor_optimizer"):
        states = (getattr(agent, kind).state_dict()["state"] for agent in (ours, torchs))
        for found, wanted in zip(*(state.values() for state in states), strict=True):
            assert found["step"] == wanted["step"]
            for moment in ("exp_avg", "exp_avg_sq"):
                size = wanted[moment].abs().max().item()
                torch.testing.assert_close(found[moment], wanted[moment], rtol=1e-4, atol=1e-5 * size)


@needs_compiler
def test_a_batch_that_is_not_in_one_piece_counts_as_its_copy():
    ours, other = pair()[0], pair()[0]
    batch = transitions(40)
    sliced = transitions(40)
    for part, key in ((sliced, "observation"), (sliced, "action"), (sliced["next"], "observation")):
        part[key] = part[key].t().contiguous().t()
        assert not part[key].is_contiguous()
    assert ours.update(batch)["critic_loss"] == other.update(sliced)["critic_loss"]
    assert torch.equal(tensors(ours), tensors(other))


@needs_compiler
@pytest.mark.parametrize(
    "replace",
    [
        lambda agent: agent.critic_optimizer.load_state_dict(copy.deepcopy(agent.critic_optimizer.state_dict())),
        lambda agent: agent.actor_optimizer.load_state_dict(copy.deepcopy(agent.actor_optimizer.state_dict())),
        lambda agent: agent.loss.share_memory(),
    ],
)
def test_a_tensor_that_was_replaced_is_the_one_that_learns(replace):
    agent, whole = pair()[0], pair()[0]
    for one in (agent, whole):
        one.update(transitions(10))
        one.update(transitions(10, seed=1))
    replace(agent)
    for one in (agent, whole):
        one.update(transitions(10, seed=2))
        one.update(transitions(10, seed=3))
    assert torch.equal(tensors(agent), tensors(whole))


@pytest.mark.parametrize("place", [0, 1], ids=["machine code", "torch"])
@pytest.mark.parametrize("kind", ["critics", "actor"])
def test_no_weight_moves_by_a_loss_that_is_refused(place, kind):
    agent = pair()[place]
    before = tensors(agent)

    def refuse(loss, what):
        raise ZeroDivisionError(what)

    with pytest.raises(ZeroDivisionError, match=kind):
        getattr(agent._steps, kind)(transitions(10), refuse)
    assert torch.equal(tensors(agent), before)


@needs_compiler
@pytest.mark.parametrize("net", [0, 1, 2])
def test_a_target_that_is_no_number_is_not_taken_for_the_larger_one(net):
    agent = pair(critics=3)[0]
    with torch.no_grad():
        agent.loss.target_critic_layers[1].weight[net] = math.nan
    with pytest.raises(Diverged, match="update"):
        agent.update(transitions(10))


def zeros(n=20000):
    return TensorDict({"action": torch.zeros(n, 1)}, [n])


def test_sigma_decays_by_its_rate_each_step_down_to_the_minimum():
    noise = DecayingGaussian(sigma=0.15, decay=1e-3, minimum=0.05)
    for _ in range(400):
        noise(zeros(1))
    assert noise.sigma == pytest.approx(0.15 * math.exp(400 * math.log1p(-1e-3)))
    for _ in range(1000):
        noise(zeros(1))
    assert noise.sigma == 0.05


def test_imagined_steps_use_the_noise_without_advancing_its_decay():
    noise = DecayingGaussian(sigma=0.15, decay=0.5)
    frozen = noise.frozen()
    assert frozen(zeros())["action"].std().item() == pytest.approx(0.15, rel=0.02)
    assert noise.sigma == 0.15
    assert not frozen.state_dict()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert frozen(zeros(8))["action"].abs().max() == 0
    noise.sigma = 0.05
    assert frozen(zeros())["action"].std().item() == pytest.approx(0.05, rel=0.02)


def test_a_draw_is_the_action_plus_sigma_times_its_generators_numbers():
    noise = DecayingGaussian(sigma=0.3, decay=0.1, seed=4)
    drawn = torch.randn(5, 2, generator=torch.Generator().manual_seed(4))
    action = torch.linspace(-0.9, 0.9, 10).reshape(5, 2)
    given = noise(TensorDict({"action": action.clone()}, [5]))["action"]
    torch.testing.assert_close(given, (action + 0.3 * drawn).clamp(-1, 1))
    assert noise.sigma == pytest.approx(0.27)
