"""What benchmarks share: options, the commit of a row, commands called as a user does, stopwatches, open loop."""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.evaluation.scenarios import Policy
from dynasindy.planning import Planned, Planner
from dynasindy.safe_io import Row, append_rows, read_rows
from dynasindy.sindy.delay import delay_inputs
from dynasindy.systems.base import System
from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path("docs/results")


def add_choices(parser: argparse.ArgumentParser, name: str, choices: Sequence[str], default: Any = None) -> None:
    """Add an option of several names out of those that there are, by default all."""
    parser.add_argument(name, nargs="+", choices=list(choices), default=list(default or choices))


def add_seeds(parser: argparse.ArgumentParser, number: int) -> None:
    """Add the option of the seeds, by default 0 to `number` - 1."""
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(number)), help="seeds to measure")


def add_written(parser: argparse.ArgumentParser, path: Path, least: int, what: str) -> None:
    """Add the option of the file that is written; the published one only where enough was measured."""
    told = f"CSV file to write; {path} by default, nothing if there are fewer than {least} {what}"
    parser.add_argument("--out", type=Path, help=told)


def add_output(parser: argparse.ArgumentParser, name: str) -> None:
    """Add the option of the file that rows are appended to."""
    parser.add_argument("--out", type=Path, default=RESULTS / f"{name}.csv", help="CSV file to append to")


def run_command(command: str, words: Sequence[str], folder: Path, modules: Sequence[Path] = ()) -> tuple[float, str]:
    """Return the CPU time that a command took [s], and the end of what it wrote to standard error.

    Args:
        command: Its name, such as `train`.
        words: What is given on the command line.
        folder: Where it is called.
        modules: Folders besides the package from which it imports.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / f"{command}.py"), *words],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(filter(None, [*map(str, modules), str(ROOT), os.environ.get("PYTHONPATH")])),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stderr[-500:]


def measure_seeds(arguments: Namespace, columns: Sequence[str], measure: Callable[[str, int], list[Row]]) -> None:
    """Measure plants over seeds and append their rows to a file, but for those that it has already.

    Args:
        arguments: Names as `plants`, numbers as `seeds`, and the file as `out`.
        columns: Columns of the file; `plant` and `seed` among them.
        measure: Returns the rows of a plant and a seed.
    """
    done = {(row["plant"], int(row["seed"])) for row in read_rows(arguments.out)}
    for seed in arguments.seeds:
        for plant in [name for name in arguments.plants if (name, seed) not in done]:
            rows = measure(plant, seed)
            append_rows(arguments.out, columns, rows)
            for row in rows:
                print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)


def cpu_seconds() -> float:
    """Return the CPU time of this process and of the compilers that it has called [s]."""
    called = os.times()
    return time.process_time() + called.children_user + called.children_system


class Stopwatch:
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


class TimedPlanner(Planner):
    """A planner that tells of each finished phase.

    Args:
        planner: The planner.
        finished: Called with the number of updates of the phase.
    """

    def __init__(self, planner: Planner, finished: Callable[[int], None]) -> None:
        super().__init__(planner.every)
        self.planner, self.finished = planner, finished

    def plan(self) -> Planned:
        """Plan once."""
        planned = self.planner.plan()
        self.finished(planned.updates)
        return planned

    def distrust(self) -> None:
        """Pass it on."""
        self.planner.distrust()


class TimedPolicy:
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


TABLES = ":(top,exclude)docs/results"
"""Tables that a benchmark appends to: its first row does not change the code that measures the second."""


def commit(checkout: Path | None = None) -> str:
    """Return the commit of a checkout, with `-dirty` where its code was changed, "unknown" outside of one.

    Args:
        checkout: its folder; that of this package if omitted.
    """
    git = ["git", "-C", str(checkout or Path(__file__).parent)]
    try:
        # An installed package may lie in a checkout of something else, which does not track its files.
        own = __file__ if checkout is None else "pyproject.toml"
        subprocess.run([*git, "ls-files", "--error-unmatch", own], capture_output=True, check=True)
        asked = [*git, "describe", "--always", "--exclude", "*"]
        name = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ":(top)", TABLES], capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{name}-dirty" if changed.returncode else name


def simulate(model: System, x0: Tensor, data: Transitions, substeps: int) -> Tensor:
    """Return the states of an open-loop simulation, `(N + 1, n_x)`, under the inputs as they take effect.

    Args:
        model: What is simulated, with the delay of its inputs if it has one.
        x0: State at the beginning, `(n_x,)`.
        data: Recording whose inputs and sampling time are read.
        substeps: Runge-Kutta steps in a sample.
    """
    late = delay_inputs(data, float(getattr(model, "delay", 0.0)))
    states = [x0]
    with torch.no_grad():
        for u in late.u:
            x = states[-1]
            for _ in range(substeps):
                x = rk4(model, x, u, data.dt / substeps)
            states.append(x)
    return torch.stack(states)
