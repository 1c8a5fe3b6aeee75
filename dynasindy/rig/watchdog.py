"""A thread that gives a rig its safe input when the loop does not come round in time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from dynasindy.rig.base import RigClock


class Watchdog:
    """Call a function whenever a deadline has passed that was not renewed.

    The loop that it watches may hang in a computation or in a call to the system: the thread does not.

    Attributes:
        barked: Whether a deadline has passed.

    Args:
        bark: What to call; an error of it is taken for an answer that did not come.
        clock: Tells the time; the computer's own if omitted.
    """

    def __init__(self, bark: Callable[[], None], clock: RigClock = time) -> None:
        self.bark, self.barked, self.clock = bark, False, clock
        self._deadline: float | None = None
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def within(self, seconds: float) -> None:
        """Ask for the next call of `within` or `close` in so many seconds."""
        with self._changed:
            self._deadline = self.clock.monotonic() + seconds
            self._changed.notify()

    def close(self) -> None:
        """Stop watching; the function is not called any more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _watch(self) -> None:
        with self._changed:
            while not self._closed:
                left = None if self._deadline is None else self._deadline - self.clock.monotonic()
                if left is None or left > 0:
                    self._changed.wait(left)
                else:
                    self.barked, self._deadline = True, None
                    with suppress(Exception):  # any: the thread has to go on watching
                        self.bark()
