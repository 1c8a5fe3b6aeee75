"""Output that nobody reads on, as behind `| head`: the script ends, without a traceback."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import UnsupportedOperation


@contextmanager
def while_read() -> Iterator[None]:
    """End with the exit code of a broken pipe, 141, when whoever reads stdout has left; other errors stay theirs."""
    try:
        yield
    except SystemExit as end:
        if not _reader_left() or end.code:
            raise
        sys.exit(141)
    except BrokenPipeError:
        if not _reader_left():  # another pipe broke, as that of a worker that died
            raise
        sys.exit(141)
    except BaseException:
        _reader_left()
        raise
    if _reader_left():
        sys.exit(141)


def _reader_left() -> bool:
    """Write what is left of the output; return whether nobody reads it, and then let it go nowhere."""
    try:
        sys.stdout.flush()
        left = _is_broken(sys.stdout.fileno())
    except BrokenPipeError:
        left = True
    except UnsupportedOperation:  # no file at all, as under pytest
        return False
    if left:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what the interpreter flushes at its end
    return left


def _is_broken(pipe: int) -> bool:
    """Return whether the reading end of a pipe is closed; False where that cannot be asked."""
    if not hasattr(select, "poll"):
        return False
    poll = select.poll()
    poll.register(pipe, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))
