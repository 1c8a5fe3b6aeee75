"""Identification data out of real rollouts."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dynasindy.systems.transitions import Transitions


def transitions(rows: TensorDictBase, log_dt: float) -> Transitions:
    """Return the logged samples of real control periods as transitions, in float64.

    Of a plant behind sensors these are the measured samples, NaN where nothing was measured.
    Periods in which a mechanical stop was touched are left out: they are not smooth dynamics.

    Args:
        rows: Control periods `(T,)` in the order of time, with `state` or, behind sensors, `measurement`,
            `action`, ("next", "samples") and ("next", "at_stop").
        log_dt: Time between samples [s].

    Returns:
        Up to `T * substeps` transitions.
    """
    return Logged(rows, log_dt).transitions()


class Logged:
    """Hold the logged samples of real control periods, of which some or others are read; see `transitions`.

    Args:
        rows: Control periods, `(T,)`.
        log_dt: Time between samples [s].
    """

    def __init__(self, rows: TensorDictBase, log_dt: float) -> None:
        samples = rows["next", "samples"].double()
        start = rows["measurement"] if "measurement" in set(rows.keys()) else rows["state"]
        self._fine = Transitions.from_samples(start.double(), rows["action"].double(), samples, log_dt)
        self._free = ~rows["next", "at_stop"].reshape(-1)

    def transitions(self, among: Tensor | None = None) -> Transitions:
        """Return what `transitions` does, of the periods that `among`, bool `(T,)`, tells; of all if omitted."""
        free = self._free if among is None else self._free & among
        return self._fine.select(free.repeat_interleave(self._fine.substeps))


def measured(rows: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Return what an observer reads of an episode: measurements `(T + 1, n_x)` and the commands between them.

    Args:
        rows: Control periods `(T,)` of one episode behind sensors.
    """
    return torch.cat([rows["measurement"][:1], rows["next", "samples"][:, -1]]), rows["action"]
