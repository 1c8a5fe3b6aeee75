"""A real plant in the loop: what a rig has to offer, and flights that end in its safe input whatever happens."""

from dynasindy.rig.base import Fault, Rig, RigClock, Wiring
from dynasindy.rig.env import RigEnv
from dynasindy.rig.flight import FlightResult, Guard, run_flight
from dynasindy.rig.flights import FlightSequence
from dynasindy.rig.inprocess import FastClock, InProcessRig
from dynasindy.rig.udp import UdpRig

__all__ = [
    "FastClock",
    "Fault",
    "FlightResult",
    "FlightSequence",
    "Guard",
    "InProcessRig",
    "Rig",
    "RigClock",
    "RigEnv",
    "UdpRig",
    "Wiring",
    "run_flight",
]
