"""The EMPS axis with its published constants: a mass, viscous and dry friction, a push."""

from __future__ import annotations

import torch

from dynasindy.sindy.model import SindyModel
from dynasindy.systems.base import Signature, System

MASS, VISCOUS, DRY, PUSH = 95.1089, 203.5034, 20.3935, -3.1648
"""Mass [kg], friction [N s/m] and [N], and push against the axis [N]: Janot, Gautier and Brunot, EMPS, 2019."""
FORCE = 100.0
"""Force of a full input [N]."""


def published_axis(signature: Signature) -> SindyModel:
    """Return `M v' = F - 203.5 v - 20.4 sign(v) + 3.2`, the sign as steep as that of a fitted model.

    Args:
        signature: the place q [m], the speed v [m/s] and the input u [100 N].
    """
    model = SindyModel(signature, ["1", "u", "v", "tanh(1000 v)"])
    forces = torch.tensor([-PUSH, FORCE, -VISCOUS, -DRY], dtype=torch.float64)
    place = torch.tensor([0.0, 0.0, 1.0, 0.0], dtype=torch.float64)
    model.set_coefficients(torch.stack([place, forces / MASS], 1))
    return model


def steady_force(model: System, speed: float) -> float:
    """Return the force [N] at which a model keeps a speed [m/s] in the middle of the axis, at 0.125 m.

    Args:
        model: states are the place [m] and the speed [m/s], the input is the force in 100 N.
        speed: what is kept.
    """
    x = torch.tensor([0.125, speed], dtype=torch.float64)
    with torch.no_grad():
        none, full = (float(model(x, torch.tensor([u], dtype=torch.float64))[1]) for u in (0.0, 1.0))
    return FORCE * none / (none - full)
