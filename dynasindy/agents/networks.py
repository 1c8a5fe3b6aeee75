"""Multi-layer perceptrons of the TD3 agent, callable with any set of parameters.

The paper's agent has two hidden layers of 400 and 300 LeakyReLU units and a Tanh output (case study).
TorchRL's loss modules keep online and target parameters apart from the network, and stack the critics along
a leading dimension. `MLP.functional` evaluates such a set on plain tensors: one batched product per layer.
"""

from collections.abc import Sequence
from itertools import pairwise, zip_longest
from typing import NamedTuple

import torch
import torch.nn.functional as F
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ValueOperator


class Layer(NamedTuple):
    """Tensors of one layer; stacked networks carry a leading dimension `(n_nets, ...)`.

    Attributes:
        weight: `(*nets, n_out, n_in)`.
        bias: `(*nets, n_out)`.
        gain: scale of the layer normalisation `(*nets, n_out)`, or None without it.
        shift: offset of the layer normalisation `(*nets, n_out)`, or None without it.
    """

    weight: Tensor
    bias: Tensor
    gain: Tensor | None = None
    shift: Tensor | None = None

    def first(self) -> "Layer":
        """Return the first network of a stack, detached from the graph."""
        weight, bias = self.weight.detach()[0], self.bias.detach()[0]
        if self.gain is None or self.shift is None:
            return Layer(weight, bias)
        return Layer(weight, bias, self.gain.detach()[0], self.shift.detach()[0])


class MLP(nn.Module):
    """Perceptron with LeakyReLU hidden layers.

    Args:
        n_in: width of the concatenated inputs.
        n_out: width of the output.
        hidden: widths of the hidden layers.
        layer_norm: normalise each hidden layer before its activation.
        squash: end in Tanh.

    Raises:
        ValueError: a width is not positive, or there is no hidden layer.
    """

    def __init__(
        self, n_in: int, n_out: int, hidden: Sequence[int], *, layer_norm: bool = False, squash: bool = False
    ) -> None:
        widths = [n_in, *hidden, n_out]
        if len(widths) < 3 or min(widths) < 1:
            raise ValueError(
                f"MLP widths are {widths} (inputs, hidden, outputs); give at least one hidden layer and "
                "positive widths, such as agent.hidden=[400, 300]."
            )
        super().__init__()
        self.linears = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for width in hidden if layer_norm)
        self.squash = squash

    def forward(self, *inputs: Tensor) -> Tensor:
        """Map inputs `(*batch, n_i)`, concatenated along the last dimension, to `(*batch, n_out)` on their device."""
        there = next(self.parameters()).device
        return self.functional(self.layers(), *(x.to(there) for x in inputs)).to(inputs[0].device)

    def layers(self, parameters: TensorDictBase | None = None) -> list[Layer]:
        """List the tensors of each layer, from `parameters` (a TensorDict of this module) or its own."""
        if parameters is None:
            pairs = [(linear.weight, linear.bias) for linear in self.linears]
            norms = [(norm.weight, norm.bias) for norm in self.norms]
        else:
            pairs = [_pair(parameters, "linears", i) for i in range(len(self.linears))]
            norms = [_pair(parameters, "norms", i) for i in range(len(self.norms))]
        return [Layer(*pair, *norm) for pair, norm in zip_longest(pairs, norms, fillvalue=())]

    def functional(self, layers: Sequence[Layer], *inputs: Tensor) -> Tensor:
        """Evaluate with given tensors: `(*batch, n_out)`, or `(n_nets, batch, n_out)` for stacked ones.

        Stacked networks take one batch for all, `(batch, n_i)`, or one for each, `(n_nets, batch, n_i)`.
        """
        x = torch.cat(inputs, -1) if len(inputs) > 1 else inputs[0]
        *hidden, last = layers
        if last.weight.dim() == 3 and x.dim() == 2:
            x = x.expand(last.weight.shape[0], *x.shape)
        for layer in hidden:
            x = _linear(x, layer)
            x = F.leaky_relu_(x if layer.gain is None else _normalise(x, layer))
        x = _linear(x, last)
        return torch.tanh(x) if self.squash else x


def actor(n_obs: int, n_u: int, hidden: Sequence[int]) -> TensorDictModule:
    """Return the deterministic policy, `observation (*batch, n_obs)` to `action (*batch, n_u)` in [-1, 1]."""
    network = MLP(n_obs, n_u, hidden, squash=True)
    return TensorDictModule(network, in_keys=["observation"], out_keys=["action"])


class Actor:
    """A policy alone, for planning by gradient, which needs neither critics nor a storage.

    Attributes:
        policy: `observation` to `action`, deterministic.
        deployed: The same.

    Args:
        n_obs: width of `observation`.
        n_u: width of `action`.
        hidden: widths of the hidden layers.
        seed: seed of the initial weights, which are those of a `TD3` of the same seed and widths.
    """

    def __init__(self, n_obs: int, n_u: int, hidden: Sequence[int] = (128, 128), seed: int = 0) -> None:
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.policy = self.deployed = actor(n_obs, n_u, hidden)


def critic(n_obs: int, n_u: int, hidden: Sequence[int], layer_norm: bool = False) -> ValueOperator:
    """Return one critic, `observation` and `action` to `state_action_value (*batch, 1)`."""
    network = MLP(n_obs + n_u, 1, hidden, layer_norm=layer_norm)
    return ValueOperator(network, in_keys=["observation", "action"])


def _pair(parameters: TensorDictBase, kind: str, index: int) -> tuple[Tensor, Tensor]:
    return parameters.get((kind, str(index), "weight")), parameters.get((kind, str(index), "bias"))


def _linear(x: Tensor, layer: Layer) -> Tensor:
    if layer.weight.dim() == 2:
        return F.linear(x, layer.weight, layer.bias)
    return torch.baddbmm(layer.bias.unsqueeze(1), x, layer.weight.mT)


def _normalise(x: Tensor, layer: Layer) -> Tensor:
    if layer.weight.dim() == 2:
        return F.layer_norm(x, x.shape[-1:], layer.gain, layer.shift)
    assert layer.gain is not None
    assert layer.shift is not None
    return torch.addcmul(layer.shift.unsqueeze(1), F.layer_norm(x, x.shape[-1:]), layer.gain.unsqueeze(1))
