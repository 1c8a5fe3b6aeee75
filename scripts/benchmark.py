"""Run a benchmark by name: `python scripts/benchmark.py gradient [options]`."""

import argparse
import ast
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: one thread is what is compared
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

from cli import HELP, pipe_guard, program, purpose, refuse, require_writable

BENCHMARKS = ("bench_surrogate", "gradient", "identify", "logs", "peers", "plants", "rigs")
"""Modules of `benchmarks`, each with a `main` and with `add_options` for its command line."""


def summary(name: str) -> str:
    """Return the first paragraph of a benchmark's docstring as one line; the benchmark is not imported."""
    place = Path(__file__).parent / "benchmarks" / name
    source = (place / "__init__.py" if place.is_dir() else place.with_suffix(".py")).read_text()
    return " ".join((ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0].split())


def parse(name: str, argv: Sequence[str], program: str = "benchmark.py") -> argparse.Namespace:
    """Return what a command line gives a benchmark; a mistake or `--help` ends the program."""
    parser = argparse.ArgumentParser(prog=f"{program} {name}", description=summary(name))
    importlib.import_module(f"benchmarks.{name}").add_options(parser)
    return parser.parse_args(argv)


def main() -> None:
    """Read the command line of the benchmark that its first word names, then import it and let it work."""
    with pipe_guard():
        name, *words = sys.argv[1:] or ["none"]
        if name in HELP:
            print(purpose("benchmark"), "", sep="\n")
            print(*(f"  {each:<{max(map(len, BENCHMARKS))}}  {summary(each)}" for each in BENCHMARKS), sep="\n")
            print(f"\nThe options of one:  {program('benchmark')} {BENCHMARKS[0]} --help")
            return
        if name not in BENCHMARKS:
            refuse(f"there is no benchmark '{name}'; choose one of: {', '.join(BENCHMARKS)}")
        arguments = parse(name, words, program("benchmark"))
        if arguments.out is not None:
            try:
                require_writable(arguments.out.parent)
            except OSError as error:
                refuse(f"--out {arguments.out} cannot be written: {error.strerror}; choose another")
        importlib.import_module(f"benchmarks.{name}").main(arguments)  # it takes seconds


if __name__ == "__main__":
    main()
