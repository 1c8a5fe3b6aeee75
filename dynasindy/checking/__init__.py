"""What a model says of a controller before it touches metal: stability, margins, worst cases, recovery, noise."""

from dynasindy.checking.check import Check, Settings, check
from dynasindy.checking.closed_loop import ClosedLoop
from dynasindy.checking.verdict import Thresholds, check_verdict

__all__ = ["Check", "ClosedLoop", "Settings", "Thresholds", "check", "check_verdict"]
