"""What moves, in SI units."""

from dynasindy.systems.base import Altered, Diverged, Signature, System
from dynasindy.systems.black_box import BlackBox
from dynasindy.systems.integrators import integrate, moved, rk4, simulate, steps_needed
from dynasindy.systems.pendulum import Pendulum
from dynasindy.systems.steps import Stops
from dynasindy.systems.tras import Tras
from dynasindy.systems.trms33 import Trms33
from dynasindy.systems.xi import Xi

__all__ = [
    "Altered",
    "BlackBox",
    "Diverged",
    "Pendulum",
    "Signature",
    "Stops",
    "System",
    "Tras",
    "Trms33",
    "Xi",
    "integrate",
    "moved",
    "rk4",
    "simulate",
    "steps_needed",
]
