"""Run a benchmark by name: `python scripts/benchmark.py td3 [options]`."""

import importlib
import os
import pkgutil
import sys
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: one thread is what is compared
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

from places import require_writable
from reader import while_read

from dynasindy import benchmarks


def main(argv: list[str]) -> int:
    """Import the benchmark that `argv` names first and hand it the rest."""
    names = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.ispkg)
    if not argv or argv[0] not in names:
        given = f"unknown benchmark '{argv[0]}'" if argv else "no benchmark given"
        print(f"benchmark.py: {given}; choose one of: {', '.join(names)}", file=sys.stderr)
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
    importlib.import_module(f"dynasindy.benchmarks.{argv[0]}").main(argv[1:])
    return 0


if __name__ == "__main__":
    with while_read():
        sys.exit(main(sys.argv[1:]))
