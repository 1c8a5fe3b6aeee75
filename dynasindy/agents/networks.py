"""Multi-layer perceptrons of the TD3 agent, callable with any set of parameters.

The paper's agent has two hidden layers of 400 and 300 LeakyReLU units and a Tanh output (case study).
TorchRL's loss modules keep online and target parameters apart from the network, and stack the critics along
a leading dimension. `MLP.functional` evaluates such a set on plain tensors: one batched product per layer.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, cast

import torch
import torch.nn.functional as F
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn


class Layer(NamedTuple):
    """Tensors of one layer; stacked networks carry a leading dimension `(n_nets, ...)`.

    Attributes:
        weight: `(*nets, n_out, n_in)`.
        bias: `(*nets, n_out)`.
    """

    weight: Tensor
    bias: Tensor


class MLP(nn.Module):
    """Perceptron with LeakyReLU hidden layers.

    Args:
        n_in: width of the concatenated inputs.
        n_out: width of the output.
        hidden: widths of the hidden layers.
        squash: end in Tanh.
    """

    def __init__(self, n_in: int, n_out: int, hidden: Sequence[int], *, squash: bool = False) -> None:
        super().__init__()
        self.linears = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise([n_in, *hidden, n_out]))
        self.squash = squash

    def forward(self, *inputs: Tensor) -> Tensor:
        """Map inputs `(*batch, n_i)`, concatenated along the last dimension, to `(*batch, n_out)` on their device."""
        layers = self.layers()
        there = layers[0].weight.device
        return self.functional(layers, *(x.to(there) for x in inputs)).to(inputs[0].device)

    def layers(self, parameters: TensorDictBase | None = None) -> list[Layer]:
        """List the tensors of each layer, from `parameters` (a TensorDict of this module) or its own."""
        if parameters is None:
            return [Layer(linear.weight, linear.bias) for linear in cast("list[nn.Linear]", list(self.linears))]
        names = [("linears", str(i)) for i in range(len(self.linears))]
        return [Layer(*(parameters.get((*name, kind)) for kind in ("weight", "bias"))) for name in names]

    def functional(self, layers: Sequence[Layer], *inputs: Tensor) -> Tensor:
        """Evaluate with given tensors: `(*batch, n_out)`, or `(n_nets, batch, n_out)` for stacked ones.

        Stacked networks take one batch for all, `(batch, n_i)`, or one for each, `(n_nets, batch, n_i)`.
        """
        x = torch.cat(inputs, -1) if len(inputs) > 1 else inputs[0]
        *hidden, last = layers
        if last.weight.dim() == 3 and x.dim() == 2:
            x = x.expand(last.weight.shape[0], *x.shape)
        for layer in hidden:
            x = F.leaky_relu_(_linear(x, layer))
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


def _linear(x: Tensor, layer: Layer) -> Tensor:
    if layer.weight.dim() == 2:
        return F.linear(x, layer.weight, layer.bias)
    return torch.baddbmm(layer.bias.unsqueeze(1), x, layer.weight.mT)


LINE = 64
"""Bytes at whose multiples the room for a batch begins, as the widest numbers of a processor do."""
Pointers = ctypes.POINTER(ctypes.c_void_p)


def line_of(room: Tensor) -> ctypes.c_void_p:
    """Return where the first line of a processor's cache begins in some room."""
    return ctypes.c_void_p(-(-room.data_ptr() // LINE) * LINE)


class NetworkPointers(ctypes.Structure):
    """A perceptron as `c/perceptron.c` reads it."""

    _fields_ = (
        ("depth", ctypes.c_int),
        ("widths", ctypes.POINTER(ctypes.c_int)),
        ("weight", Pointers),
        ("bias", Pointers),
    )


def network_pointers(layers: Sequence[Layer]) -> NetworkPointers:
    """Return where the tensors of layers lie; they must stay there, and not be freed, as long as it is used."""
    widths = [layers[0].weight.shape[-1], *(layer.bias.shape[-1] for layer in layers)]
    weights, biases = zip(*((layer.weight, layer.bias) for layer in layers))
    return NetworkPointers(
        len(layers), (ctypes.c_int * len(widths))(*widths), pointers_to(weights), pointers_to(biases)
    )


def pointers_to(tensors: Sequence[Tensor]) -> ctypes._Pointer[ctypes.c_void_p]:
    """Return where tensors lie, one address each."""
    addresses = (ctypes.c_void_p * len(tensors))(*(tensor.data_ptr() for tensor in tensors))
    return ctypes.cast(addresses, Pointers)
