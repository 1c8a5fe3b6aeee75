"""What moves, in SI units."""

from dynasindy.systems.base import Altered, Signature, System
from dynasindy.systems.diverged import Diverged
from dynasindy.systems.integrators import flight, integrate, moved, repeated, rk4, steps_needed
from dynasindy.systems.pendulum import Pendulum
from dynasindy.systems.stops import Stops
from dynasindy.systems.tras import Tras
from dynasindy.systems.trms33 import Trms33
from dynasindy.systems.unknown import Unknown
from dynasindy.systems.xi import Xi

__all__ = [
    "Altered",
    "Diverged",
    "Pendulum",
    "Signature",
    "Stops",
    "System",
    "Tras",
    "Trms33",
    "Unknown",
    "Xi",
    "flight",
    "integrate",
    "moved",
    "repeated",
    "rk4",
    "steps_needed",
]
