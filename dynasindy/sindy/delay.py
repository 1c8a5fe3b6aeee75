"""The time between an input and its effect, out of a recording, in fractions of a sample."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from dynasindy.sindy.regression import fit_supported
from dynasindy.systems.steps import between
from dynasindy.systems.transitions import Transitions


def delay_inputs(data: Transitions, delay: float) -> Transitions:
    """Return a recording whose inputs act `delay` seconds later; before its first sample the first input held.

    A delay that is no whole number of samples changes a held input within an interval; its mean is taken. That is also
    where an input that moves in straight lines begins the interval; where it ends it is taken, too.

    Args:
        data: the recording.
        delay: delay [s], 0 or more.

    Raises:
        ValueError: the delay is negative.
    """
    if delay < 0:
        raise ValueError(f"an input delay is {delay} s; allowed is 0 or more")
    whole, part = divmod(delay / data.dt, 1.0)
    if delay == 0:
        return data
    places, begin = torch.arange(len(data)), data.segment_starts()
    late, later = (data.u[torch.maximum(places - int(whole) - more, begin)] for more in (0, 1))
    u = (1 - part) * late + part * later
    if data.u_end is None:
        return replace(data, u=u)
    rows = places - int(whole)
    share = (1 - part) * (rows >= begin).to(u.dtype).unsqueeze(-1)
    moved = between(*data.inputs_of(torch.maximum(rows, begin)), share)
    return replace(data, u=u, u_end=torch.where(data.linear_inputs, moved, u))


def rows_after_delay(data: Transitions, longest: float) -> Tensor:
    """Return which rows know the input of `longest` seconds before, bool `(N,)`: not the first ones of a segment."""
    return torch.arange(len(data)) - data.segment_starts() >= math.ceil(longest / data.dt - 1e-9)


def delay_and_trim(data: Transitions, delay: float) -> Transitions:
    """Return a recording whose inputs act `delay` seconds later, without the rows whose inputs are not known then."""
    return delay_inputs(data, delay).select(rows_after_delay(data, delay))


def unexplained(support: Tensor, theta: Tensor, dx: Tensor) -> float:
    """Return N/2 log of what the regression of rates on supported functions leaves over, summed over the states."""
    left = (dx - theta @ fit_supported(theta, dx, support)).square().sum(0)[support.any(0)]
    return 0.5 * len(dx) * float((left + 1e-300).log().sum())
