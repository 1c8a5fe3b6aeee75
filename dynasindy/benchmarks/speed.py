"""What machine code is worth: each job with it and without it, one after the other in one run, in CPU seconds.

The controller is that of `benchmark.py gradient`, case `step`: ten seconds of data, the fit, planning, and no more. The
CPU time of the compiler counts. Seconds depend on the computer and on what else it does; their ratio hardly does.

The job `start-up` is another comparison: what a run takes until its work begins, and `import torch` alone.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from unittest.mock import patch

import gymnasium
import numpy as np
import torch

from dynasindy.benchmarks.gradient import CASES, build_recipe
from dynasindy.benchmarks.instruments.commit import commit
from dynasindy.benchmarks.instruments.watch import cpu_seconds
from dynasindy.dyna.callback import Callback
from dynasindy.dyna.loop import train
from dynasindy.evaluation.rows import Row, read_rows, write_rows
from dynasindy.systems import System
from dynasindy.systems.compiler import forget
from dynasindy.world_models import SindyModel

STEPS, REPEATS = 1000, 7
"""Control periods of the environment that are timed, and how often; other jobs disturb the least time least."""
EPISODES = 5
"""Real episodes of imagined replay; with 800 rollouts, most seeds hold the required level after four."""
TO_THE_LEVEL = (
    *("experiment=dyna", "system=xi", "planning.rollouts=800"),
    *(f"train.episodes={EPISODES}", "evaluation.must_improve=false"),
)
STARTS = {
    True: ("-m", "dynasindy", "train", "experiment=smoke"),
    False: ("-c", "import torch; print('Imported', flush=True)"),
}
"""Words of Python for a run, and for what no run can do without; each prints a line when it is ready."""
IN_TORCH = ("world_model.machine_code=false", "agent.machine_code=false")


def main(arguments: argparse.Namespace) -> None:
    """Time every job and write the table."""
    torch.set_num_threads(1)
    jobs: dict[str, Callable[[bool], float]] = {
        "environment": environment,
        **{f"controller {plant}": _controllers(plant, arguments.seeds) for plant in ("xi", "tras")},
        "imagined replay xi": imagined_replay,
        "start-up": start_up,
    }
    asked = arguments.jobs or list(jobs)
    before = read_rows(arguments.out) if arguments.jobs and arguments.out.is_file() else []
    rows = [row for row in before if row["job"] not in asked] + [measure(name, jobs[name]) for name in asked]
    write_rows(arguments.out, list(rows[0]), rows)
    print(f"written to {arguments.out}")


def measure(name: str, job: Callable[[bool], float]) -> Row:
    """Return a job's seconds with machine code and without, and their ratio."""
    with_code, without = job(True), job(False)
    row: Row = {
        "job": name,
        "machine_code_cpu_seconds": float(f"{with_code:.4g}"),
        "torch_cpu_seconds": float(f"{without:.4g}"),
        "ratio": round(without / with_code, 2),
        "commit": commit(),
    }
    print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    return row


def environment(machine_code: bool) -> float:
    """Return the CPU seconds of a control period of `dynasindy/TwinRotor-v0`, stepped one at a time [s]."""
    with _compiled(machine_code):
        env = gymnasium.make("dynasindy/TwinRotor-v0")
        env.reset(seed=0)
        action = np.zeros(2, dtype=np.float32)
        env.step(action)  # the first step calls the compiler
        times = []
        for _ in range(REPEATS):
            start = cpu_seconds()
            for _ in range(STEPS):
                if env.step(action)[3]:
                    env.reset()
            times.append((cpu_seconds() - start) / STEPS)
        return min(times)


def _controllers(plant: str, seeds: list[int]) -> Callable[[bool], float]:
    return lambda machine_code: statistics.median(controller(plant, seed, machine_code) for seed in seeds)


def controller(plant: str, seed: int, machine_code: bool) -> float:
    """Return the CPU seconds from nothing to a controller [s]."""
    recipe = build_recipe(replace(CASES["step"], episodes=0), plant, seed, {})
    forget()  # or only the first seed would pay for the compiler
    with _compiled(machine_code):
        start = cpu_seconds()
        train(recipe.build(), recipe.train, Callback())
        return cpu_seconds() - start


def imagined_replay(machine_code: bool) -> float:
    """Return the CPU seconds of a whole command: 800 imagined rollouts a phase, to the required level on `xi` [s]."""
    with tempfile.TemporaryDirectory() as folder:
        words = [*TO_THE_LEVEL, *(() if machine_code else IN_TORCH), f"hydra.run.dir={folder}"]
        start = cpu_seconds()
        subprocess.run([sys.executable, "scripts/train.py", *words], check=True, stdout=subprocess.DEVNULL)
        return cpu_seconds() - start


def start_up(ours: bool) -> float:
    """Return the CPU seconds until a run has composed and built all that it needs, or of `import torch` alone [s].

    Raises:
        RuntimeError: the command did not start.
    """
    seconds = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            words = [sys.executable, *STARTS[ours], *((f"hydra.run.dir={folder}",) if ours else ())]
            start = cpu_seconds()
            with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                line = process.stdout.readline()
                process.kill()
            seconds.append(cpu_seconds() - start)
            if not line.startswith(("Run folder", "Imported")):
                raise RuntimeError(f"{' '.join(words)} did not start; run it to see why")
    return min(seconds)


def _compiled(machine_code: bool) -> ExitStack:
    """Let plants and models move by torch code alone, if that is asked, as where there is no compiler."""
    stack = ExitStack()
    for kind in () if machine_code else (System, SindyModel):
        stack.enter_context(patch.object(kind, "compiled", return_value=None))
    return stack
