"""A real plant in the loop: what a rig has to offer, and flights that end in its safe input whatever happens."""

from dynasindy.rig.base import Fault, Rig, Wiring
from dynasindy.rig.flight import Flown, Guard, fly
from dynasindy.rig.udp import UdpRig

__all__ = ["Fault", "Flown", "Guard", "Rig", "UdpRig", "Wiring", "fly"]
