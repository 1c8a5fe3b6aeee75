"""What benchmarks share: options, rows and their commit, commands called as a user does, costs, plants in words."""

from __future__ import annotations

import argparse
import csv
import math
import os
import random
import resource
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.safe_io import Row, read_rows
from dynasindy.systems import Signature, System
from dynasindy.systems.tras import TrasConstants

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path("docs/results")
NAMES = {name: getattr(torch, name) for name in ("sin", "cos", "tanh", "exp", "sqrt", "abs", "sign")}
NAMES |= {"at_least": torch.clamp_min, "log": math.log, "pi": math.pi}
"""What equations and numbers of YAML files may name besides states and inputs."""


class EquationSystem(System):
    """A plant out of equations in words.

    Args:
        signature: Names, units and ranges.
        let: Formulas by the name that the later ones may use.
        rates: Formula of the rate of change of each state, under inputs in their own units.
    """

    def __init__(self, signature: Signature, let: Mapping[str, str], rates: Mapping[str, str]) -> None:
        super().__init__(signature)
        self.lines = [(name, compile(formula, name, "eval")) for name, formula in (*let.items(), *rates.items())]
        self.shared = len(let)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, n_x)`."""
        given = zip((*self.signature.state_names, *self.signature.input_names), (*x.unbind(-1), *u.unbind(-1)))
        scope: dict[str, Any] = {**NAMES, **dict(given)}
        for name, code in self.lines[: self.shared]:
            scope[name] = eval(code, scope)
        rates = [eval(code, scope) for _, code in self.lines[self.shared :]]
        return torch.stack(torch.broadcast_tensors(*rates), -1)


def add_choices(parser: argparse.ArgumentParser, name: str, choices: Iterable[str]) -> None:
    """Add an option of several names out of those that there are, by default all."""
    parser.add_argument(name, nargs="+", choices=list(choices), default=list(choices))


def add_seeds(parser: argparse.ArgumentParser, number: int) -> None:
    """Add the option of the seeds, by default 0 to `number` - 1."""
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(number)), help="seeds to measure")


def add_output(parser: argparse.ArgumentParser, name: str) -> None:
    """Add the option of the file that rows are appended to."""
    parser.add_argument("--out", type=Path, default=RESULTS / f"{name}.csv", help="CSV file to append to")


def append(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Append rows to a CSV file, with the commit that measured them, and print them."""
    stamped = [{**row, "commit": commit()} for row in rows]
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writerows([dict(zip(columns, columns, strict=True)), *stamped] if new else stamped)
    for row in stamped:
        print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)


def carry_on(
    path: Path,
    columns: Sequence[str],
    names: Sequence[str],
    keys: Iterable[tuple[Any, ...]],
    measure: Callable[..., list[Row]],
) -> None:
    """Measure what a CSV file does not hold yet, and append its rows.

    Args:
        path: The file.
        columns: Its columns.
        names: Columns that tell what was measured.
        keys: Their values, of all that is asked for.
        measure: Returns the rows of such values.
    """
    for key in keys:
        if not any([row[name] for name in names] == list(map(str, key)) for row in read_rows(path)):
            append(path, columns, measure(*key))


def measure_plants(arguments: Namespace, columns: Sequence[str], measure: Callable[[str, int], list[Row]]) -> None:
    """Measure `plants` over `seeds` of a command line and append their rows to its file `out`."""
    keys = [(plant, seed) for seed in arguments.seeds for plant in arguments.plants]
    carry_on(arguments.out, columns, ("plant", "seed"), keys, measure)


def run_command(command: str, words: Sequence[str], folder: Path, result: Path, modules: Sequence[Path] = ()) -> float:
    """Return the CPU time that a command took [s].

    Args:
        command: Its name, such as `train`.
        words: What is given on the command line.
        folder: Where it is called.
        result: A file that it is to leave.
        modules: Folders besides the package from which it imports.

    Raises:
        RuntimeError: It left no such file.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    given = [sys.executable, str(ROOT / "scripts" / f"{command}.py"), *words]
    places = os.pathsep.join(filter(None, [*map(str, modules), str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": places}
    done = subprocess.run(given, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if not result.is_file():
        ended = f"ended with {done.returncode} and no {result.name}: {done.stderr[-500:]}"
        raise RuntimeError(f"{command}.py {' '.join(words)} {ended}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def cpu_seconds() -> float:
    """Return the CPU time of this process and of the compilers that it has called [s]."""
    called = os.times()
    return time.process_time() + called.children_user + called.children_system


TABLES = ":(top,exclude)docs/results"
"""Tables that a benchmark appends to: its first row does not change the code that measures the second."""


def commit() -> str:
    """Return the commit of this checkout, with `-dirty` where its code was changed, "unknown" outside of one."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        # An installed package may lie in a checkout of something else, which does not track its files.
        subprocess.run([*git, "ls-files", "--error-unmatch", __file__], capture_output=True, check=True)
        asked = [*git, "describe", "--always", "--exclude", "*"]
        name = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ":(top)", TABLES], capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{name}-dirty" if changed.returncode else name


def detuned(constants: TrasConstants, spread: float, seed: int) -> TrasConstants:
    """Return constants, each times a factor of its own, uniform in [1 - spread, 1 + spread]."""
    rng = random.Random(seed)

    def _off(value: Any) -> Any:
        return tuple(map(_off, value)) if isinstance(value, tuple) else value * (1 + spread * rng.uniform(-1, 1))

    return replace(constants, **{field.name: _off(getattr(constants, field.name)) for field in fields(constants)})
