"""A real plant in the loop: what a rig has to offer, and flights that end in its safe input whatever happens."""

from dynasindy.rig.base import Fault, Rig, RigClock, Wiring
from dynasindy.rig.flight import FlightResult, Guard, run_flight
from dynasindy.rig.udp import UdpRig

__all__ = [
    "Fault",
    "FlightResult",
    "Guard",
    "Rig",
    "RigClock",
    "UdpRig",
    "Wiring",
    "run_flight",
]
