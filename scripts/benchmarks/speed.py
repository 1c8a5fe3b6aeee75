"""What machine code is worth: each job with it and without it, one after the other in one run, in CPU seconds.

The controller is that of `benchmark.py gradient`, case `step`: ten seconds of data, the fit, planning, and no more. The
CPU time of the compiler counts. Seconds depend on the computer and on what else it does; their ratio hardly does.

`start-up` is another comparison: what a run takes until its work begins, and `import torch` alone.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import gymnasium
import numpy as np
import torch

from benchmarks.common import ROOT, add_choices, add_seeds, commit, cpu_seconds
from benchmarks.gradient import CASES, build_recipe
from dynasindy.dyna.callback import Callback
from dynasindy.dyna.loop import train
from dynasindy.safe_io import Row, read_rows, write_rows
from dynasindy.sindy import SindyModel
from dynasindy.systems import System
from dynasindy.systems.compiler import forget

COLUMNS = ["job", "cpu_seconds", "beside", "beside_cpu_seconds", "ratio", "commit"]
STEPS, REPEATS = 1000, 7
"""Control periods of the environment that are timed, and how often; other jobs disturb the least time least."""
EPISODES = 5
"""Real episodes of imagined replay; with 800 rollouts, most seeds hold the required level after four."""
TO_THE_LEVEL = ("experiment=dyna", "system=xi", "planning.rollouts=800", f"train.episodes={EPISODES}")
STARTS = {
    True: ("-m", "dynasindy", "train", "experiment=smoke"),
    False: ("-c", "import torch; print('Imported', flush=True)"),
}
"""Words of Python for a run, and for what no run can do without; each prints a line when it is ready."""
IN_TORCH = ("world_model.machine_code=false", "agent.machine_code=false")


@dataclass(frozen=True)
class Job:
    """What is timed.

    Attributes:
        seconds: CPU seconds of it [s], of our way (True) or of the other one (False), for seeds.
        beside: what the other way is called.
    """

    seconds: Callable[[bool, list[int]], float]
    beside: str = "torch code"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_seeds(parser, 3)
    parser.add_argument("--out", type=Path, default=Path("docs/results/speed.csv"), help="CSV file to write")
    add_choices(parser, "--jobs", tuple(JOBS))


def main(arguments: argparse.Namespace) -> None:
    """Time the jobs that are asked for and write the table, which keeps its rows of the others.

    Raises:
        SystemExit: The file is another table.
    """
    torch.set_num_threads(1)
    kept = read_rows(arguments.out)
    if kept and list(kept[0]) != COLUMNS:
        columns = f"{', '.join(kept[0])}, and these rows have {', '.join(COLUMNS)}"
        raise SystemExit(f"benchmark.py speed: {arguments.out} has the columns {columns}; give another file by --out")
    rows = [row for row in kept if row["job"] not in arguments.jobs]
    rows += [measure(name, JOBS[name], arguments.seeds) for name in arguments.jobs]
    write_rows(arguments.out, COLUMNS, rows)
    print(f"written to {arguments.out}")


def measure(name: str, job: Job, seeds: list[int]) -> Row:
    """Return a job's seconds in our way and in the other one, and their ratio."""
    ours, other = job.seconds(True, seeds), job.seconds(False, seeds)
    row: Row = {
        "job": name,
        "cpu_seconds": float(f"{ours:.4g}"),
        "beside": job.beside,
        "beside_cpu_seconds": float(f"{other:.4g}"),
        "ratio": round(other / ours, 2),
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
        subprocess.run([sys.executable, "scripts/train.py", *words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
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


JOBS = {
    "environment": Job(lambda ours, seeds: environment(ours)),
    "controller xi": Job(lambda ours, seeds: statistics.median(controller("xi", seed, ours) for seed in seeds)),
    "controller tras": Job(lambda ours, seeds: statistics.median(controller("tras", seed, ours) for seed in seeds)),
    "imagined replay xi": Job(lambda ours, seeds: imagined_replay(ours)),
    "start-up": Job(lambda ours, seeds: start_up(ours), "import torch"),
}
"""The jobs of the table; its row `imagined replay xi before` is of an earlier commit."""
