"""What a model says of a controller before it touches metal: stability, margins, worst cases, recovery, noise."""

from dynasindy.checking.check import Check, Settings, check
from dynasindy.checking.findings import Thresholds
from dynasindy.checking.loop import Loop
from dynasindy.checking.plant import Plant
from dynasindy.checking.verdict import verdict

__all__ = ["Check", "Loop", "Plant", "Settings", "Thresholds", "check", "verdict"]
