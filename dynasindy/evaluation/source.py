"""Data to identify from, and data to judge on."""

from __future__ import annotations

from dataclasses import dataclass

from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


@dataclass(frozen=True)
class Source:
    """Hold data to identify from and data to judge on.

    Attributes:
        signature: names, units and ranges of states and inputs.
        training: transitions to fit.
        validation: transitions that the fit does not see.
        notes: sentences on how the data came about.
        logged: whether they are a log, so that nothing is known of the plant but what was measured.
    """

    signature: Signature
    training: Transitions
    validation: Transitions
    notes: tuple[str, ...] = ()
    logged: bool = False
