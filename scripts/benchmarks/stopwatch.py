"""Stopwatches: of a run, of its planning phases, of a policy."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from tensordict import TensorDictBase

from dynasindy.evaluation.scenarios import Policy
from dynasindy.planning import Planned, Planner
from dynasindy.safe_io import Row


def cpu_seconds() -> float:
    """Return the CPU time of this process and of the compilers that it has called [s]."""
    called = os.times()
    return time.process_time() + called.children_user + called.children_system


class Watch:
    """Wall and CPU time and updates of a run, evaluation left out."""

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0
        self.updates = 0
        self.start()

    def start(self) -> None:
        """Go on."""
        self.since = time.perf_counter(), cpu_seconds()

    def stop(self, updates: int) -> None:
        """Pause after a phase of so many updates."""
        self.wall += time.perf_counter() - self.since[0]
        self.cpu += cpu_seconds() - self.since[1]
        self.updates += updates

    def costs(self) -> Row:
        """Return updates and times as columns of a row."""
        return {"updates": self.updates, "wall_seconds": round(self.wall, 1), "cpu_seconds": round(self.cpu, 1)}


class Watched(Planner):
    """A planner that tells of each finished phase.

    Args:
        planner: The planner.
        told: Called with the number of updates of the phase.
    """

    def __init__(self, planner: Planner, told: Callable[[int], None]) -> None:
        super().__init__(planner.every)
        self.planner, self.told = planner, told

    def plan(self) -> Planned:
        """Plan once."""
        planned = self.planner.plan()
        self.told(planned.updates)
        return planned

    def distrust(self) -> None:
        """Pass it on."""
        self.planner.distrust()


class Timed:
    """A policy whose computing time is counted, in CPU time of one thread.

    Args:
        policy: The policy.
    """

    def __init__(self, policy: Policy) -> None:
        self.policy, self.seconds, self.calls = policy, 0.0, 0

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Act."""
        start = time.process_time()
        acted = self.policy(tensordict)
        self.seconds, self.calls = self.seconds + time.process_time() - start, self.calls + 1
        return acted
