"""A real plant in the loop: what a rig has to offer, and flights that end in its safe input whatever happens."""

from dynasindy.rig.base import Clock, Fault, Rig, Wiring
from dynasindy.rig.env import RigEnv
from dynasindy.rig.flight import Flown, Guard, fly
from dynasindy.rig.flights import Flights
from dynasindy.rig.inprocess import FastClock, InProcessRig
from dynasindy.rig.udp import UdpRig

__all__ = [
    "Clock",
    "FastClock",
    "Fault",
    "Flights",
    "Flown",
    "Guard",
    "InProcessRig",
    "Rig",
    "RigEnv",
    "UdpRig",
    "Wiring",
    "fly",
]
