"""Ctrl-C and SIGTERM: one line and an exit code of 130 or 143, whenever they come."""

import os
import signal
import sys
import threading
import time
from functools import cache
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def leave(number: int, frame: FrameType | None) -> None:
    """End at once: nothing was begun, or everything is done."""
    os.write(2, b"stopped\n")
    os._exit(128 + number)


def listen(handler: signal.Handlers | object) -> None:
    """Let a handler hear of the signals that ask to stop; only the main thread may say so."""
    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            signal.signal(number, handler)  # type: ignore[arg-type]


# The imports of a script take seconds, in which a traceback would be all that a user sees.
listen(leave)


from dynasindy.dyna import Stopped  # noqa: E402 - after the line above


def stop(number: int, frame: FrameType | None) -> None:
    """Leave what is under way; a second signal leaves at once."""
    listen(leave)
    raise Stopped("stopped", number)


@cache
def end_with_parent() -> None:
    """End this process, a worker of a sweep, when its parent is gone, so that it races no later sweep.

    At once, since its launcher would catch an exception and go on with the next job; what is kept survives that.
    """
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(128 + signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def say(line: str, number: int) -> None:
    """Print the line of a stopped command and exit."""
    print(" ".join(line.split()), file=sys.stderr)
    sys.exit(128 + number)
