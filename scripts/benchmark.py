"""Run a benchmark by name: `python scripts/benchmark.py gradient [options]`."""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: one thread is what is compared
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

from cli import HELP, pipe_guard, program, purpose, refuse, require_writable

BENCHMARKS = ("gradient", "identify", "logs", "peers", "plants", "rigs")
"""Modules of `benchmarks`, each with a `main` and with `add_options` for its command line."""


def parse(name: str, argv: Sequence[str]) -> argparse.Namespace:
    """Return what a command line gives a benchmark; a mistake or `--help` ends the program."""
    module = importlib.import_module(f"benchmarks.{name}")
    described = (module.__doc__ or "").partition("\n\n")[0]
    parser = argparse.ArgumentParser(prog=f"{program('benchmark')} {name}", description=described)
    module.add_options(parser)
    return parser.parse_args(argv)


def main() -> None:
    """Read the command line of the benchmark that its first word names, and let it work."""
    with pipe_guard():
        name, *words = sys.argv[1:] or ["none"]
        if name in HELP:
            print(purpose("benchmark"), f"Benchmarks, each with --help: {', '.join(BENCHMARKS)}", sep="\n")
            return
        if name not in BENCHMARKS:
            refuse(f"there is no benchmark '{name}'; choose one of: {', '.join(BENCHMARKS)}")
        arguments = parse(name, words)
        try:
            if arguments.out is not None:
                require_writable(arguments.out.parent)
        except OSError as error:
            refuse(f"--out {arguments.out} cannot be written: {error.strerror}; choose another")
        importlib.import_module(f"benchmarks.{name}").main(arguments)


if __name__ == "__main__":
    main()
