"""A recording cut into windows, side by side: what a fit to trajectories reads."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions

ENOUGH = 10_000
"""Rows of a recording on which functions are chosen; the coefficients are fitted on all."""
STRETCHES = 10
"""Stretches that the rows lie in that are chosen of a long recording."""


@dataclass(frozen=True)
class Windows:
    """Hold a recording cut into W windows of L sampling intervals.

    Attributes:
        rows: place of the first transition of each window in the recording, `(W,)`.
        first: states measured at the beginning of each window, `(W, n_x)`, NaN where not measured.
        inputs: inputs held in each interval, `(W, L, n_u)`.
        measured: states measured at the ends of the intervals, `(W, L, n_x)`, zero where not measured.
        mask: 1 where a state was measured at the end of an interval of the recording, else 0, `(W, L, n_x)`.
        joined: whether a window continues the one before, bool `(W,)`.
        dt: length of an interval [s].
        substeps: Runge-Kutta steps in an interval.
        lasting: part of an error of each state that is left a sample later, `(n_x,)`; without, errors are taken for
            white.
        likely: standard deviation of each coefficient before the recording tells it, `(n_features, n_x)`; without,
            every coefficient is as likely as any other.
    """

    rows: Tensor
    first: Tensor
    inputs: Tensor
    measured: Tensor
    mask: Tensor
    joined: Tensor
    dt: float
    substeps: int = 1
    lasting: Tensor | None = None
    likely: Tensor | None = None

    @classmethod
    def of(cls, data: Transitions, length: int, joined: bool = True, substeps: int = 1) -> Windows:
        """Cut every segment of a recording into windows of `length` intervals; the last one may be shorter.

        Args:
            data: the recording; NaN where a state was not measured.
            length: sampling intervals in a window.
            joined: whether a window continues the one before; if not, each begins at a state of its own.
            substeps: Runge-Kutta steps in an interval.
        """
        starts, rows, inside, follows = [], [], [], []
        for segment in data.segment.unique().tolist():
            mine = (data.segment == segment).nonzero().flatten()
            for k, part in enumerate(mine.split(length)):
                starts.append(int(part[0]))
                rows.append(torch.cat([part, part[-1:].expand(length - len(part))]))
                inside.append(torch.arange(length) < len(part))
                follows.append(joined and k > 0)
        places, within = torch.stack(rows), torch.stack(inside)
        after = data.x_next[places]
        return cls(
            rows=torch.tensor(starts),
            first=data.x[torch.tensor(starts)],
            inputs=data.u[places],
            measured=after.nan_to_num(),
            mask=(within.unsqueeze(-1) & ~after.isnan()).to(after.dtype),
            joined=torch.tensor(follows),
            dt=data.dt,
            substeps=substeps,
        )

    def __len__(self) -> int:
        """Count the windows."""
        return len(self.rows)

    @property
    def length(self) -> int:
        """Count the sampling intervals of a window."""
        return self.mask.shape[1]


def choose_stretches(n: int, wanted: int, stretches: int = STRETCHES) -> Tensor:
    """Choose rows of a long recording in evenly spread stretches of equal length, bool `(n,)`; all of a short one.

    Args:
        n: rows of the recording.
        wanted: rows to choose.
        stretches: how many stretches they lie in.
    """
    if n <= wanted:
        return torch.ones(n, dtype=torch.bool)
    length = wanted // stretches
    begins = torch.linspace(0, n - length, stretches).long()
    chosen = torch.zeros(n, dtype=torch.bool)
    chosen[(begins.unsqueeze(-1) + torch.arange(length)).flatten()] = True
    return chosen
