"""Steps by machine code are those by automatic differentiation, for all shapes, and read nothing that is not there."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict

from dynasindy.agents.loss import MachineSteps
from dynasindy.agents.td3 import TD3
from dynasindy.systems import Diverged
from dynasindy.systems.compiler import compiler

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
    assert all(torch.equal(a, b) for a, b in zip(weights(ours).values(), weights(other).values(), strict=True))


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


@pytest.mark.parametrize("place", [0, 1], ids=["machine code", "torch"])
@pytest.mark.parametrize("kind", ["critics", "actor"])
def test_no_weight_moves_by_a_loss_that_is_refused(place, kind):
    agent = pair()[place]
    before = {name: value.clone() for name, value in weights(agent).items()}

    def refuse(loss, what):
        raise ZeroDivisionError(what)

    with pytest.raises(ZeroDivisionError, match=kind):
        getattr(agent._steps, kind)(transitions(10), refuse)
    assert all(torch.equal(before[name], value) for name, value in weights(agent).items())


@needs_compiler
@pytest.mark.parametrize("net", [0, 1, 2])
def test_a_target_that_is_no_number_is_not_taken_for_the_larger_one(net):
    agent = pair(critics=3)[0]
    with torch.no_grad():
        agent.loss.target_critic_layers[1].weight[net] = math.nan
    with pytest.raises(Diverged, match="update"):
        agent.update(transitions(10))
