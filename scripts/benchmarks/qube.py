"""The Quanser QUBE-Servo 2 with pendulum: its published physics, and errors of predictions from filtered states."""

from __future__ import annotations

import copy
import math
from types import SimpleNamespace
from typing import Any, cast

import torch
from torch import Tensor

from dynasindy.sensing import Observer, Sensors
from dynasindy.sindy.delay import delay_inputs
from dynasindy.systems.base import Signature, System
from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions

STEP = 2 * math.pi / 2048
"""Resolution of both encoders [rad]."""
ARM, ROD, ARM_LENGTH, ROD_LENGTH = 0.095, 0.024, 0.085, 0.129
"""Masses [kg] and lengths [m] of the rotor arm and the pendulum; companion data of arXiv 2303.15318."""
MOTOR, OHMS, VOLTS, GRAVITY = 0.042, 8.4, 10.0, 9.81
"""Constant of the motor [V s/rad, N m/A], its resistance [ohm], full input [V], and gravity [m/s^2]."""
HORIZONS = (20, 50)
"""Samples of 10 ms ahead: 0.2 and 0.5 s; over 1 s an error of the start state grows a million times."""
LAST = 100
"""Samples at the end of a log from which nothing is predicted."""


class PublishedQube(System):
    """Rotary inverted pendulum by Lagrange's equations, without friction, `alpha = 0` upright.

    Args:
        signature: theta, alpha, dtheta, dalpha and u.
    """

    def __init__(self, signature: Signature) -> None:
        super().__init__(signature)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`, of states `(*batch, 4)` under inputs `(*batch, 1)` in [-1, 1]."""
        _, alpha, dtheta, dalpha = x.unbind(-1)
        s, c = alpha.sin(), alpha.cos()
        torque = MOTOR * (VOLTS * u[..., 0] - MOTOR * dtheta) / OHMS
        rod = ROD * ROD_LENGTH**2
        across = 0.5 * ROD * ROD_LENGTH * ARM_LENGTH
        m11 = ARM * ARM_LENGTH**2 / 3 + ROD * ARM_LENGTH**2 + rod / 3 * s.square()
        m12, m22 = across * c, rod / 3
        b1 = torque - 2 / 3 * rod * s * c * dtheta * dalpha + across * s * dalpha.square()
        b2 = rod / 3 * s * c * dtheta.square() + 0.5 * ROD * ROD_LENGTH * GRAVITY * s
        det = m11 * m22 - m12.square()
        return torch.stack((dtheta, dalpha, (m22 * b1 - m12 * b2) / det, (m11 * b2 - m12 * b1) / det), -1)


def ahead(model: System, train: Transitions, test: Transitions) -> tuple[Tensor, Tensor]:
    """Return the errors of a model and of the last value held, each `(horizons, 2)` for theta and alpha, RMSE [rad].

    The states from which a prediction starts are those of a Kalman filter on the same model, which reads the angles up
    to that moment; its process noise is the one that suits the training log.

    Args:
        model: what predicts; its states are both angles and their rates, in this order.
        train: log on which the filter is set.
        test: log to predict, from every 0.1 s after the first half second.
    """
    names = model.signature.state_names
    channels: Any = {name: {"resolution": STEP} for name in names[:2]}
    sensors = Sensors(channels=channels, rates=dict(zip(names[:2], names[2:], strict=True)))
    delay = float(getattr(model, "delay", 0.0))
    env = cast(Any, SimpleNamespace(dt=train.dt, substeps=2, stops=None))
    if delay:
        model = copy.copy(model)
        cast(Any, model).delay = 0.0  # the filter reads inputs as they take effect
    observer = Observer(model, sensors, env)
    known, late = delay_inputs(train, delay), delay_inputs(test, delay)
    observer.learn(torch.cat([known.x, known.x_next[-1:]]), known.u)
    y = torch.cat([late.x, late.x_next[-1:]])
    with torch.no_grad():
        states = observer.follow(y, late.u)[0]
        starts = torch.arange(50, len(late) - LAST, 10)
        x, errors, held = states[starts], [], []
        for k in range(max(HORIZONS)):
            for _ in range(2):
                x = rk4(model, x, late.u[starts + k], late.dt / 2)
            if k + 1 in HORIZONS:
                after = y[starts + k + 1, :2]
                errors.append((x[:, :2] - after).square().mean(0).sqrt())
                held.append((y[starts, :2] - after).square().mean(0).sqrt())
    return torch.stack(errors), torch.stack(held)
