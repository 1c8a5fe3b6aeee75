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

from cli import HELP, pipe_guard, program, purpose, require_writable

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


def page() -> str:
    """Return what there is to be measured, in the first sentence of each benchmark; none is imported."""
    lines = [purpose("benchmark"), ""]
    for name in BENCHMARKS:
        lines.append(f"  {name:<{max(map(len, BENCHMARKS))}}  {summary(name)}")
    return "\n".join([*lines, "", f"The options of one:  {program('benchmark')} {BENCHMARKS[0]} --help"])


def run(argv: Sequence[str]) -> int:
    """Read the command line of the benchmark that `argv` names first, then import it and let it work."""
    if argv and argv[0] in HELP:
        print(page())
        return 0
    if not argv or argv[0] not in BENCHMARKS:
        given = f"unknown benchmark '{argv[0]}'" if argv else "no benchmark given"
        print(f"benchmark.py: {given}; choose one of: {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    name = argv[0]
    arguments = parse(name, argv[1:], program("benchmark"))
    if arguments.out is not None:
        try:
            require_writable(arguments.out.parent)
        except OSError as error:
            why = f"--out {arguments.out} cannot be written: {error.strerror}; choose another"
            print(f"benchmark.py: {why}", file=sys.stderr)
            return 2
    importlib.import_module(f"benchmarks.{name}").main(arguments)  # it takes seconds
    return 0


def main() -> None:
    """Run what the command line names."""
    with pipe_guard():
        sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
