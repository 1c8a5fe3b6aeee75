"""Steps by automatic differentiation: one step of each network, down a loss that was shown before."""

import pytest
import torch
from tensordict import TensorDict
from torch.optim import Adam

from dynasindy.agents.loss import GradientSteps
from dynasindy.agents.td3 import TD3


class Found(Exception):
    pass


def batch():
    rng = torch.Generator().manual_seed(0)
    following = {"observation": torch.randn(8, 3, generator=rng), "reward": torch.randn(8, 1, generator=rng)}
    following["terminated"] = torch.zeros(8, 1, dtype=torch.bool)
    seen, acted = torch.randn(8, 3, generator=rng), torch.rand(8, 2, generator=rng)
    return TensorDict({"observation": seen, "action": acted, "next": TensorDict(following, [8])}, [8])


def steps():
    loss = TD3(3, 2, hidden=(6,), machine_code=False).loss
    networks = loss.qvalue_network_params, loss.actor_network_params
    return GradientSteps(loss, *(Adam(list(network.parameters()), lr=1e-2) for network in networks))


@pytest.mark.parametrize("kind", ["critics", "actor"])
def test_no_weight_moves_by_a_loss_that_is_refused(kind):
    made = steps()
    layers = (*made.loss.critic_layers, *made.loss.actor_layers)
    before = [layer.weight.clone() for layer in layers]

    def refuse(loss, what):
        raise Found(what)

    with pytest.raises(Found, match=kind):
        getattr(made, kind)(batch(), refuse)
    assert all(torch.equal(old, layer.weight) for old, layer in zip(before, layers, strict=True))
