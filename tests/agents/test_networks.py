"""Networks: shapes, activations and their functional form."""

import torch
from tensordict import TensorDict
from torch import nn

from dynasindy.agents.networks import MLP, actor


def test_mlp_equals_a_sequential_of_torch_modules():
    net = MLP(3, 2, [8, 6], squash=True)
    modules = []
    for linear in net.linears[:-1]:
        modules += [linear, nn.LeakyReLU()]
    reference = nn.Sequential(*modules, net.linears[-1], nn.Tanh())
    x = torch.randn(4, 7, 3)
    torch.testing.assert_close(net(x), reference(x))


def test_a_stack_evaluates_each_of_its_networks():
    networks = [MLP(4, 1, [8, 6]) for _ in range(3)]
    stack = TensorDict.from_modules(*networks)
    x, u = torch.randn(5, 3), torch.randn(5, 1)
    out = networks[0].functional(networks[0].layers(stack), x, u)
    expected = torch.stack([network(x, u) for network in networks])
    torch.testing.assert_close(out, expected)


def test_actions_stay_within_the_input_range():
    policy = actor(3, 2, [8])
    action = policy(TensorDict({"observation": 1e4 * torch.randn(64, 3)}, [64]))["action"]
    assert action.abs().max() <= 1
    assert action.abs().max() > 0.9
