"""Transitions of a controlled system: what identification reads and what a model predicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from dynasindy.systems.steps import between

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from dynasindy.systems.base import Signature


@dataclass(frozen=True)
class Transitions:
    """Hold N transitions `(x, u, x_next)`, `dt` seconds apart, under inputs that are held or move in straight lines.

    Rows of one segment follow each other in time: where `segment[k] == segment[k + 1]`, `x_next[k]` is `x[k + 1]`.

    Attributes:
        x: states at the start of each transition, `(N, n_x)` [SI, or the units of the signature].
        u: inputs at the start of each transition, `(N, n_u)` [normalised].
        x_next: states at the end of each transition, `(N, n_x)`.
        dt: time between `x` and `x_next` [s].
        segment: number of the unbroken stretch each row belongs to, `(N,)` int64, in non-decreasing blocks.
        substeps: transitions in a control period, in which the inputs stay as they are.
        u_end: inputs at the end of each transition, to which they move in a straight line, `(N, n_u)`; equal to `u`
            where an input is held, None where all are.

    Raises:
        ValueError: a shape does not fit the others, or `dt` is not positive.
    """

    x: Tensor
    u: Tensor
    x_next: Tensor
    dt: float
    segment: Tensor
    substeps: int = 1
    u_end: Tensor | None = None

    def __post_init__(self) -> None:
        n = self.x.shape[0]
        shapes = [tuple(t.shape) for t in (self.x, self.u, self.x_next, self.segment)]
        fits = self.x.ndim == self.u.ndim == 2 and self.x_next.shape == self.x.shape
        fits &= self.u_end is None or self.u_end.shape == self.u.shape
        if not fits or self.u.shape[0] != n or self.segment.shape != (n,):
            raise ValueError(
                f"Transitions got shapes x, u, x_next, segment = {shapes}; allowed are (N, n_x), (N, n_u), "
                "(N, n_x), (N,) with one N: flatten or trim the data first"
            )
        if not self.dt > 0:
            raise ValueError(f"Transitions got dt = {self.dt} s; allowed is dt > 0: give the sampling time")

    @classmethod
    def from_periods(cls, rows: TensorDictBase, log_dt: float) -> Transitions:
        """Return the logged samples of real control periods as transitions, in float64.

        Of a plant behind sensors these are the measured samples, NaN where nothing was measured.
        Periods in which a mechanical stop was touched are left out: they are not smooth dynamics. A new segment begins
        where a period does not start where the last one ended.

        Args:
            rows: Control periods `(T,)` in the order of time, with `state` or, behind sensors, `measurement`,
                `action`, ("next", "samples") and ("next", "at_stop").
            log_dt: Time between samples [s].

        Returns:
            Up to `T * substeps` transitions.
        """
        samples, free = rows["next", "samples"].double(), ~rows["next", "at_stop"].reshape(-1)
        start = (rows["measurement"] if "measurement" in set(rows.keys()) else rows["state"]).double()
        substeps, n_x = samples.shape[-2:]
        x, x_next = torch.cat([start.unsqueeze(1), samples[:, :-1]], 1).reshape(-1, n_x), samples.reshape(-1, n_x)
        same = (x[1:] == x_next[:-1]) | (x[1:].isnan() & x_next[:-1].isnan())  # NaN is what was not measured
        breaks = torch.zeros(len(x), dtype=torch.int64, device=x.device)
        breaks[1:] = (~same.all(-1)).long()
        held = rows["action"].double().repeat_interleave(substeps, 0)
        logged = cls(x, held, x_next, log_dt, breaks.cumsum(0), substeps)
        return logged.select(free.repeat_interleave(substeps))

    @classmethod
    def from_trajectory(cls, x: Tensor, u: Tensor, dt: float) -> Transitions:
        """Make transitions of one unbroken trajectory.

        Args:
            x: sampled states, `(T + 1, n_x)`.
            u: inputs held from each sample on, `(T, n_u)`, or `(T + 1, n_u)`, whose last row is not used.
            dt: sampling time [s].
        """
        n = x.shape[0] - 1
        return cls(x[:n], u[:n], x[1:], dt, torch.zeros(n, dtype=torch.int64, device=x.device))

    @classmethod
    def cat(cls, parts: Sequence[Transitions]) -> Transitions:
        """Join several recordings; segments of different recordings stay apart.

        Raises:
            ValueError: there is nothing to join, or the sampling times differ.
        """
        if not parts:
            raise ValueError("Transitions.cat got an empty list; allowed is one recording or more: collect data first")
        if len({part.dt for part in parts}) > 1:
            raise ValueError(
                f"Transitions.cat got sampling times {sorted({p.dt for p in parts})} s; allowed is one: "
                "fit each rate alone"
            )
        segments, offset = [], 0
        for part in parts:
            segments.append(part.segment + offset)
            offset += int(part.segment.max()) + 1 if len(part) else 0
        x, u, x_next = (torch.cat([getattr(p, name) for p in parts]) for name in ("x", "u", "x_next"))
        held = all(part.u_end is None for part in parts)
        u_end = None if held else torch.cat([part.last_inputs for part in parts])
        return cls(x, u, x_next, parts[0].dt, torch.cat(segments), parts[0].substeps, u_end)

    def __len__(self) -> int:
        return self.x.shape[0]

    def inputs_of(self, rows: Tensor | slice | int) -> tuple[Tensor, Tensor | None]:
        """Return the inputs at the start and at the end of some transitions, `(*rows, n_u)`; None if all are held."""
        return self.u[rows], None if self.u_end is None else self.u_end[rows]

    @property
    def last_inputs(self) -> Tensor:
        """Inputs at the end of each transition, `(N, n_u)`."""
        return self.u if self.u_end is None else self.u_end

    @property
    def mean_inputs(self) -> Tensor:
        """Inputs halfway through each transition, `(N, n_u)`."""
        return between(self.u, self.u_end, 0.5)

    @property
    def linear_inputs(self) -> Tensor:
        """Which inputs move within transitions, bool `(n_u,)`."""
        return (self.last_inputs != self.u).any(0)

    def with_linear_inputs(self, which: Sequence[bool] | None = None) -> Transitions:
        """Return the transitions under inputs that move in straight lines from sample to sample.

        In the last transition of a segment they are held, as what follows is not known.

        Args:
            which: inputs that do; the others are held. All if omitted.
        """
        move = torch.ones(self.u.shape[1], dtype=torch.bool) if which is None else torch.tensor(which, dtype=torch.bool)
        goes_on = torch.cat([~self.begins()[1:], torch.zeros(1, dtype=torch.bool)])
        u_end = torch.where(goes_on.unsqueeze(-1) & move, self.u.roll(-1, 0), self.u)
        return replace(self, u_end=u_end if bool(move.any()) else None)

    def begins(self) -> Tensor:
        """Return which rows begin a segment, bool `(N,)`."""
        first = torch.ones_like(self.segment, dtype=torch.bool)
        first[1:] = self.segment[1:] != self.segment[:-1]
        return first

    def longest_stretch(self) -> Transitions:
        """Return the longest part of a recording without a break."""
        labels, counts = self.segment.unique_consecutive(return_counts=True)
        return self.select(self.segment == labels[int(counts.argmax())])

    def observed(self, read: Callable[[Tensor], Tensor]) -> Transitions:
        """Return a recording as sensors would have logged it; a state that two rows share is read once.

        Args:
            read: what is measured of states `(rows, n_x)`, of the same shape, NaN where nothing is; called for the
                states after each row, then for those before it.
        """
        after, first = read(self.x_next), read(self.x)
        return replace(self, x=torch.where(self.begins().unsqueeze(-1), first, after.roll(1, 0)), x_next=after)

    def disturbed(
        self, level: float | Mapping[str, float], seed: int, signature: Signature | None = None
    ) -> Transitions:
        """Return the recording with white measurement noise; a state that two rows share gets one error.

        Args:
            level: standard deviation of the noise: one number, relative to that of each state, or by the name of a
                state in its unit.
            seed: seed of the noise.
            signature: names of the states, for noise by name.

        Returns:
            The recording as a sensor would have logged it.

        Raises:
            ValueError: noise is given of what is no state.
        """
        scale = self.x_next.std(0)
        if isinstance(level, Mapping):
            assert signature is not None
            scale = torch.zeros_like(scale)
            for name, std in level.items():
                scale[signature.state_index(name, "data.noise")] = std
            level = 1.0
        scale = level * scale
        if level == 0 or not bool(scale.any()):
            return self
        generator = torch.Generator().manual_seed(seed)
        return self.observed(lambda x: x + scale * torch.randn(x.shape, generator=generator, dtype=x.dtype))

    def segment_starts(self) -> Tensor:
        """Return the row at which the segment of each row begins, `(N,)`."""
        return torch.where(self.begins(), torch.arange(len(self)), 0).cummax(0).values

    @property
    def longest_segment(self) -> int:
        """Rows of the longest segment."""
        return int(torch.bincount(self.segment - self.segment.min()).max())

    def select(self, mask: Tensor) -> Transitions:
        """Keep the rows where `mask` `(N,)` bool is true; a gap begins a new segment."""
        if bool(mask.all()):
            return self
        keep = mask.nonzero().squeeze(-1)
        segment = self.segment[keep]
        breaks = torch.zeros_like(keep)
        breaks[1:] = ((keep.diff() > 1) | (segment.diff() != 0)).long()
        u, u_end = self.inputs_of(keep)
        return replace(self, x=self.x[keep], u=u, x_next=self.x_next[keep], segment=breaks.cumsum(0), u_end=u_end)

    def decimate(self, factor: int) -> Transitions:
        """Return transitions over so many intervals each, under inputs that are held at their mean, or move on."""
        if factor == 1:
            return self
        first = ((torch.arange(len(self)) - self.segment_starts()) % factor == 0).nonzero().flatten()
        first = first[first + factor <= len(self)]
        first = first[self.segment[first] == self.segment[first + factor - 1]]
        last, mean = first + factor - 1, self.mean_inputs[first.unsqueeze(-1) + torch.arange(factor)].mean(1)
        u, u_end = (torch.where(self.linear_inputs, end, mean) for end in (self.u[first], self.last_inputs[last]))
        ends, segment = None if self.u_end is None else u_end, self.segment[first]
        return Transitions(self.x[first], u, self.x_next[last], factor * self.dt, segment, u_end=ends)

    def to(self, dtype: torch.dtype) -> Transitions:
        """Cast states and inputs."""
        if self.x.dtype == self.u.dtype == self.x_next.dtype == dtype:
            return self
        u_end = None if self.u_end is None else self.u_end.to(dtype)
        return replace(self, x=self.x.to(dtype), u=self.u.to(dtype), x_next=self.x_next.to(dtype), u_end=u_end)
