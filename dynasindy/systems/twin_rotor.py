"""What the twin-rotor plants share: names, units, ranges, the stops of the beam and two-branched rotors."""

from __future__ import annotations

import math

from torch import Tensor

from dynasindy.systems.base import Signature
from dynasindy.systems.steps import Stops

SIGNATURE = Signature(
    state_names=("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p"),
    state_units=("rad", "rad", "rad/s", "rad/s", "rpm", "rpm"),
    input_names=("u_a", "u_p"),
    x_scale=(1.0, 1.0, 1.0, 1.0, 4000.0, 2500.0),
)
"""State order of the paper, eq. (states): azimuth, pitch, their rates, tail- and main-rotor speed."""


def beam_stops(azimuth: float = 6.0, pitch: float = math.pi / 2) -> Stops:
    """Return the stops of the beam, by default those of the vendor's simulation.

    Args:
        azimuth: Half range of the azimuth angle [rad].
        pitch: Half range of the pitch angle [rad].

    Raises:
        ValueError: A half range is not positive.
    """
    return Stops(positions=(0, 1), rates=(2, 3), low=(-azimuth, -pitch), high=(azimuth, pitch))


def two_branches(w: Tensor, positive: float, negative: float) -> Tensor:
    """Return a coefficient of a rotor that differs with its sense of turning, in the dtype of `w`.

    Args:
        w: Rotor speed, `(*batch,)` [any unit].
        positive: The coefficient where w >= 0.
        negative: The coefficient elsewhere.
    """
    # torch.where of two numbers would round them to float32 under a float64 w.
    return negative + (positive - negative) * (w >= 0).to(w.dtype)
