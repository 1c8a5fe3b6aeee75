"""`pendulum`: a damped pendulum with a torque at its pivot, the smallest plant to try things on."""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import Signature, System


class Pendulum(System):
    """A point mass on a rod, angle measured from hanging down.

    theta'' = -(g / l) sin(theta) - b / (m l^2) theta' + tau_max u / (m l^2)

    Args:
        mass: Mass m [kg].
        length: Length l of the rod [m].
        damping: Viscous friction b [N m s/rad].
        max_torque: Torque tau_max at u = 1 [N m].

    Raises:
        ValueError: Mass, length or torque is not positive, or the damping is negative.
    """

    machine_code = True

    def __init__(self, mass: float = 1.0, length: float = 1.0, damping: float = 0.5, max_torque: float = 12.0) -> None:
        super().__init__(Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (1.0, 3.0)))
        if not (mass > 0 and length > 0 and max_torque > 0 and damping >= 0):
            raise ValueError(
                f"mass, length and max_torque must be positive and damping >= 0, got mass={mass}, "
                f"length={length}, damping={damping}, max_torque={max_torque}; use SI units"
            )
        inertia = mass * length**2
        self.gravity_term = 9.81 / length
        self.damping_term = damping / inertia
        self.input_gain = max_torque / inertia

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 2)`, of states `(*batch, 2)` under inputs `(*batch, 1)` in [-1, 1]."""
        theta, rate = x.unbind(-1)
        acceleration = self.input_gain * u[..., 0] - self.gravity_term * torch.sin(theta) - self.damping_term * rate
        return torch.stack((rate, acceleration), -1)
