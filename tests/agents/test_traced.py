"""Derivatives by hand equal those of autograd, of actions by observations and of their sum by the parameters."""

import pytest
import torch
from torch import nn

from dynasindy.agents.networks import MLP
from dynasindy.agents.traced import Layers, _Recorded, trace


def networks():
    torch.manual_seed(0)
    return {
        "perceptron": MLP(4, 2, (16, 8), squash=True),
        "deep": MLP(4, 3, (8, 8, 8), squash=True),
        "open": MLP(4, 2, (16, 8)),
        "other": nn.Sequential(nn.Linear(4, 2), nn.Tanh()),
    }


@pytest.mark.parametrize("name", networks())
@pytest.mark.parametrize("batch", [(7,), (3, 5)])
def test_equal_to_autograd(name, batch):
    network = networks()[name]
    generator = torch.Generator().manual_seed(1)
    observation = torch.randn(*batch, 4, generator=generator)
    traced = trace(network, observation)
    assert isinstance(traced, Layers if name in ("perceptron", "deep") else _Recorded)
    seen = observation.clone().requires_grad_()
    actions = network(seen)
    torch.testing.assert_close(traced.actions, actions)
    for slope, column in zip(traced.slopes(), actions.unbind(-1), strict=True):
        torch.testing.assert_close(slope, torch.autograd.grad(column.sum(), seen, retain_graph=True)[0])
    weights = torch.randn(actions.shape, generator=generator)
    wanted = torch.autograd.grad((weights * actions).sum(), list(network.parameters()))
    network.zero_grad()
    traced.backward(weights)
    for parameter, gradient in zip(network.parameters(), wanted, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-6)
    trace(network, observation).backward(weights)  # a second chunk adds to the first
    for parameter, gradient in zip(network.parameters(), wanted, strict=True):
        torch.testing.assert_close(parameter.grad, 2 * gradient, rtol=1e-4, atol=1e-6)
