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

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.twin_rotor import SIGNATURE, beam_stops, two_branches

_DRAG_TAIL = (0.0872, 0.00577), (0.0864, 0.00678)  # u per krpm and per krpm^2, for w >= 0 and w < 0
_DRAG_MAIN = (0.0604, 0.0504)
_THRUST_TAIL = (0.01114, 0.02206)  # N per krpm^2, for w >= 0 and w < 0
_THRUST_MAIN = (0.0735, 0.0475)


class Tras(System):
    """The bench that the paper's laboratory uses (1/I_h = 37000, 1/I_v = 6100 rpm/s per unit input).

    Args:
        azimuth_stop: Half range of the azimuth angle [rad].
        pitch_stop: Half range of the pitch angle [rad].
        azimuth_friction: Viscous friction k_h of the azimuth axis [N m s/rad].

    Raises:
        ValueError: A half range is not positive, or the friction is negative.
    """

    def __init__(
        self, azimuth_stop: float = 6.0, pitch_stop: float = torch.pi / 2, azimuth_friction: float = 0.00588996
    ) -> None:
        super().__init__(SIGNATURE, beam_stops(azimuth_stop, pitch_stop))
        if not azimuth_friction >= 0:
            raise ValueError(f"azimuth_friction must be >= 0 N m s/rad, got {azimuth_friction}; the bench has 0.0059")
        self.azimuth_friction = azimuth_friction

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`, of states `(*batch, 6)` under inputs `(*batch, 2)` in [-1, 1]."""
        _, pitch, rate_a, rate_p, speed_a, speed_p = x.unbind(-1)
        u_a, u_p = u.unbind(-1)
        c, s = torch.cos(pitch), torch.sin(pitch)
        w_a, w_p = 1e-3 * speed_a, 1e-3 * speed_p  # krpm
        square_a, square_p = w_a * w_a.abs(), w_p * w_p.abs()
        (g1, g2), (g1n, g2n) = _DRAG_TAIL
        drag_a = two_branches(w_a, g1, g1n) * w_a + two_branches(w_a, g2, g2n) * square_a  # g_h(omega_a)
        drag_p = _DRAG_MAIN[0] * w_p + _DRAG_MAIN[1] * square_p  # g_v(omega_p)
        thrust_a = two_branches(w_a, *_THRUST_TAIL) * square_a  # F_h(omega_a)
        thrust_p = two_branches(w_p, *_THRUST_MAIN) * square_p  # F_v(omega_p)
        inertia_a = 0.02379038 * c * c + 0.00300962  # J_h(alpha_p) [kg m^2]
        torque_a = (
            0.216 * thrust_a * c
            - self.azimuth_friction * rate_a
            + 0.01782004 * u_p * c
            + 2 * 0.02379038 * s * c * rate_a * rate_p
        )
        torque_p = (
            0.202 * thrust_p
            - 0.0127095 * rate_p
            - 0.05005756 * c
            - 0.09360078 * s
            - 0.0212485 * rate_a * rate_a * s * c
            + 0.00417495 * u_a
        )
        return torch.stack(
            (
                rate_a,
                rate_p,
                torque_a / inertia_a,
                torque_p / 0.03005808,
                37000 * (u_a - drag_a),
                6100 * (u_p - drag_p),
            ),
            -1,
        )
