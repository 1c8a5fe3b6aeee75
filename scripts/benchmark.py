"""Run a benchmark by name: `python scripts/benchmark.py td3 [options]`."""

import importlib
import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: one thread is what is compared
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

from benchmarks.arguments import names, parsed, told
from commands import HELP, called, purpose
from places import require_writable
from reader import while_read


def page() -> str:
    """Return what there is to be measured, in the first sentence of each benchmark; none is imported."""
    lines = [purpose("benchmark"), ""]
    for name in names():
        lines.append(f"  {name:<{max(map(len, names()))}}  {told(name)}")
    return "\n".join([*lines, "", f"The options of one:  {called('benchmark')} {names()[0]} --help"])


def run(argv: Sequence[str]) -> int:
    """Read the command line of the benchmark that `argv` names first, then import it and let it work."""
    if argv and argv[0] in HELP:
        print(page())
        return 0
    if not argv or argv[0] not in names():
        given = f"unknown benchmark '{argv[0]}'" if argv else "no benchmark given"
        print(f"benchmark.py: {given}; choose one of: {', '.join(names())}", file=sys.stderr)
        return 2
    name = argv[0]
    arguments = parsed(name, argv[1:], called("benchmark"))
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
    with while_read():
        sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
