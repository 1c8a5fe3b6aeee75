"""What is known of a plant before it is identified: which state is the rate of which."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from dynasindy.systems import Signature, System


class Kinematic(System):
    """A system whose states move at the rates that are states themselves, and otherwise stay.

    An observer on it is a local polynomial with a fading memory: a line through the latest angles, whose slope is the
    rate.

    Args:
        signature: Names, units and ranges of the plant.
        rates: Index of a state to that of its rate.
    """

    def __init__(self, signature: Signature, rates: Mapping[int, int]) -> None:
        super().__init__(signature)
        self.rates = dict(rates)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, n_x)`, of states `(*batch, n_x)`, whatever the inputs are."""
        columns = x.unbind(-1)
        still = torch.zeros_like(columns[0])
        return torch.stack([columns[self.rates[i]] if i in self.rates else still for i in range(len(columns))], -1)
