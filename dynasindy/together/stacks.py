"""Networks of several runs side by side, all their weights in one tensor.

| name     | shape            | meaning                                                      |
| -------- | ---------------- | ------------------------------------------------------------ |
| N        |                  | networks: one of each run, or the critics of each run        |
| flat     | `(numbers,)`     | all weights, layer after layer, each of all networks         |
| weight   | `(N, n_out, n_in)` | of a layer; widths are rounded up to whole `LANES`         |

The matrix units of a GPU want rows of a multiple of 16 bytes. What the widths are rounded up by stays zero: nothing
flows through a unit whose weights are zero on both sides, and no gradient reaches it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from dynasindy.agents.networks import Layer

LANES = 8
"""Numbers of bfloat16 in 16 bytes."""


class Stack:
    """Room for the weights of networks of the same widths.

    Attributes:
        flat: All weights, `(numbers,)`.
        count: How many networks there are.

    Args:
        like: Layers of one of the networks, or of some of them, stacked: `(n_out, n_in)` or `(n_nets, n_out, n_in)`.
        count: See above.
        device: Where they lie.
    """

    def __init__(self, like: Sequence[Layer], count: int, device: torch.device) -> None:
        self.count = count
        self._widths = [tuple(layer.weight.shape[-2:]) for layer in like]
        normed = any(layer.gain is not None for layer in like)
        lanes = 1 if normed else LANES  # a mean over units would count those that are none
        self._shapes = [_shapes(layer, count, lanes, last=k == len(like) - 1) for k, layer in enumerate(like)]
        self._sizes = [math.prod(shape) for shapes in self._shapes for shape in shapes]
        self.flat = torch.zeros(sum(self._sizes), device=device)

    def twin(self, device: torch.device | None = None) -> Stack:
        """Return room of the same kind, on another device if one is named."""
        found = object.__new__(Stack)
        found.__dict__.update(self.__dict__)
        pinned = device is not None and device.type == "cpu" and self.flat.is_cuda  # the copy need not wait for it
        found.flat = torch.zeros(len(self.flat), device=device or self.flat.device, pin_memory=pinned)
        return found

    def layers(self, flat: Tensor | None = None) -> list[Layer]:
        """Return the layers of all networks, `(N, ...)`, as views of `flat`, or of what is given in its place."""
        parts = iter((self.flat if flat is None else flat).split(self._sizes))
        return [Layer(*(next(parts).view(shape) for shape in shapes)) for shapes in self._shapes]

    def of(self, first: int, beyond: int) -> list[Tensor]:
        """Return the weights of some networks, in the order of the tensors of their layers, as they are without lanes.

        Args:
            first: The first one.
            beyond: The one after the last.
        """
        found = []
        for layer, (n_out, n_in) in zip(self.layers(), self._widths, strict=True):
            weight, *rest = (part[first:beyond] for part in layer if part is not None)
            found += [weight[:, :n_out, :n_in], *(part[:, :n_out] for part in rest)]
        return found

    def sound(self, runs: int) -> Tensor:
        """Return of each run whether all of its weights are finite, bool `(runs,)`."""
        parts = [part for layer in self.layers() for part in layer if part is not None]
        return torch.stack([part.reshape(runs, -1).isfinite().all(-1) for part in parts]).all(0)


def through(layers: Sequence[Layer], x: Tensor, squash: bool, factors: torch.dtype | None = None) -> Tensor:
    """Evaluate networks side by side, as `dynasindy.agents.MLP` does each: `(N, rows, n_in)` to `(N, rows, n_out)`.

    Args:
        layers: Of a `Stack`.
        x: Inputs; fewer than the layers have room for, where that was rounded up.
        squash: Whether the networks end in Tanh.
        factors: Floating type of what the products of the hidden layers are made of, and come to; the weights' own if
            omitted. The last layer is always computed in theirs.
    """
    *hidden, last = layers
    x = F.pad(x, (0, hidden[0].weight.shape[-1] - x.shape[-1])) if x.shape[-1] < hidden[0].weight.shape[-1] else x
    for layer in hidden:
        assert layer.bias is not None
        kind = factors or layer.weight.dtype
        x = torch.bmm(x.to(kind), layer.weight.to(kind).mT).to(layer.weight.dtype) + layer.bias.unsqueeze(1)
        if layer.gain is not None and layer.shift is not None:
            x = torch.addcmul(layer.shift.unsqueeze(1), F.layer_norm(x, x.shape[-1:]), layer.gain.unsqueeze(1))
        x = F.leaky_relu(x)
    x = x.to(last.weight.dtype)
    # A product with a column is a sum, which a compiler joins to the step before it.
    column = last.weight.shape[1] == 1
    x = (x * last.weight).sum(-1, keepdim=True) if column else torch.bmm(x, last.weight.mT)
    x = x + last.bias.unsqueeze(1)
    return torch.tanh(x) if squash else x


def _shapes(layer: Layer, count: int, lanes: int, last: bool) -> list[tuple[int, ...]]:
    """Return the shapes of the tensors of a layer, of all networks; the outputs of the last one are not rounded up."""
    n_out, n_in = layer.weight.shape[-2:]
    n_in, n_out = -(-n_in // lanes) * lanes, n_out if last else -(-n_out // lanes) * lanes
    rest = sum(part is not None for part in layer) - 1
    return [(count, n_out, n_in), *[(count, n_out)] * rest]
