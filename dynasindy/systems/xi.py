"""`xi`: the identified model of the paper, used as a plant (table "SINDY model Xi matrix").

Its 19 non-zero coefficients lie in the paper's 27-function library, so it is the exact ground truth for
identification. `xi` and `tras` are two different plants: the azimuth damping (-10.06), the x3^2 sin x2
coefficient and two signs of the table do not follow from the equations of `tras`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynasindy.systems.base import System
from dynasindy.systems.twin_rotor import SIGNATURE, beam_stops


class Xi(System):
    """The published sparse model as a plant."""

    machine_code = True

    def __init__(self) -> None:
        super().__init__(SIGNATURE, beam_stops(6.0, torch.pi / 2))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`, of states `(*batch, 6)` under inputs `(*batch, 2)` in [-1, 1]."""
        _, x2, x3, x4, x5, x6 = x.unbind(-1)
        u1, u2 = u.unbind(-1)
        c, s = torch.cos(x2), torch.sin(x2)
        return torch.stack(
            (
                x3,
                x4,
                -10.0573 * x3 + (9.8316e-4 * x5 - 0.7025 * u2 + 0.9479) * c,
                0.5961 - 0.414 * x4 + 0.0013 * x6 + 0.1303 * u1 - (16.3547 * x3 * x3 + 3.54373) * s - 1.7473 * c,
                262.7 - 5.2281 * x5 + 3.7e4 * u1,
                -8.54 - 1.4193 * x6 + 6.1e3 * u2,
            ),
            -1,
        )
