"""Classical controllers to compare with: LQI and PID, as policies that read `state` and `reference`."""

from dynasindy.agents.classical.base import TrackingController
from dynasindy.agents.classical.linearise import Equilibria, jacobians, zero_order_hold
from dynasindy.agents.classical.lqi import LQI
from dynasindy.agents.classical.pid import PID, Gains, Tuning

__all__ = [
    "LQI",
    "PID",
    "Equilibria",
    "Gains",
    "TrackingController",
    "Tuning",
    "jacobians",
    "zero_order_hold",
]
