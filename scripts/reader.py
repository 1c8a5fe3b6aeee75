"""Output that nobody reads on, as behind `| head`: the script ends, without a traceback."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def while_read() -> Iterator[None]:
    """End with the exit code of a broken pipe, 141, when whoever reads stdout has left."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()  # short output would first be written, and fail, after the last line of the script
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what the interpreter flushes at its end
        sys.exit(141)
