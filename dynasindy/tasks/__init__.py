"""What is wanted: references, reward, initial states."""

from dynasindy.tasks.base import Sampled, Task
from dynasindy.tasks.references import RandomStep, Reference, Step, Wave, target, wave
from dynasindy.tasks.reward import TrackingReward
from dynasindy.tasks.tracking import Tracking

__all__ = [
    "RandomStep",
    "Reference",
    "Sampled",
    "Step",
    "Task",
    "Tracking",
    "TrackingReward",
    "Wave",
    "target",
    "wave",
]
