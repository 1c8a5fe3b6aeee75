"""`trms33`: the Feedback 33-007 twin rotor, with Coulomb friction that no library of functions holds.

Source: Tastemirov, Lecchini-Visintini, Morales 2017. The paper's state order is kept: azimuth first.

| name                    | symbol           | unit  |
| ----------------------- | ---------------- | ----- |
| azimuth, pitch angle    | phi, psi         | rad   |
| azimuth, pitch rate     | phi', psi'       | rad/s |
| tail-, main-rotor speed | w_t, w_m         | rpm   |
| inputs                  | U / 2.5 V        | 1     |
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.twin_rotor import SIGNATURE, beam_stops, two_branches

_RPM = 60 / (2 * math.pi)
_VOLTS = 2.5  # V at u = 1
_TORQUE = 0.0202  # N m/A, motor constant of both motors
_LEVER_MAIN, _LEVER_TAIL = 0.254, 0.275  # m
_I_MAIN, _I_TAIL = 1.7249e-4, 3.2170e-5  # kg m^2
_I_PSI, _I_PHI, _I_C = 6.1644e-2, 2.1117e-2, 8.3286e-2  # kg m^2
_F_PSI, _F_PHI, _F_MAIN, _F_TAIL = 4.2150e-4, 1.1243e-4, 4.1993e-6, 3.2498e-6  # N m s/rad
_COULOMB_PSI, _COULOMB_PHI = 4.0548e-4, 1.1758e-5  # N m
_THRUST_MAIN, _THRUST_TAIL = (1.4971e-5, 8.9974e-6), (3.7755e-6, 2.3046e-6)  # N s^2, for w >= 0 and w < 0
_DRAG_MAIN, _DRAG_TAIL = 4.7815e-7, 9.8104e-8  # N m s^2
_CABLE = 9.8664e-3  # N m/rad
_G_Z, _G_Y = -0.25254, 0.15032  # N m
_H_Z, _H_Y = -1.9525e-3, 6.6120e-3  # kg m^2


def _thrust(w: Tensor, gains: tuple[float, float]) -> Tensor:
    return two_branches(w, *gains) * w * w.abs()


class Trms33(System):
    """The Feedback 33-007 rig, for robustness and transfer; its cable is slack at the origin."""

    machine_code = True

    def __init__(self) -> None:
        super().__init__(SIGNATURE, beam_stops(2.8, 1.0))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`, of states `(*batch, 6)` under inputs `(*batch, 2)` in [-1, 1]."""
        phi, psi, dphi, dpsi, rpm_t, rpm_m = x.unbind(-1)
        w_t, w_m = rpm_t / _RPM, rpm_m / _RPM
        i_t = (6.5 * _VOLTS * u[..., 0] - _TORQUE * w_t) / 8
        i_m = (8.5 * _VOLTS * u[..., 1] - _TORQUE * w_m) / 8
        c, s, s2 = torch.cos(psi), torch.sin(psi), torch.sin(2 * psi)
        inertia = _I_PHI + (_I_C - _I_MAIN) * c * c  # D
        h = _H_Z * c + _H_Y * s
        torque_m = _TORQUE * i_m - _F_MAIN * w_m  # T_m
        n_phi = (
            (-_H_Z * s + _H_Y * c) * dpsi**2
            + _I_C * dphi * dpsi * s2
            + _I_MAIN * w_m * dpsi * s
            + _thrust(w_t, _THRUST_TAIL) * _LEVER_TAIL * c
            - _F_PHI * dphi
            - _COULOMB_PHI * torch.tanh(20 * dphi)
            - _CABLE * phi
            - c * (_I_MAIN * dpsi * dphi * s + torque_m)
        )
        n_psi = (
            -0.5 * _I_C * dphi**2 * s2
            - _I_MAIN * w_m * dphi * s
            + _G_Z * s
            - _G_Y * c
            + _thrust(w_m, _THRUST_MAIN) * _LEVER_MAIN
            - _F_PSI * dpsi
            - _COULOMB_PSI * torch.tanh(20 * dpsi)
            - _TORQUE * i_t
            + _F_TAIL * w_t
        )
        ddpsi = (n_psi + h / inertia * n_phi) / (_I_PSI - _I_TAIL - h * h / inertia)
        ddphi = (n_phi + h * ddpsi) / inertia
        dw_m = (torque_m - _DRAG_MAIN * w_m * w_m.abs()) / _I_MAIN - ddphi * c + dpsi * dphi * s
        dw_t = (_TORQUE * i_t - _F_TAIL * w_t - _DRAG_TAIL * w_t * w_t.abs()) / _I_TAIL - ddpsi
        return torch.stack((dphi, dpsi, ddphi, ddpsi, _RPM * dw_t, _RPM * dw_m), -1)
