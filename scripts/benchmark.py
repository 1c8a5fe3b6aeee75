"""Run a benchmark by name: `python scripts/benchmark.py td3 [options]`."""

import ast
import importlib
import os
import pkgutil
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: one thread is what is compared
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

from commands import HELP, called, purpose
from places import require_writable
from reader import while_read

from dynasindy import benchmarks


def names() -> list[str]:
    """Return the names of the benchmarks."""
    return sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.ispkg)


def page() -> str:
    """Return what there is to be measured, in the first sentence of each benchmark; none is imported."""
    lines = [purpose("benchmark"), ""]
    for name in names():
        source = Path(benchmarks.__path__[0]) / f"{name}.py"
        words = " ".join((ast.get_docstring(ast.parse(source.read_text())) or "").partition("\n\n")[0].split())
        lines.append(f"  {name:<{max(map(len, names()))}}  {words}")
    return "\n".join([*lines, "", f"The options of one:  {called('benchmark')} {names()[0]} --help"])


def run(argv: Sequence[str]) -> int:
    """Import the benchmark that `argv` names first and hand it the rest."""
    if argv and argv[0] in HELP:
        print(page())
        return 0
    if not argv or argv[0] not in names():
        given = f"unknown benchmark '{argv[0]}'" if argv else "no benchmark given"
        print(f"benchmark.py: {given}; choose one of: {', '.join(names())}", file=sys.stderr)
        return 2
    for word, value in pairwise([*argv, ""]):
        if word == "--out" and value:
            try:
                require_writable(Path(value).parent)
            except OSError as error:
                print(
                    f"benchmark.py: --out {value} cannot be written: {error.strerror}; choose another", file=sys.stderr
                )
                return 2
    importlib.import_module(f"dynasindy.benchmarks.{argv[0]}").main(list(argv[1:]))
    return 0


def main() -> None:
    """Run what the command line names."""
    with while_read():
        sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
