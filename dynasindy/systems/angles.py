"""Units of angles."""

import math

TURNS = {
    **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180),
    "mrad": 1e-3,
    **dict.fromkeys(("rev", "turn", "turns"), 2 * math.pi),
}
"""Units of angles that are not rad, in rad."""


def turn_of(unit: str) -> float:
    """Return how much one turn is in a unit of angles, such as 360 deg; infinite in any other unit."""
    return 2 * math.pi if unit == "rad" else 2 * math.pi / TURNS[unit] if unit in TURNS else math.inf
