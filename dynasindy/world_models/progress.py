"""What a long fit is doing: one line that is written over."""

from __future__ import annotations

import logging
from types import TracebackType
from typing import Self

from tqdm import tqdm

LOG = logging.getLogger("dynasindy.fit")
"""Told of every step of a fit; silent unless someone listens, as `Progress` does."""
LOG.setLevel(logging.WARNING)


class Progress(logging.Handler):
    """Show the steps of a fit on standard error while inside, once it takes longer than a moment.

    Args:
        after: time until the line appears [s].
    """

    def __init__(self, after: float = 3.0) -> None:
        super().__init__(logging.INFO)
        self.bar = tqdm(desc="fit", unit=" steps", delay=after, leave=False, dynamic_ncols=True)

    def emit(self, record: logging.LogRecord) -> None:
        """Count a step and show its words."""
        self.bar.set_description_str(record.getMessage(), refresh=False)
        self.bar.update()

    def __enter__(self) -> Self:
        """Begin to listen."""
        LOG.addHandler(self)
        LOG.setLevel(logging.INFO)
        LOG.propagate = False
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Stop listening and take the line away."""
        LOG.removeHandler(self)
        LOG.setLevel(logging.WARNING)
        LOG.propagate = True
        self.bar.close()
