"""What a long fit is doing: one line that is written over, or now and then a plain line where nobody sits in front."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self, TextIO

from tqdm import tqdm

LOG = logging.getLogger("dynasindy.fit")
"""Told of every step of a fit; silent unless someone listens, as `Progress` does."""
LOG.setLevel(logging.WARNING)
EVERY = 10.0
"""Time between two lines where standard error is no terminal [s]."""


class Steps(tqdm):
    """A bar on a terminal; elsewhere, as in a file, a plain line now and then.

    Args:
        clock: Tells the time [s].
        **settings: Those of `tqdm`.
    """

    disable: bool
    leave: bool

    def __init__(self, clock: Callable[[], float] = time.monotonic, **settings: Any) -> None:
        self.plain, self.clock, self.told = not sys.stderr.isatty(), clock, -EVERY
        widths: dict[str, Any] = {"ncols": 0, "mininterval": 0.0} if self.plain else {"dynamic_ncols": True}
        super().__init__(**widths, **settings)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Show the state: written over on a terminal; elsewhere a line, if the last one is long enough ago."""
        if not self.plain:
            return bool(super().display(msg, pos))
        if msg == "" or self.clock() - self.told < EVERY:  # empty: the bar is to be taken away
            return True
        self.told = self.clock()
        self.fp.write(f"{self}\n")
        self.fp.flush()
        return True

    def close(self) -> None:
        """Show the last state, unless it is not to be left."""
        if not self.plain or self.disable:
            super().close()
            return
        if self.leave:
            self.told = -EVERY
            self.display()
        self.disable, self.leave = True, False
        self._decr_instances(self)

    @staticmethod
    def status_printer(file: TextIO) -> Callable[[str], None]:
        """Return what writes over a line; nothing where there is no terminal."""
        return tqdm.status_printer(file) if file.isatty() else lambda line: None


class Progress(logging.Handler):
    """Show the steps of a fit on standard error while inside, once it takes longer than a moment.

    Args:
        after: time until the line appears [s].
    """

    def __init__(self, after: float = 3.0) -> None:
        super().__init__(logging.INFO)
        self.bar = Steps(desc="fit", unit=" steps", delay=after, leave=False)
        self.timer = threading.Timer(after, self.bar.display)  # a fit may be silent for long
        self.timer.daemon = True

    def emit(self, record: logging.LogRecord) -> None:
        """Count a step and show its words."""
        self.bar.set_description_str(record.getMessage(), refresh=False)
        self.bar.update()

    def __enter__(self) -> Self:
        """Begin to listen."""
        LOG.addHandler(self)
        LOG.setLevel(logging.INFO)
        LOG.propagate = False
        if self.bar.plain:
            self.timer.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Stop listening and take the line away."""
        self.timer.cancel()
        LOG.removeHandler(self)
        LOG.setLevel(logging.WARNING)
        LOG.propagate = True
        self.bar.close()
