"""What a rig has to offer: three methods, and whether its own clock or ours says when a period begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynasindy.systems import Signature

Array = NDArray[np.float64]


class RigClock(Protocol):
    """What tells the time and waits; the module `time` is one, and a test may have one that is faster."""

    def monotonic(self) -> float:
        """Return the time since some fixed moment [s]."""

    def sleep(self, seconds: float, /) -> None:
        """Wait so long [s]."""


class Fault(Exception):
    """Something that no flight goes on with; the rig gets its safe input.

    Args:
        kind: One word: late, lost, invalid, range, connection, log, controller or stopped.
        message: What was seen, in one line.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


@dataclass(frozen=True)
class Wiring:
    """What of a plant is measured, and how often.

    Attributes:
        signature: Names, units and ranges of the plant.
        seen: Which states have a sensor, one bool each; the others are NaN in every sample.
        dt: Control period [s].

    Raises:
        ValueError: There is not one bool per state, no state has a sensor, or the period is not positive.
    """

    signature: Signature
    seen: tuple[bool, ...]
    dt: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "seen", tuple(bool(known) for known in self.seen))
        if len(self.seen) != self.signature.n_x or not any(self.seen) or not self.dt > 0:
            raise ValueError(
                f"seen={self.seen}, dt={self.dt}; give a bool per state, one of them true, and a time > 0 s"
            )

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the states that have a sensor."""
        return tuple(name for name, known in zip(self.signature.state_names, self.seen, strict=True) if known)

    @property
    def headings(self) -> list[str]:
        """Headings of a log: time, the states that are measured, and the inputs, each with its unit."""
        return self.signature.headings(["time", *self.measured, *self.signature.input_names])


class Rig(Protocol):
    """A plant that is really there.

    Attributes:
        streams: Whether the rig sends samples by a clock of its own; if not, it is asked once per control period.
    """

    streams: bool

    @property
    def number(self) -> int | None:
        """Control periods from the first sample after `begin` to the last one; None if samples have no numbers."""

    def begin(self) -> None:
        """Forget samples that came before; the next one that is read is fresh, and the first of a flight.

        Raises:
            OSError: The connection is broken.
        """

    def read(self, seconds: float) -> Array | None:
        """Return what was measured, `(n_x,)`, NaN for states without a sensor.

        Args:
            seconds: How long a rig that streams may take to send it [s].

        Returns:
            The newest sample; None if none came.

        Raises:
            OSError: The connection is broken.
        """

    def write(self, u: Array) -> None:
        """Apply inputs, `(n_u,)` in [-1, 1], until the next call.

        Raises:
            OSError: The connection is broken.
        """

    def rest(self) -> None:
        """Apply the safe input, at once; it may be called at any time, from any thread, more than once."""
