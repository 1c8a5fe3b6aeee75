"""Run a benchmark by name: `python scripts/benchmark.py gradient [options]`."""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: one thread is what is compared
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

from cli import pipe_guard, program, purpose

BENCHMARKS = ("gradient", "identify", "logs", "peers", "plants", "rigs")
"""Modules of `benchmarks`, each with a `main` and with `add_options` for its command line."""


def parse(name: str, argv: Sequence[str]) -> argparse.Namespace:
    """Return what a command line gives a benchmark; a mistake or `--help` ends the program."""
    module = importlib.import_module(f"benchmarks.{name}")
    parser = argparse.ArgumentParser(f"{program('benchmark')} {name}", description=module.__doc__.partition("\n\n")[0])
    module.add_options(parser)
    return parser.parse_args(argv)


def main() -> None:
    """Read the command line of the benchmark that its first word names, and let it work."""
    parser = argparse.ArgumentParser(program("benchmark"), argparse.SUPPRESS, purpose("benchmark"))
    parser.add_argument("name", nargs="?", default="none", choices=BENCHMARKS, help="each has options and a --help")
    with pipe_guard():
        name = parser.parse_args(sys.argv[1:2]).name
        importlib.import_module(f"benchmarks.{name}").main(parse(name, sys.argv[2:]))


if __name__ == "__main__":
    main()
