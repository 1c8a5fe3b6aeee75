"""State reconstruction: rates and states that no sensor sees, out of what sensors saw; the first guess of a fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dynasindy.sindy.codegen import simulate
from dynasindy.sindy.delay import delay_inputs, rows_after_delay
from dynasindy.sindy.library import Constraints, Library, variable
from dynasindy.sindy.regression import DEPENDENT, Rows, Theta, integral_form, weak_form
from dynasindy.sindy.shooting import ENOUGH, choose_stretches, relative_step, substeps_for
from dynasindy.systems.base import Signature
from dynasindy.systems.smoothing import best_length, local_cubic
from dynasindy.systems.transitions import Transitions

NOISY = 1e-5
"""Part of a function of measured states that others leave over, below which it depends on them."""
SHORTEST_BUMP, LONGEST_BUMP = 8, 20
"""Samples in half a bump: fewer leave the noise in, more leave fewer rows than a library has functions."""

Array = NDArray[np.float64]


BRIEF = 2 * ENOUGH
"""Rows of a recording by which regressions choose functions, delays and numbers inside functions."""
DIVERGED = 1e6
"""State that no sensor sees beyond which its simulation has run away [its range]."""


@dataclass(frozen=True)
class RegressionData:
    """Hold a recording as regressions and fits of trajectories read it.

    Attributes:
        measured: transitions, NaN where a state was not measured.
        guess: the same, the states that were not measured guessed.
        rates: which state is the rate of which other one, `{rate: state}`.
        longest: time before a row at which its inputs are to be known [s], or it is not read.
        noisy: whether states that were all measured are noisy: `guess` holds them smoothed then.
    """

    measured: Transitions
    guess: Transitions
    rates: Mapping[int, int]
    longest: float = 0.0
    noisy: bool = False

    @classmethod
    def of(cls, measured: Transitions, rates: Mapping[int, int], noisy: bool = False) -> RegressionData:
        """Guess the states of a recording that were not measured."""
        return cls(measured.to(torch.float64), reconstruct(measured, rates, noisy), rates, noisy=noisy)

    @cached_property
    def half(self) -> int:
        """Half of the length of the bump of the weak form [samples], by the noise; 0 of samples that all are exact."""
        if not (self.noisy or has_gaps(self.measured)):
            return 0
        columns = (interpolate_gaps(column.numpy()) for column in self.measured.x_next.unbind(-1))
        half = max(best_length(column) for column in columns if column is not None) // 2
        return min(max(half, SHORTEST_BUMP), LONGEST_BUMP)

    @property
    def dependent(self) -> float:
        """Return the part that other functions leave over of one below which noise cannot tell it from them."""
        return NOISY if self.half else DEPENDENT

    @cached_property
    def known(self) -> Tensor:
        """Rows whose inputs are known however late they act, bool `(N,)`."""
        return rows_after_delay(self.measured, self.longest)

    def rows(self, theta: Theta, field: Theta | None = None) -> Rows:
        """Average functions and rates of change: by the weak form, or within intervals if all states were measured.

        Args:
            theta: `(x, u) -> (N, n_features)`.
            field: first model `(x, u) -> dx`, `(N, n_x)`, if there is one, see `integral_form`.
        """
        if not self.half:
            return integral_form(theta, self.guess, field)
        return weak_form(theta, self.measured, self.guess, self.rates, self.half)

    def delayed(self, delay: float) -> RegressionData:
        """Return the rows whose inputs are known, under inputs that act `delay` seconds later."""
        measured, guess = (delay_inputs(each, delay).select(self.known) for each in (self.measured, self.guess))
        return replace(self, measured=measured, guess=guess, longest=0.0)

    def brief(self) -> RegressionData:
        """Return stretches of a long recording, enough for a regression; all of a short one."""
        rows = choose_stretches(len(self.measured), BRIEF)
        if bool(rows.all()):
            return self
        return replace(self, measured=self.measured.select(rows), guess=self.guess.select(rows))

    def smoothed(self, step: float | None = None) -> RegressionData:
        """Return the recording as one whose samples are noisy, wherever it is read from now on.

        Args:
            step: of the difference equation that is fitted [s]: it may jump from sample to sample, and no cubic tells
                that from noise, so that the recording stays as it is; None of a differential equation.
        """
        if step is not None:
            return self
        return replace(self, guess=reconstruct(self.measured, self.rates, True), noisy=True)

    def before(self) -> Tensor:
        """Return the inputs of the samples before each known row as they were given, the oldest first, `(N, M, n_u)`.

        There is one more than the longest delay asks for, as inputs may change within a sample; before a segment its
        first input held.
        """
        data = self.measured
        ago = torch.arange(math.ceil(self.longest / data.dt - 1e-9) + 1, 0, -1)
        rows = torch.maximum(torch.arange(len(data)).unsqueeze(-1) - ago, data.segment_starts().unsqueeze(-1))
        return data.u[rows[self.known]]


def rate_states(library: Library, constraints: Constraints) -> dict[int, int]:
    """Return which state is known to be the rate of which other one, by their positions: `{rate: state}`."""
    found = {}
    for i, fitted in enumerate(constraints.free.any(0).tolist()):
        if fitted:
            continue
        given = constraints.offset[:, i].nonzero().flatten().tolist()
        if len(given) != 1 or float(constraints.offset[given[0], i]) != 1:
            continue
        if (name := library.names[given[0]]) in library.signature.state_names:
            found[library.signature.state_index(name)] = i
    return found


def disturbance_states(library: Library, coefficients: Tensor) -> list[int]:
    """Return the states that nothing moves but noise, by their positions: their equations read them alone."""
    columns = zip(library.signature.state_names, coefficients.mT, strict=True)
    terms = [(name, [library.names[k] for k in column.nonzero().flatten().tolist()]) for name, column in columns]
    return [i for i, (name, own) in enumerate(terms) if own == [name]]


def settle_lag_states(data: Transitions, followers: Mapping[int, int]) -> Transitions:
    """Return a recording in which states that follow another one are equal to it, as they are at rest."""
    if not followers:
        return data
    x, x_next = data.x.clone(), data.x_next.clone()
    for follower, state in followers.items():
        x[:, follower], x_next[:, follower] = x[:, state], x_next[:, state]
    return replace(data, x=x, x_next=x_next)


def reconstruct(data: Transitions, rates: Mapping[int, int], noisy: bool = False) -> Transitions:
    """Guess all states from measurements by local cubics: the measured ones smoothed, their rates differentiated.

    A state that was not measured and is no rate of one that was is guessed to be zero.

    Args:
        data: the recording, NaN where a state was not measured.
        rates: which state is the rate of which other one, `{rate: state}`.
        noisy: whether states that were all measured are smoothed too; if not, they stay as they are.
    """
    data = data.to(torch.float64)
    if not noisy and not has_gaps(data):
        return data
    x, x_next, lengths = torch.zeros_like(data.x), torch.zeros_like(data.x), dict[int, int]()
    for rows in torch.arange(len(data)).split(data.segment.unique_consecutive(return_counts=True)[1].tolist()):
        samples = torch.cat([data.x[rows[:1]], data.x_next[rows]])
        for i, blind in enumerate(samples.isnan().all(0).tolist()):
            source = rates.get(i, i) if blind else i
            if (column := interpolate_gaps(samples[:, source].numpy())) is None:
                continue
            lengths[source] = lengths.get(source) or best_length(column)
            guess = torch.from_numpy(local_cubic(column, lengths[source], data.dt, int(source != i)))
            x[rows, i], x_next[rows, i] = guess[:-1], guess[1:]
    return replace(data, x=x, x_next=x_next)


def simulate_hidden_states(
    library: Library, xi: Tensor, data: Transitions, guess: Transitions, rates: Mapping[int, int]
) -> Transitions:
    """Guess the states that no sensor sees in any form by a first model, which the measured states lead.

    The rate of a measured state is seen in that state, and stays as it was reconstructed. What is seen moves evenly
    from sample to sample. Each stretch begins where the guess does.
    """
    unseen = data.x.isnan().all(0) & data.x_next.isnan().all(0)
    hidden = unseen.clone()
    for rate, state in rates.items():
        hidden[rate] &= unseen[state]
    if not bool(hidden.any()):
        return guess
    own = torch.where(hidden, xi, 0.0)
    x, x_next = guess.x.clone(), guess.x_next.clone()
    substeps = substeps_for(relative_step(library, own, guess.x, guess.u, guess.dt))
    # What was seen is known at both ends of an interval, and needs no equations that may be fast.
    leads = torch.where(hidden, 0.0, (guess.x_next - guess.x) / guess.dt)
    names = [f"_lead_{i}" for i in range(len(hidden))]
    old = library.signature
    signature = Signature(old.state_names, old.state_units, (*old.input_names, *names), old.x_scale)
    led = Library(signature, [*library.features, *map(variable, names)], step=library.step)
    coefficients = torch.cat([own, torch.eye(len(hidden), dtype=own.dtype)])
    inputs = torch.cat([guess.u, leads], -1), torch.cat([guess.last_inputs, leads], -1)
    for first, last in pairwise([*guess.begins().nonzero().flatten().tolist(), len(guess)]):
        u, u_end = (part[first:last].unsqueeze(0) for part in inputs)
        ends = simulate(led, coefficients, x[first : first + 1], u, guess.dt, substeps, u_end)[0]
        # Nothing holds a state that runs away.
        bounded = (ends.abs() < DIVERGED * guess.x.new_tensor(old.x_scale)).all(0)
        x_next[first:last] = torch.where(hidden & bounded, ends, x_next[first:last])
        x[first + 1 : last] = torch.where(hidden, x_next[first : last - 1], x[first + 1 : last])
    return replace(guess, x=x, x_next=x_next)


def interpolate_gaps(column: Array) -> Array | None:
    """Return samples with the lost ones interpolated, `(n,)`; None if none was measured."""
    seen = np.flatnonzero(~np.isnan(column))
    return np.interp(np.arange(len(column)), seen, column[seen]) if len(seen) else None


def has_gaps(data: Transitions) -> bool:
    """Tell whether a state was not measured."""
    return bool(data.x.isnan().any() | data.x_next.isnan().any())


WINDOW = 10
"""Samples over which the rate of another state is told by its integral, which noise leaves as it is."""


def find_rates(data: Transitions, part: float) -> dict[int, int]:
    """Return which measured state is the rate of which other one, `{rate: state}`.

    Its integral by the trapezoidal rule is what the other one moves by, all but a `part` of that.
    """
    data = reconstruct(data, {})
    rows = torch.arange(len(data) - WINDOW + 1)
    last = rows + WINDOW - 1
    rows, last = (k[data.segment[rows] == data.segment[last]] for k in (rows, last))
    moved = data.x_next[last] - data.x[rows]
    sums = torch.cat([torch.zeros_like(data.x[:1]), (0.5 * data.dt * (data.x + data.x_next)).cumsum(0)])
    left = (moved.unsqueeze(-1) - (sums[last + 1] - sums[rows]).unsqueeze(-2)).square().sum(0)  # (state, rate)
    left = left.fill_diagonal_(math.inf).nan_to_num(math.inf)
    least, rates = left.min(1)
    alike = least < part * moved.square().sum(0)
    return {int(rates[i]): i for i in alike.nonzero().flatten().tolist()}
