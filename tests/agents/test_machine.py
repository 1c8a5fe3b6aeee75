"""Steps by machine code are those by automatic differentiation, for all shapes, and read nothing that is not there."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict

from dynasindy.agents import machine as module
from dynasindy.agents import networks
from dynasindy.agents.machine import PARTS, MachineSteps, readable
from dynasindy.agents.steps import Steps
from dynasindy.agents.td3 import TD3
from dynasindy.systems import Diverged
from dynasindy.systems import compiler as compiling
from dynasindy.systems.compiler import compiler, forget

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
pytestmark = pytest.mark.filterwarnings("error")


def transitions(rows, n_obs=3, n_u=2, seed=0):
    rng = torch.Generator().manual_seed(seed)
    seen, then = torch.randn(2, rows, n_obs, generator=rng)
    acted, reward = torch.rand(rows, n_u, generator=rng) * 2 - 1, torch.randn(rows, 1, generator=rng)
    ended = torch.rand(rows, 1, generator=rng) < 0.3
    following = TensorDict({"observation": then, "reward": reward, "terminated": ended}, [rows])
    return TensorDict({"observation": seen, "action": acted, "next": following}, [rows])


def pair(n_obs=3, n_u=2, **settings):
    settings = {"hidden": (6, 5), "seed": 3, "target_update_interval": 2, "tau": 0.3} | settings
    return tuple(TD3(n_obs, n_u, **settings, machine_code=code) for code in (True, False))


def weights(agent):
    return {name: value for name, value in agent.loss.state_dict().items() if value.is_floating_point()}


@needs_compiler
@pytest.mark.parametrize("rows", [1, 31, 32, 33, 100])
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
def test_agents_that_differ_by_machine_code_alone_draw_the_same_noise():
    ours, torchs = pair()
    for agent in (ours, torchs):
        agent.update(transitions(10))
    assert torch.equal(ours.loss.generator.get_state(), torchs.loss.generator.get_state())


@needs_compiler
def test_a_batch_that_is_not_in_one_piece_counts_as_its_copy():
    ours, other = pair()[0], pair()[0]
    batch = transitions(40)
    sliced = transitions(40)
    for part, key in ((sliced, "observation"), (sliced, "action"), (sliced["next"], "observation")):
        part[key] = part[key].t().contiguous().t()
        assert not part[key].is_contiguous()
    assert ours.update(batch)["critic_loss"] == other.update(sliced)["critic_loss"]
    assert all(torch.equal(a, b) for a, b in zip(weights(ours).values(), weights(other).values(), strict=True))


@needs_compiler
@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("action", torch.zeros(10, 1), r"'action' as \(10, 1\), torch.float32, on cpu; give \(10, 2\)"),
        ("observation", torch.zeros(10, 3).double(), r"'observation' as \(10, 3\), torch.float64"),
        (("next", "terminated"), torch.zeros(10, 1), "'terminated' .* give .* torch.bool"),
        (("next", "reward"), torch.zeros(10, 2), r"'reward' as \(10, 2\)"),
        (("next", "observation"), torch.zeros(10, 4), r"'observation' as \(10, 4\)"),
    ],
)
def test_a_batch_of_another_shape_or_kind_is_refused(key, value, words):
    batch = transitions(10)
    batch[key] = value
    agent = pair()[0]
    before = {name: value.clone() for name, value in weights(agent).items()}
    with pytest.raises(ValueError, match=words):
        agent.update(batch)
    assert all(torch.equal(before[name], value) for name, value in weights(agent).items())


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
    assert all(torch.equal(a, b) for a, b in zip(weights(agent).values(), weights(whole).values(), strict=True))


@needs_compiler
def test_moments_that_were_forgotten_begin_anew_as_those_of_torch():
    ours, torchs = pair()
    for agent in (ours, torchs):
        agent.update(transitions(10))
        agent.critic_optimizer.state.clear()
        agent.update(transitions(10, seed=1))
    for name, value in weights(torchs).items():
        torch.testing.assert_close(weights(ours)[name], value, rtol=1e-4, atol=1e-6)
    assert len(ours.critic_optimizer.state) == len(torchs.critic_optimizer.state)


@needs_compiler
@pytest.mark.parametrize("lanes", ["-mno-avx", "-mno-avx512f", "-march=native"])
def test_the_room_holds_many_layers_of_odd_width_on_any_processor(monkeypatch, lanes):
    run = compiling._run
    monkeypatch.setattr(compiling, "_run", lambda words, *files: run([*words, *([lanes] * ("-c" in words))], *files))
    forget()
    agent = TD3(1, 1, hidden=(1,) * 40, policy_delay=1)
    agent._steps._place(1)
    size = len(agent._steps._room)
    guarded = torch.full((size + 2048,), 7.0)
    agent._steps._room = guarded
    agent.update(transitions(1, 1, 1))
    assert (guarded[size:] == 7.0).all()
    forget()


@needs_compiler
@pytest.mark.parametrize("kind", ["critics", "actor"])
def test_no_weight_moves_by_a_loss_that_is_refused(kind):
    agent = pair()[0]
    before = {name: value.clone() for name, value in weights(agent).items()}

    def refuse(loss, what):
        raise ZeroDivisionError(what)

    with pytest.raises(ZeroDivisionError, match=kind):
        getattr(agent._steps, kind)(transitions(10), refuse)
    assert all(torch.equal(before[name], value) for name, value in weights(agent).items())


@needs_compiler
def test_an_empty_batch_is_refused():
    with pytest.raises(ValueError, match="holds no transition; give one at least"):
        pair()[0].update(transitions(0))


@pytest.mark.parametrize(
    "change",
    [
        lambda agent: agent.critic_optimizer.param_groups[0].update(weight_decay=0.1),
        lambda agent: agent.actor_optimizer.param_groups[0].update(amsgrad=True),
        lambda agent: next(agent.loss.actor_network_params.parameters()).requires_grad_(False),
        lambda agent: agent.critic_optimizer.add_param_group({"params": [torch.zeros(1, requires_grad=True)]}),
        lambda agent: setattr(agent.loss, "__class__", type("Other", (type(agent.loss),), {})),
    ],
)
def test_what_it_would_not_heed_is_left_to_torch(change):
    agent = pair()[0]
    change(agent)
    assert type(agent._steps) is Steps


@needs_compiler
@pytest.mark.parametrize("net", [0, 1, 2])
def test_a_target_that_is_no_number_is_not_taken_for_the_larger_one(net):
    agent = pair(critics=3)[0]
    with torch.no_grad():
        agent.loss.target_critic_layers[1].weight[net] = math.nan
    with pytest.raises(Diverged, match="critics' loss is nan at update 1"):
        agent.update(transitions(10))


def test_networks_that_it_does_not_know_are_left_to_torch():
    assert readable(pair()[0].loss)
    double = pair()[0]
    double.loss.double()
    assert not readable(double.loss)


def test_without_a_compiler_torch_learns_without_a_word(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    forget()
    agent = pair()[0]
    assert math.isfinite(agent.update(transitions(10))["critic_loss"]) and type(agent._steps) is Steps


@needs_compiler
@pytest.mark.parametrize("error", [ValueError("refused it"), OSError("cannot be loaded")])
def test_a_compiler_that_fails_costs_one_warning(monkeypatch, error):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(module, "load", fail)
    agent = pair()[0]
    with pytest.warns(UserWarning, match="TD3 learns by torch code, which is slower: "):
        agent.update(transitions(10))
    agent.update(transitions(10))  # and none at the next update


@pytest.fixture
def bfloat16():
    if compiler() is None or not pair(matmul_precision="medium")[0]._steps._agent.parts:
        pytest.skip("the processor takes no products in bfloat16")


class Rounded(torch.autograd.Function):
    """A layer whose products have factors in bfloat16, one or two for each number, where they are large enough."""

    parts = 1

    @classmethod
    def product(cls, a, b):
        parts = cls.parts if min(a.shape[-2:] + b.shape[-1:]) >= 8 else 0
        (a_high, a_low), (b_high, b_low) = cls.split(a, parts), cls.split(b, parts)
        return (a_high @ b_high + (a_high @ b_low + a_low @ b_high)).float()

    @staticmethod
    def split(a, parts):
        high = a.bfloat16().double() if parts else a.double()
        return high, (a - high).bfloat16().double() * (parts == 2)

    @staticmethod
    def forward(ctx, x, weight, bias):
        ctx.save_for_backward(x, weight)
        # A batch is filled up to 32 rows, so that its number does not count among the sizes.
        # In one piece, as torch's: noise is drawn in the order of what it is added to.
        return (Rounded.product(weight, filled(x).mT).mT[..., : x.shape[-2], :] + bias.unsqueeze(-2)).contiguous()

    @staticmethod
    def backward(ctx, slope):
        x, weight = ctx.saved_tensors
        back = Rounded.product(weight.mT, filled(slope).mT).mT[..., : x.shape[-2], :]
        return back, Rounded.product(filled(slope).mT, filled(x)), slope.sum(-2)


def filled(x):
    return torch.nn.functional.pad(x, (0, 0, 0, -x.shape[-2] % 32))


@pytest.mark.usefixtures("bfloat16")
@pytest.mark.parametrize("precision", ["high", "medium"])
@pytest.mark.parametrize("rows", [1, 33, 100])
@pytest.mark.parametrize(
    ("n_obs", "n_u", "hidden", "critics"),
    [(20, 9, (17, 40, 33), 3), (31, 8, (16, 32), 2), (40, 11, (64,), 2), (30, 16, (70, 9), 2), (3, 2, (6, 5), 2)],
)
def test_products_in_bfloat16_are_those_of_rounded_factors(monkeypatch, precision, rows, n_obs, n_u, hidden, critics):
    """The other agent's products are torch's, in float64, of factors that were rounded to bfloat16 before."""
    ours, torchs = pair(n_obs, n_u, hidden=hidden, critics=critics, matmul_precision=precision)
    ours._steps._agent.parts = PARTS[precision]  # also two of them, where float32 is faster than that
    exact = pair(n_obs, n_u, hidden=hidden, critics=critics)[0]
    monkeypatch.setattr(Rounded, "parts", PARTS[precision])
    monkeypatch.setattr(networks, "_linear", lambda x, layer: Rounded.apply(x, layer.weight, layer.bias))
    batch = transitions(rows, n_obs, n_u)
    for agent in (ours, torchs, exact):
        agent.update(batch), agent.update(batch)
    differs = False
    for kind in ("critic_optimizer", "actor_optimizer"):
        states = (getattr(agent, kind).state_dict()["state"].values() for agent in (ours, torchs, exact))
        for found, wanted, plain in (tuple(state["exp_avg"] for state in each) for each in zip(*states, strict=True)):
            torch.testing.assert_close(found, wanted, rtol=2e-3, atol=2e-4 * wanted.abs().max().item())
            differs |= not torch.equal(found, plain)
    assert differs == (min(hidden) >= 8)  # what is smaller is left to float32


@pytest.mark.usefixtures("bfloat16")
@pytest.mark.parametrize("precision", ["high", "medium"])
@pytest.mark.parametrize("rows", [1, 70])
def test_the_room_holds_the_factors_in_bfloat16(precision, rows):
    agent = TD3(9, 8, hidden=(33, 65, 9), policy_delay=1, matmul_precision=precision)
    agent._steps._agent.parts = PARTS[precision]
    agent._steps._place(rows)
    size = len(agent._steps._room)
    guarded = torch.full((size + 2048,), 7.0)
    agent._steps._room = guarded
    agent.update(transitions(rows, 9, 8))
    assert (guarded[size:] == 7.0).all()


def without(monkeypatch, *words):
    """Have the compiler do without some of the processor's instructions."""
    run = compiling._run
    monkeypatch.setattr(
        compiling, "_run", lambda given, *files: run([*given, *(words if "-c" in given else [])], *files)
    )
    forget()


@pytest.mark.usefixtures("bfloat16")
def test_without_tiles_one_number_is_one_bfloat16_or_float32(monkeypatch):
    without(monkeypatch, "-mno-amx-tile")
    parts = [TD3(20, 9, hidden=(40, 33), matmul_precision=precision)._steps._agent.parts for precision in PARTS]
    assert parts == [1 if precision == "medium" else 0 for precision in PARTS]


@needs_compiler
def test_without_bfloat16_every_precision_is_float32(monkeypatch):
    without(monkeypatch, "-mno-amx-tile", "-mno-avx512bf16")
    agents = [TD3(20, 9, hidden=(40, 33), seed=3, matmul_precision=precision) for precision in PARTS]
    for agent in agents:
        agent.update(transitions(40, 20, 9))
    assert isinstance(agents[0]._steps, MachineSteps) and agents[2]._steps._agent.parts == 0
    for name, value in weights(agents[0]).items():
        assert all(torch.equal(weights(agent)[name], value) for agent in agents[1:])
