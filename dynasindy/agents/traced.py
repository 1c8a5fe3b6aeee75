"""Actions of a policy with what their derivatives need, for planning through a model's gradient.

Two derivatives are asked of each action: by the observation, and, once it is known how the return depends on the
action, by the parameters. A perceptron without normalisation keeps its layers and does both by hand, as few products as
there are; any other network is left to autograd.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from dynasindy.agents.networks import MLP

LEAK = 0.01
"""Slope of LeakyReLU below zero."""


class Traced(Protocol):
    """Actions, `(*batch, n_u)`, of observations, `(*batch, n_o)`.

    Attributes:
        actions: What the policy does.
    """

    actions: Tensor

    def slopes(self) -> list[Tensor]:
        """Return the derivative of each action by the observation, `(*batch, n_o)`."""

    def backward(self, weights: Tensor) -> None:
        """Add the gradient of the weighted sum of all actions, weights `(*batch, n_u)`, to the policy's parameters."""


def trace(network: Callable[[Tensor], Tensor], observation: Tensor) -> Traced:
    """Return the actions of a policy for observations `(*batch, n_o)`, which need no graph."""
    if isinstance(network, MLP) and network.squash:
        return Layers(network, observation.detach())
    return _Recorded(network, observation)


class _Recorded:
    """Leave the derivatives to autograd."""

    def __init__(self, network: Callable[[Tensor], Tensor], observation: Tensor) -> None:
        self.observation = observation.detach().requires_grad_()
        with torch.enable_grad():
            self.actions = network(self.observation)

    def slopes(self) -> list[Tensor]:
        """Return the derivative of each action by the observation, `(*batch, n_o)`."""
        columns = self.actions.unbind(-1)
        return [torch.autograd.grad(column.sum(), self.observation, retain_graph=True)[0] for column in columns]

    def backward(self, weights: Tensor) -> None:
        """Add the gradient of the weighted sum of all actions, weights `(*batch, n_u)`, to the policy's parameters."""
        torch.autograd.backward(self.actions, weights)


class Layers:
    """Keep the layers of a perceptron, y_k+1 = LeakyReLU(W_k y_k + b_k), u = tanh(W y + b)."""

    @torch.no_grad()
    def __init__(self, network: MLP, observation: Tensor) -> None:
        *hidden, self.last = network.layers()
        self.hidden, self.batch = hidden, observation.shape[:-1]
        self.kept = [observation.flatten(0, -2)]
        for layer in hidden:
            y = torch.addmm(layer.bias, self.kept[-1], layer.weight.mT)
            self.kept.append(torch.nn.functional.leaky_relu_(y, LEAK))
        self.u = torch.addmm(self.last.bias, self.kept[-1], self.last.weight.mT).tanh_()
        self.steep = 1 - self.u.square()  # of the tanh
        self.actions = self.u.unflatten(0, self.batch)

    @torch.no_grad()
    def slopes(self) -> list[Tensor]:
        """Return the derivative of each action by the observation, `(*batch, n_o)`."""
        found = []
        for row, steep in zip(self.last.weight, self.steep.unbind(-1)):
            slope = row.expand(len(steep), -1)
            for layer, y in zip(self.hidden[::-1], self.kept[:0:-1]):
                slope = _through(slope, y) @ layer.weight
            found.append((slope * steep.unsqueeze(-1)).unflatten(0, self.batch))
        return found

    @torch.no_grad()
    def backward(self, weights: Tensor) -> None:
        """Add the gradient of the weighted sum of all actions, weights `(*batch, n_u)`, to the policy's parameters."""
        slope = weights.reshape(self.u.shape) * self.steep
        layers = [*self.hidden, self.last]
        for k in range(len(layers) - 1, -1, -1):
            if k < len(layers) - 1:
                slope = _through(slope @ layers[k + 1].weight, self.kept[k + 1])
            _add_product(layers[k].weight, slope, self.kept[k])
            _add(layers[k].bias, slope.sum(0))


def _through(slope: Tensor, y: Tensor) -> Tensor:
    """Return a derivative by what went into LeakyReLU, of that by what came out of it, `y`."""
    return torch.ops.aten.leaky_relu_backward(slope, y, LEAK, True)


def _add(parameter: Tensor, gradient: Tensor) -> None:
    parameter.grad = gradient if parameter.grad is None else parameter.grad.add_(gradient)


def _add_product(weight: Tensor, slope: Tensor, y: Tensor) -> None:
    weight.grad = slope.mT @ y if weight.grad is None else weight.grad.addmm_(slope.mT, y)
