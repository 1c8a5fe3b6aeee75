"""Four plants as a user writes them from docs/plant.md; `scripts/benchmark.py plants` tries the defaults on them.

PYTHONPATH=docs/examples python scripts/train.py --config-dir docs/examples/conf system=quadrotor
"""

import torch
from torch import Tensor

from dynasindy.systems import Signature, System


class VanDerPol(System):
    """Van der Pol's oscillator with a force, which swings by itself."""

    def __init__(self) -> None:
        super().__init__(Signature(("x", "v"), ("m", "m/s"), ("u",), (2.0, 3.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`."""
        p, v = x.unbind(-1)
        return torch.stack((v, 2.0 * (1 - p * p) * v - p + 5.0 * u[..., 0]), -1)


class Quadrotor(System):
    """A quadrotor in a plane, 1 kg, arms of 0.2 m; each side lifts up to 8 N."""

    def __init__(self) -> None:
        names, units = ("x", "z", "theta", "vx", "vz", "q"), ("m", "m", "rad", "m/s", "m/s", "rad/s")
        super().__init__(Signature(names, units, ("left", "right"), (2.0, 2.0, 0.5, 2.0, 2.0, 2.0)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`."""
        _, _, theta, vx, vz, q = x.unbind(-1)
        left, right = (4.0 * (u + 1)).unbind(-1)
        across, up = -(left + right) * torch.sin(theta), (left + right) * torch.cos(theta) - 9.81
        return torch.stack((vx, vz, q, across, up, (right - left) * 0.2 / 0.04), -1)


class CartPole(System):
    """A pole of 0.1 kg and 1 m on a cart of 1 kg, pushed by up to 10 N; theta = 0 is upright."""

    def __init__(self, ranges: tuple[float, ...] = (1.0, 0.3, 1.0, 1.0)) -> None:
        names, units = ("p", "theta", "v", "omega"), ("m", "rad", "m/s", "rad/s")
        super().__init__(Signature(names, units, ("force",), ranges))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`."""
        _, theta, v, omega = x.unbind(-1)
        s, c = torch.sin(theta), torch.cos(theta)
        push = (10.0 * u[..., 0] + 0.05 * omega**2 * s) / 1.1
        alpha = (9.81 * s - c * push) / (0.5 * (4 / 3 - 0.1 * c**2 / 1.1))
        return torch.stack((v, omega, push - 0.05 * alpha * c / 1.1, alpha), -1)


class Tanks(System):
    """Two tanks of 0.1 m^2, the upper one fed by a pump; outflow goes with the root of the level."""

    def __init__(self) -> None:
        super().__init__(Signature(("h1", "h2"), ("m", "m"), ("pump",), (0.5, 0.5)))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`."""
        out = 0.0028 * torch.sqrt(x.clamp_min(0.0))
        first = 0.004 * (u[..., 0] + 1) / 2 - out[..., 0]
        return torch.stack((first, out[..., 0] - out[..., 1]), -1) / 0.1
