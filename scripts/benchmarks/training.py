"""Commands, called as a user does, and a benchmark of plants and seeds that goes on where it was stopped."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path

from dynasindy.safe_io import Row, append_rows, read_rows

ROOT = Path(__file__).resolve().parents[2]


def called(command: str, words: Sequence[str], folder: Path, modules: Sequence[Path] = ()) -> tuple[float, str]:
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


def over_seeds(arguments: Namespace, columns: Sequence[str], measure: Callable[[str, int], list[Row]]) -> None:
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
