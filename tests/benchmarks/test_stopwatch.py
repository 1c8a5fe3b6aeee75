"""Stopwatches: what they count, and what they leave out."""

import os

import pytest
import torch
from benchmarks import stopwatch
from tensordict import TensorDict

from dynasindy.planning import Planned, Planner


@pytest.fixture
def clock(monkeypatch):
    """Time that goes on when told."""
    now = {"wall": 0.0, "cpu": 0.0, "called": 0.0}
    monkeypatch.setattr(stopwatch.time, "perf_counter", lambda: now["wall"])
    monkeypatch.setattr(stopwatch.time, "process_time", lambda: now["cpu"])
    # user and system, of the process and of those that it called; then the time since some moment
    monkeypatch.setattr(
        stopwatch.os, "times", lambda: os.times_result((9.0, 9.0, 0.75 * now["called"], 0.25 * now["called"], 9.0))
    )
    return now


def test_a_pause_is_left_out(clock):
    run = stopwatch.Watch()
    clock.update(wall=2.0, cpu=1.0)
    run.stop(30)
    clock.update(wall=50.0, cpu=40.0)
    run.start()
    clock.update(wall=53.0, cpu=42.0, called=0.5)
    run.stop(10)
    assert run.costs() == {"updates": 40, "wall_seconds": 5.0, "cpu_seconds": 3.5}


class Recording(Planner):
    distrusted = 0

    def plan(self):
        return Planned(updates=7)

    def distrust(self):
        self.distrusted += 1


def test_a_watched_planner_tells_of_its_phases_and_passes_all_on():
    told, planner = [], Recording(3)
    watched = stopwatch.Watched(planner, told.append)
    assert watched.plan().updates == 7 and told == [7]
    watched.distrust()
    assert planner.distrusted == 1
    assert [watched.due(number) for number in (1, 2, 3)] == [False, False, True]


def test_the_time_of_a_policy_is_that_of_its_calls(clock):
    def slow(tensordict):
        clock["cpu"] += 0.25
        return tensordict.set("action", torch.ones(1))

    timed = stopwatch.Timed(slow)
    for _ in range(2):
        clock["cpu"] += 10.0
        assert timed(TensorDict({}))["action"] == 1
    assert (timed.seconds, timed.calls) == (0.5, 2)
