"""Networks: shapes, activations and their functional form."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from dynasindy.agents.networks import MLP, actor, critic


@pytest.mark.parametrize("layer_norm", [False, True])
def test_mlp_equals_a_sequential_of_torch_modules(layer_norm):
    net = MLP(3, 2, [8, 6], layer_norm=layer_norm, squash=True)
    modules = []
    for i, linear in enumerate(net.linears[:-1]):
        modules += [linear, *([net.norms[i]] if layer_norm else []), nn.LeakyReLU()]
    reference = nn.Sequential(*modules, net.linears[-1], nn.Tanh())
    x = torch.randn(4, 7, 3)
    torch.testing.assert_close(net(x), reference(x))


@pytest.mark.parametrize("layer_norm", [False, True])
def test_a_stack_evaluates_each_of_its_networks(layer_norm):
    networks = [MLP(4, 1, [8, 6], layer_norm=layer_norm) for _ in range(3)]
    stack = TensorDict.from_modules(*networks)
    x, u = torch.randn(5, 3), torch.randn(5, 1)
    out = networks[0].functional(networks[0].layers(stack), x, u)
    expected = torch.stack([network(x, u) for network in networks])
    torch.testing.assert_close(out, expected)


def test_paper_architecture_has_as_many_parameters_as_counted_by_hand():
    count = sum(p.numel() for p in actor(8, 2, (400, 300)).parameters())
    assert count == (8 * 400 + 400) + (400 * 300 + 300) + (300 * 2 + 2)
    count = sum(p.numel() for p in critic(8, 2, (400, 300)).parameters())
    assert count == (10 * 400 + 400) + (400 * 300 + 300) + (300 + 1)


def test_actions_stay_within_the_input_range():
    policy = actor(3, 2, [8])
    action = policy(TensorDict({"observation": 1e4 * torch.randn(64, 3)}, [64]))["action"]
    assert action.abs().max() <= 1
    assert action.abs().max() > 0.9


@pytest.mark.parametrize(("n_in", "hidden"), [(0, [8]), (3, []), (3, [8, 0])])
def test_refuses_impossible_widths(n_in, hidden):
    with pytest.raises(ValueError, match=r"MLP widths are .*; give at least one hidden layer"):
        MLP(n_in, 1, hidden)
