"""`tras`: the Inteco two-rotor aerodynamical system, from first principles.

Sources: Inteco TRAS user's manual; Gu, Petkov, Konstantinov, Robust Control Design with MATLAB. The rotor
characteristics are compact fits to the bench tables.

| name                  | symbol   | unit    |
| --------------------- | -------- | ------- |
| azimuth, pitch angle  | alpha_a, alpha_p | rad |
| azimuth, pitch rate   | Omega_a, Omega_p | rad/s |
| tail-, main-rotor speed | omega_a, omega_p | rpm |
| normalised inputs     | u_a, u_p | 1       |
| thrusts               | F_h, F_v | N       |
| rotor statics         | g_h, g_v | 1       |
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.twin_rotor import SIGNATURE, beam_stops, two_branches


@dataclass(frozen=True)
class TrasConstants:
    """Constants of the bench; tuples hold the values for a rotor speed w >= 0 and w < 0.

    Attributes:
        inertia_a: c^2-part and constant part of J_h [kg m^2].
        inertia_p: Moment of inertia of the pitch axis [kg m^2].
        arm_a: Lever of the tail thrust [m].
        arm_p: Lever of the main thrust [m].
        friction_a: Viscous friction k_h of the azimuth axis [N m s/rad].
        friction_p: Viscous friction of the pitch axis [N m s/rad].
        gravity_c: Gravity torque that goes with cos(alpha_p) [N m].
        gravity_s: Gravity torque that goes with sin(alpha_p) [N m].
        centrifugal: Coefficient of Omega_a^2 sin cos [kg m^2].
        coupling_a: Torque of u_p on the azimuth axis [N m].
        coupling_p: Torque of u_a on the pitch axis [N m].
        motor_a: Acceleration of the tail rotor per unit input, 1/I_h [rpm/s].
        motor_p: Acceleration of the main rotor per unit input, 1/I_v [rpm/s].
        drag_a: Linear part of g_h [1/krpm].
        drag_a_square: Quadratic part of g_h [1/krpm^2].
        drag_p: Linear and quadratic part of g_v [1/krpm, 1/krpm^2].
        thrust_a: F_h [N/krpm^2].
        thrust_p: F_v [N/krpm^2].
    """

    inertia_a: tuple[float, float] = (0.02379038, 0.00300962)
    inertia_p: float = 0.03005808
    arm_a: float = 0.216
    arm_p: float = 0.202
    friction_a: float = 0.00588996
    friction_p: float = 0.0127095
    gravity_c: float = 0.05005756
    gravity_s: float = 0.09360078
    centrifugal: float = 0.0212485
    coupling_a: float = 0.01782004
    coupling_p: float = 0.00417495
    motor_a: float = 37000.0
    motor_p: float = 6100.0
    drag_a: tuple[float, float] = (0.0872, 0.0864)
    drag_a_square: tuple[float, float] = (0.00577, 0.00678)
    drag_p: tuple[float, float] = (0.0604, 0.0504)
    thrust_a: tuple[float, float] = (0.01114, 0.02206)
    thrust_p: tuple[float, float] = (0.0735, 0.0475)


class Tras(System):
    """The bench that the paper's laboratory uses (1/I_h = 37000, 1/I_v = 6100 rpm/s per unit input).

    Args:
        azimuth_stop: Half range of the azimuth angle [rad].
        pitch_stop: Half range of the pitch angle [rad].
        constants: Constants of the bench; those of the manual if omitted.

    Raises:
        ValueError: A half range is not positive.
    """

    machine_code = True

    def __init__(
        self, azimuth_stop: float = 6.0, pitch_stop: float = torch.pi / 2, constants: TrasConstants | None = None
    ) -> None:
        super().__init__(SIGNATURE, beam_stops(azimuth_stop, pitch_stop))
        self.constants = constants or TrasConstants()

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`, of states `(*batch, 6)` under inputs `(*batch, 2)` in [-1, 1]."""
        k = self.constants
        _, pitch, rate_a, rate_p, speed_a, speed_p = x.unbind(-1)
        u_a, u_p = u.unbind(-1)
        c, s = torch.cos(pitch), torch.sin(pitch)
        w_a, w_p = 1e-3 * speed_a, 1e-3 * speed_p  # krpm
        square_a, square_p = w_a * w_a.abs(), w_p * w_p.abs()
        drag_a = two_branches(w_a, *k.drag_a) * w_a + two_branches(w_a, *k.drag_a_square) * square_a  # g_h(omega_a)
        drag_p = k.drag_p[0] * w_p + k.drag_p[1] * square_p  # g_v(omega_p)
        thrust_a = two_branches(w_a, *k.thrust_a) * square_a  # F_h(omega_a)
        thrust_p = two_branches(w_p, *k.thrust_p) * square_p  # F_v(omega_p)
        torque_a = (
            k.arm_a * thrust_a * c
            - k.friction_a * rate_a
            + k.coupling_a * u_p * c
            + 2 * k.inertia_a[0] * s * c * rate_a * rate_p
        )
        torque_p = (
            k.arm_p * thrust_p
            - k.friction_p * rate_p
            - k.gravity_c * c
            - k.gravity_s * s
            - k.centrifugal * rate_a * rate_a * s * c
            + k.coupling_p * u_a
        )
        return torch.stack(
            (
                rate_a,
                rate_p,
                torque_a / (k.inertia_a[0] * c * c + k.inertia_a[1]),  # J_h(alpha_p)
                torque_p / k.inertia_p,
                k.motor_a * (u_a - drag_a),
                k.motor_p * (u_p - drag_p),
            ),
            -1,
        )
