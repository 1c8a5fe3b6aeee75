"""A state that no sensor sees and that follows a signal: a motor its command, a wall the air of an oven.

The state a follows the signal s by a' = (s - a) / T.

| signal           | what it may be                            | how the equations read a                        |
| ---------------- | ----------------------------------------- | ----------------------------------------------- |
| an input u       | a motor, a propeller, a valve that lags   | in the place of u                               |
| a measured x     | a wall, a store beside it, what creeps    | as x - a, in the equation of x, or of its rate  |

A store that x alone fills has this form whatever its capacity and its losses: its own level b, b' = p x - b / T + q, is
p T a + q T, and the factor and the offset are in the coefficients of the other equations. At rest a equals s. The time
T is found by regressions on signals that were led through such a lag, then with all else by trajectories.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.findings import Finding, note
from dynasindy.sindy.codegen import generate
from dynasindy.sindy.delay import delay_inputs, rows_after_delay, unexplained
from dynasindy.sindy.library import Library, of
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.reconstruction import BRIEF, RegressionData, half_bump, has_gaps, rate_states, reconstruct
from dynasindy.sindy.regression import Rows, RunningSums, least_squares
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.systems.transitions import Transitions

TIMES = (2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Times that regressions try of a state that follows an input [samples]."""
LONGER = (*TIMES, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
"""The same of one that follows a measured state, which may be far slower than that: as far as `SLOWEST` allows."""
SLOWEST = 0.25
"""Longest time that is tried [lengths of the longest stretch]."""
PARTS = (0.0, 0.25, 0.5, 0.75)
"""Parts of a model's delay that are tried beside all of it."""
FORGOTTEN = math.log(1000.0)
"""Times after which it no longer matters where a state that follows an input began: a part in 1000 is left."""


@dataclass(frozen=True)
class LagStateCandidate:
    """Hold a model with one state more, which follows a signal, not fitted yet but for a first guess.

    Attributes:
        model: the model; the state is its last.
        signal: input or measured state that is followed.
        gain: what the regression of the rates of change leaves over less than without it [log of the error, a row].
    """

    model: SindyModel
    signal: str
    gain: float

    def finding(self) -> Finding | None:
        """Return what was found, after the fit; None where the state does not follow."""
        rate = float(self.model.coefficients[-1, -1])
        if not rate > 0:
            return None
        is_input, state = self.signal in self.model.signature.input_names, _lag_state_name(self.signal)
        return note("model.lag_state", signal=self.signal, seconds=1 / rate, is_input=is_input, state=state)


def lag_state_candidates(model: SindyModel, data: Transitions) -> list[LagStateCandidate]:
    """Return models with a state that follows an input or a measured state, those first that regressions prefer.

    Those are left out by which a regression explains no more, and all where equations are known beyond rates. What
    the model takes for a delay of the inputs may be one, may stand for the state that is missing, or be a part of both:
    shorter delays are tried, too.

    Args:
        model: what was fitted to the recording.
        data: the recording, NaN where a state was not measured.
    """
    known = set(rate_states(model.library, model.constraints).values())
    others = [i for i in range(model.signature.n_x) if i not in known]
    if not bool(model.constraints.free[:, others].any()) or bool(model.constraints.offset[:, others].any()):
        return []
    data = data.to(torch.float64).select(choose_stretches(len(data), BRIEF))
    keep = rows_after_delay(data, model.delay)
    longest, dt = model.delay, data.dt  # shorter delays in whole samples
    delays = sorted({*(round(part * longest / dt) * dt for part in PARTS if part * longest < longest), longest})
    late = {delay: delay_inputs(data, delay).select(keep) for delay in delays}
    # What may be followed: the inputs, and the measured states whose equation, or whose rate's, is sought.
    measured, found = ~data.x.isnan().all(0), []
    names = [name for i, name in enumerate(model.signature.state_names) if bool(measured[i] & _moved(model, i)[1])]
    for signal in (*model.signature.input_names, *names):
        plain = _Search(model, late[model.delay], signal)
        tried = [_Search(model, other, signal, delay).best(plain) for delay, other in late.items()]
        found += sorted((trial for trial in tried if trial), key=lambda trial: -trial.gain)[:1]
    return sorted(found, key=lambda trial: -trial.gain)


def _moved(model: SindyModel, i: int) -> tuple[int, bool]:
    """Return the state whose equation a store beside state i acts on, or its known rate, and if that is sought."""
    rate = {of: rate for rate, of in rate_states(model.library, model.constraints).items()}.get(i, i)
    return rate, bool(model.constraints.free[:, rate].any())


class _Search:
    """Regressions of the rates of change on functions of a signal that was led through lags of many times."""

    def __init__(self, model: SindyModel, data: Transitions, signal: str, delay: float = 0.0) -> None:
        self.model, self.data, self.signal, self.delay = model, data.to(torch.float64), signal, delay
        self.rates, self.noisy = rate_states(model.library, model.constraints), not bool(has_gaps(data))
        self.guess = reconstruct(data, self.rates, self.noisy)
        self.input = signal in model.signature.input_names
        place = (model.signature.input_names if self.input else model.signature.state_names).index(signal)
        held = self.guess.mean_inputs if self.input else 0.5 * (self.guess.x + self.guess.x_next)
        self.follows, self.moved = held[:, place], place if self.input else _moved(model, place)[0]

    def best(self, plain: _Search) -> LagStateCandidate | None:
        """Return the model of the time with which all functions together explain most; None where none does.

        Args:
            plain: The same under the inputs of the model as it is: what its functions explain is to be outdone.
        """
        times, keep = self._times()
        if not times:
            return None
        left, half = plain.left(keep), half_bump(self.data.select(keep))
        costs = {time: self._cost(time, keep, half) for time in times}
        time = min(costs, key=costs.__getitem__)
        if not self.input and time == times[0]:  # what hardly lags stands for a rate of change, which explains itself
            return None
        gain = left - costs[time]
        wide = with_lag_state(self.model, self.signal)
        rows = self._rows(wide, time, keep, half)
        if not gain > math.log(len(rows[0])):  # of two numbers more, each worth half of that
            return None
        wide.initial, wide.initial_delay = self._solved(wide, rows, time), self.delay
        return LagStateCandidate(wide, self.signal, gain / len(rows[0]))

    def left(self, keep: Tensor) -> float:
        """Return N/2 log of what is left over without the state, of rows bool `(N,)`."""
        seen = RegressionData.of(self.guess.select(keep), self.data.select(keep), self.rates, self.noisy)
        free = self.model.constraints.free
        fixed = torch.where(free, 0.0, self.model.coefficients)
        theta, dx = seen.rows(self.model.library, generate(self.model.library, self.model.coefficients))
        return unexplained(free, theta, dx - theta @ fixed)

    def _times(self) -> tuple[list[float], Tensor]:
        """Return the times that are tried [s], and rows in which the states that follow are known, bool `(N,)`.

        Where a state that follows an input began is not known, and times that leave less than half of the samples known
        are not tried. Where one began that follows a measured state is told by the regression.
        """
        data, enough = self.data, max(len(self.data) // 2, 2 * len(self.model.library))
        longest = SLOWEST * int(torch.bincount(data.segment - data.segment.min()).max())
        if not self.input:
            every, stretches = torch.ones(len(data), dtype=torch.bool), len(data.segment.unique())
            return [n * data.dt for n in LONGER if n <= longest and len(data) >= enough + stretches], every
        for n in reversed(TIMES):
            keep = rows_after_delay(data, FORGOTTEN * n * data.dt)
            if int(keep.sum()) >= enough:
                return [m * data.dt for m in TIMES if m <= n], keep
        return [], keep

    def _cost(self, time: float, keep: Tensor, half: int) -> float:
        """Return N/2 log of what is left over; infinite of a store that would drive what fills it."""
        wide = with_lag_state(self.model, self.signal)
        theta, dx = self._rows(wide, time, keep, half)
        free = self._free(wide, theta)
        if not self.input:
            mine = free[:, self.moved]
            own = int(mine[: len(wide.library)].sum()) - 1
            if not float(least_squares(theta[:, mine], dx[:, self.moved])[own]) < 0:
                return math.inf
        fixed = torch.zeros_like(free, dtype=theta.dtype)
        fixed[: len(wide.library)] = wide.coefficients
        return unexplained(free, theta, dx - theta @ torch.where(free, 0.0, fixed))

    def _free(self, wide: SindyModel, theta: Tensor) -> Tensor:
        """Return which columns the regression of each state may have, bool `(n_columns, n_x)`; none of the follower."""
        free = torch.zeros(theta.shape[1], wide.signature.n_x, dtype=torch.bool)
        free[: len(wide.library)] = wide.constraints.free
        free[len(wide.library) :, self.moved] = True
        free[:, -1] = False
        return free

    def _rows(self, wide: SindyModel, time: float, keep: Tensor, half: int) -> Rows:
        """Return averaged functions and rates of change under a state that follows with so much time [s].

        Where a state that follows a measured one began is not known: behind the functions stands what decays from
        there, a column for each stretch.
        """
        starts, ends = _lag_dynamics(self.follows, self.data, time)
        own, n_x = [starts.unsqueeze(-1)], wide.signature.n_x
        own_next = [ends.unsqueeze(-1)]
        if not self.input:
            own.append(self._decays(time))
            own_next.append(own[-1] * math.exp(-self.data.dt / time))
        guess = replace(
            self.guess, x=torch.cat([self.guess.x, *own], -1), x_next=torch.cat([self.guess.x_next, *own_next], -1)
        )
        measured = widened(self.data, guess.x.shape[1] - n_x + 1)

        def _theta(x: Tensor, u: Tensor) -> Tensor:
            return torch.cat([wide.library(x[..., :n_x], u), x[..., n_x:]], -1)

        seen = RegressionData(guess.select(keep), measured.select(keep), self.rates, half)
        theta, dx = seen.rows(_theta, _theta)  # where a state was not measured no field is asked for
        return theta, dx[:, :n_x]

    def _decays(self, time: float) -> Tensor:
        """Return what is left of 1 at the begin of each interval since its stretch began, a column for each stretch."""
        _, stretch = self.data.segment.unique_consecutive(return_inverse=True)
        since = torch.arange(len(stretch)) - self.data.segment_starts()
        left = torch.exp(-self.data.dt / time * since.double())
        return left.unsqueeze(-1) * torch.nn.functional.one_hot(stretch)

    def _solved(self, wide: SindyModel, rows: Rows, time: float) -> Tensor:
        """Return the coefficients that the regression of a model finds."""
        theta = rows[0]
        sums = RunningSums(theta.shape[1], wide.signature.n_x)
        sums.add(rows)
        fixed = torch.zeros(theta.shape[1], wide.signature.n_x, dtype=theta.dtype)
        fixed[: len(wide.library)] = wide.constraints.offset
        found = wide.regression.solve(sums, self._free(wide, theta), fixed)[: len(wide.library)]
        found[-1, -1] = 1 / time
        return found


def with_lag_state(model: SindyModel, signal: str) -> SindyModel:
    """Return a model with one state more, which follows a signal, without coefficients but those that are known.

    Args:
        model: what may act through a lag.
        signal: the input in whose place the state stands, or a measured state that it stands beside.
    """
    old, name = model.signature, _lag_state_name(signal)
    own, states = of("ahead", signal, name), model.signature.state_names
    read, more = list(model.library.features), {}
    if signal in old.input_names:
        signature = old.with_state(name, "1")
        read = [feature.reading(signal, name) for feature in read]
    else:
        place = old.state_index(signal)
        signature = old.with_state(name, old.state_units[place], old.x_scale[place])
        more = {states[_moved(model, place)[0]]: [own.name()]}
    written, known = [feature.name() for feature in read], rate_states(model.library, model.constraints)
    allowed = {
        state: [n for n, may in zip(written, model.constraints.free[:, i], strict=True) if may] + more.get(state, [])
        for i, state in enumerate(states)
    }
    return SindyModel(
        signature,
        Library(signature, [*read, own]),
        model.regression,
        model.refinement,
        known={states[i]: states[rate] for rate, i in known.items()},
        allowed=allowed | {name: [own.name()]},
        machine_code=model.machine_code,
    )


def _lag_dynamics(signal: Tensor, data: Transitions, time: float) -> tuple[Tensor, Tensor]:
    """Return a state that follows a signal `(N,)` from rest, at the begin and the end of each interval, `(N,)` both."""
    anew, left = data.begins(), math.exp(-data.dt / time)
    gain, ends, reach = (
        torch.full_like(signal, left).masked_fill(anew, 0.0),
        torch.where(anew, signal, (1 - left) * signal),
        1,
    )
    while bool(gain.any()):  # what each end is of the one `reach` intervals before, until nothing before matters
        ends[reach:], gain[reach:] = ends[reach:] + gain[reach:] * ends[:-reach], gain[reach:] * gain[:-reach]
        reach *= 2
    return torch.where(anew, signal, ends.roll(1)), ends


def _lag_state_name(name: str) -> str:
    """Return the name of the state that follows a signal."""
    return f"{name}_lagging"


def lag_state_ranges(model: SindyModel, data: Transitions) -> dict[int, tuple[float, float]]:
    """Return the ends between which states that follow were in a log, by place; of a measured state the difference.

    Args:
        model: a fitted model.
        data: the log, with all states of the model; before it inputs were zero.
    """
    found, names = {}, model.signature
    guess = reconstruct(data, rate_states(model.library, model.constraints))
    for name, signal in model.followed.items():
        place = names.state_index(name)
        if signal in names.input_names:
            ends = data.u[:, names.input_names.index(signal)]
            found[place] = min(float(ends.min()), 0.0), max(float(ends.max()), 0.0)
            continue
        level = 0.5 * (guess.x + guess.x_next)[:, names.state_index(signal)]
        behind = _lag_dynamics(level, data, 1 / float(model.coefficients[:, place].sum()))[1] - level
        found[place] = float(behind.min()), float(behind.max())
    return found


def completed(data: Transitions, names: tuple[str, ...], model: SindyModel) -> Transitions:
    """Return a recording with all states of a model, whose followers no sensor sees.

    Args:
        data: the recording.
        names: its states.
        model: the model.

    Raises:
        ValueError: the model is of another plant.
    """
    states = model.signature.state_names
    more = states[len(names) :]
    if states[: len(names)] != names or not set(more) <= set(model.followed):
        raise ValueError(
            f"the model has the states {', '.join(states)}, the log {', '.join(names)}; give a model of "
            "the plant that the log is of"
        )
    return widened(data, len(more))


def widened(data: Transitions, count: int = 1) -> Transitions:
    """Return a recording with so many more states, which no sensor sees."""
    if not count:
        return data
    unseen = torch.full_like(data.x[:, :1], torch.nan).expand(-1, count)
    return replace(data, x=torch.cat([data.x, unseen], -1), x_next=torch.cat([data.x_next, unseen], -1))
