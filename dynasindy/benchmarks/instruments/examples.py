"""Two textbook systems with an input in one equation: what identification from noisy states is measured on."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import Signature, System


class VanDerPol(System):
    """The oscillator of van der Pol, which comes to a limit cycle: x' = y, y' = mu (1 - x^2) y - x + gain u.

    Args:
        mu: strength of the damping [1/s].
        gain: what a full input adds to y' [1/s^2].
    """

    def __init__(self, mu: float = 1.0, gain: float = 3.0) -> None:
        super().__init__(Signature(("x", "y"), ("-", "1/s"), ("u",), (2.0, 3.0)))
        self.mu, self.gain = mu, gain

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`, of states `(*batch, 2)` under inputs `(*batch, 1)`."""
        place, rate = x.unbind(-1)
        return torch.stack((rate, self.mu * (1 - place.square()) * rate - place + self.gain * u[..., 0]), -1)


class Lorenz(System):
    """The chaotic system of Lorenz: x' = sigma (y - x) + gain u, y' = x (rho - z) - y, z' = x y - beta z.

    Args:
        sigma: rate of x [1/s].
        rho: height of the fixed points plus one.
        beta: decay of z [1/s].
        gain: what a full input adds to x' [1/s].
    """

    def __init__(self, sigma: float = 10.0, rho: float = 28.0, beta: float = 8 / 3, gain: float = 50.0) -> None:
        super().__init__(Signature(("x", "y", "z"), ("-", "-", "-"), ("u",), (20.0, 25.0, 40.0)))
        self.sigma, self.rho, self.beta, self.gain = sigma, rho, beta, gain

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 3)`, of states `(*batch, 3)` under inputs `(*batch, 1)`."""
        a, b, c = x.unbind(-1)
        first = self.sigma * (b - a) + self.gain * u[..., 0]
        return torch.stack((first, a * (self.rho - c) - b, a * b - self.beta * c), -1)
