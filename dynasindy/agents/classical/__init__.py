"""Classical controllers to compare with: PID, LQI and MPC, as policies that read `state` and `reference`."""

from dynasindy.agents.classical.base import Controller, TrackingController
from dynasindy.agents.classical.linearise import Equilibria, jacobians, zero_order_hold
from dynasindy.agents.classical.lqi import LQI
from dynasindy.agents.classical.mpc import MPC, Cost
from dynasindy.agents.classical.mpc_program import Horizon
from dynasindy.agents.classical.pid import PID, Gains
from dynasindy.agents.classical.tuning import Trial, Tuning, tuned_lqi, tuned_pid

__all__ = [
    "LQI",
    "MPC",
    "PID",
    "Controller",
    "Cost",
    "Equilibria",
    "Gains",
    "Horizon",
    "TrackingController",
    "Trial",
    "Tuning",
    "jacobians",
    "tuned_lqi",
    "tuned_pid",
    "zero_order_hold",
]
