"""A state that no sensor sees and that follows a signal: a motor its command, a wall the air of an oven.

The state a follows the signal s by a' = (s - a) / T.

| signal           | what it may be                            | how the equations read a                        |
| ---------------- | ----------------------------------------- | ----------------------------------------------- |
| an input u       | a motor, a propeller, a valve that lags   | in the place of u, or beside it                 |
| a measured x     | a wall, a store beside it, what creeps    | as x - a, in the equation of x, or of its rate  |

A store that x alone fills has this form whatever its capacity and its losses: its own level b, b' = p x - b / T + q, is
p T a + q T, and the factor and the offset are in the coefficients of the other equations. At rest a equals s. The time
T is found by regressions on signals that were led through such a lag, then with all else by trajectories.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
import torch
from scipy.linalg import solve_banded
from torch import Tensor

from dynasindy.findings import Finding, note
from dynasindy.sindy.delay import delay_inputs, rows_after_delay, unexplained
from dynasindy.sindy.library import Library, of
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.reconstruction import BRIEF, RegressionData, rate_states, reconstruct
from dynasindy.sindy.regression import Rows, TriangularFactor, weak_form
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

TIMES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
"""Times that regressions try [samples], as far as `SLOWEST` allows: a store may be far slower than what fills it."""
SLOWEST = 0.25
"""Longest time that is tried [lengths of the longest stretch]."""
CLEAR = 0.5
"""Standard error below which a coefficient is no chance [coefficients]."""
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Parts of a model's delay that are tried."""


def lag_state_findings(model: SindyModel) -> list[Finding]:
    """Return what states of a fitted model only follow a signal, and how fast."""
    found = []
    for state, signal in model.followed.items():
        rate = float(model.coefficients[:, model.signature.state_index(state)].sum())
        if rate > 0:
            is_input = signal in model.signature.input_names
            found.append(note("model.lag_state", signal=signal, seconds=1 / rate, is_input=is_input, state=state))
    return found


def lag_state_candidates(model: SindyModel, data: Transitions, beside: bool = True) -> list[SindyModel]:
    """Return models with a state that follows an input or a measured state, those first that regressions prefer.

    Actuators are often alike, and hardly tell their lag one by one: states that follow all inputs with one time are
    tried, too.

    Those are left out by which a regression explains no more, and all where equations are known beyond rates. What
    the model takes for a delay of the inputs may be one, may stand for the state that is missing, or be a part of both:
    shorter delays are tried, too.

    Args:
        model: what was fitted to the recording.
        data: the recording, NaN where a state was not measured.
        beside: whether an input may act at once, too.
    """
    rates = rate_states(model.library, model.constraints)
    known = set(rates.values())
    others = [i for i in range(model.signature.n_x) if i not in known]
    if not bool(model.constraints.free[:, others].any()) or bool(model.constraints.offset[:, others].any()):
        return []
    data = data.to(torch.float64).select(choose_stretches(len(data), BRIEF))
    keep, stretches = rows_after_delay(data, model.delay), len(data.segment.unique())
    enough = max(len(data) // 2, 2 * len(model.library)) + stretches
    longest = SLOWEST * data.longest_segment if len(data) >= enough else 0
    times = [n * data.dt for n in TIMES if n <= longest]
    # Shorter delays in whole samples.
    delays = dict.fromkeys(
        model.delay if part == 1 else round(part * model.delay / data.dt) * data.dt for part in PARTS
    )
    late = {delay: RegressionData.of(delay_inputs(data, delay).select(keep), rates, True) for delay in delays}
    # What may be followed: the inputs, and the measured states whose equation, or whose rate's, is sought.
    measured, found, alone = ~data.x.isnan().all(0), list[tuple[float, SindyModel]](), late[model.delay]
    plain = _unexplained(model, alone.rows(model.library, model.library))
    followed, states = set(model.followed.values()), model.signature.state_names
    names = [n for i, n in enumerate(states) if n not in followed and bool(measured[i] & _moved(model, i)[1])]
    inputs = [name for name in model.signature.input_names if name not in followed]
    each_or_all = [(name,) for name in (*inputs, *names)] + [tuple(inputs)] * (len(inputs) > 1)
    trials = [(signals, reduce(with_lag_state, signals, model)) for signals in each_or_all]
    if beside and len({_moved(model, model.signature.state_index(name))[0] for name in names}) > 1:  # parts of a plant
        trials += [((name,), with_lag_state(model, name, beside=True)) for name in inputs]
    reached = dict[tuple[str, ...], float]()  # what an input gains beside its lag counts, not what the lag does
    for signals, wide in trials if times else ():
        lags, more = len(signals), int(wide.constraints.free.sum() - model.constraints.free.sum())
        cost, rows, delay, time = _best_lag(wide, signals, late, times)
        # The time, and each coefficient, is a number more; what hardly lags stands for a rate, which explains itself.
        gain = min(plain, reached.get(signals, plain)) - cost - more / 2 * math.log(len(rows[0]))
        reached[signals] = cost
        if gain > 0 and (signals[0] in inputs or time > times[0]):
            wide.initial, wide.initial_delay = _solved(wide, rows, time, lags), delay
            found.append((gain / len(rows[0]), wide))
    return [wide for _, wide in sorted(found, key=lambda each: -each[0])]


def _best_lag(
    wide: SindyModel, signals: Sequence[str], late: Mapping[float, RegressionData], times: Sequence[float]
) -> tuple[float, Rows, float, float]:
    """Return what the best delay and time of lags leave over, its rows, and both: of every other time, then beside."""
    rows, costs = dict[tuple[float, float], Rows](), dict[tuple[float, float], float]()
    near = times[::2]
    for _ in range(2):
        tried = {(delay, time): _led(each, wide, signals, time) for delay, each in late.items() for time in near}
        rows, costs = rows | tried, costs | {key: _unexplained(wide, each, len(signals)) for key, each in tried.items()}
        best = min(costs, key=costs.__getitem__)
        near = [time for time in times[1::2] if best[1] / 2 < time < 2 * best[1]]
    return costs[best], rows[best], *best


def _moved(model: SindyModel, i: int) -> tuple[int, bool]:
    """Return the state whose equation a store beside state i acts on, or its known rate, and if that is sought."""
    rate = {of: rate for rate, of in rate_states(model.library, model.constraints).items()}.get(i, i)
    return rate, bool(model.constraints.free[:, rate].any())


def _level(guess: Transitions, names: Signature, signal: str) -> Tensor:
    """Return the mean of a signal over each interval, `(N,)`."""
    if signal in names.input_names:
        return guess.mean_inputs[:, names.input_names.index(signal)]
    return 0.5 * (guess.x + guess.x_next)[:, names.state_index(signal)]


def _led(seen: RegressionData, wide: SindyModel, signals: Sequence[str], time: float) -> Rows:
    """Return averaged rows under states that follow signals with a time [s], then a decay for each stretch."""
    guess, n_x = seen.guess, wide.signature.n_x
    _, stretch = guess.segment.unique_consecutive(return_inverse=True)
    since = (torch.arange(len(guess)) - guess.segment_starts()).double().unsqueeze(-1) * guess.dt
    began = torch.exp(-since / time) * torch.nn.functional.one_hot(stretch)
    own = [_lag_dynamics(_level(guess, wide.signature, signal), guess, time) for signal in signals]
    states = zip((guess.x, guess.x_next), zip(*own, strict=True), (1.0, math.exp(-guess.dt / time)))
    x, x_next = (torch.cat([each, torch.stack(lags, -1), left * began], -1) for each, lags, left in states)
    measured = widened(seen.measured, x.shape[1] - n_x + len(signals))

    def _theta(x: Tensor, u: Tensor) -> Tensor:
        return torch.cat([wide.library(x[..., :n_x], u), x[..., n_x:]], -1)

    theta, dx = weak_form(_theta, measured, replace(guess, x=x, x_next=x_next), seen.rates, seen.half)
    return theta, dx[:, :n_x]


def _unexplained(model: SindyModel, rows: Rows, lags: int = 0) -> float:
    """Return N/2 log of what is left over."""
    free, fixed = _columns(model, rows, torch.where(model.constraints.free, 0.0, model.coefficients), lags)
    return unexplained(free, rows[0], rows[1] - rows[0] @ fixed)


def _columns(model: SindyModel, rows: Rows, given: Tensor, lags: int) -> tuple[Tensor, Tensor]:
    """Return where coefficients of rows are sought, and those that are given, both `(n_columns, n_x)`."""
    more, free = rows[0].shape[1] - len(model.library), model.constraints.free
    # What decays may act wherever a coefficient is sought, but for the equations of the last states, which follow.
    free = torch.cat([free, free.any(0).expand(more, -1)])
    free[:, free.shape[1] - lags :] = False
    return free, torch.nn.functional.pad(given, (0, 0, 0, more))


def _solved(wide: SindyModel, rows: Rows, time: float, lags: int) -> Tensor:
    """Return the coefficients that the regression of a model finds."""
    columns = _columns(wide, rows, wide.constraints.offset, lags)
    found = wide.regression.solve(TriangularFactor(rows), *columns)[: len(wide.library)]
    found[-lags:, -lags:] = torch.eye(lags) / time
    return found


def has_clear_lags(model: SindyModel) -> bool:
    """Tell whether each state that follows a signal acts on another one, by a coefficient that is no chance."""
    if model.covariance is None:
        return True
    rows, states, _ = model.covariance
    clear = model.covariance.shares(model.coefficients) < CLEAR
    others = {name: states != model.signature.state_index(name) for name in model.followed}
    reads = {name: torch.tensor([name in each.variables for each in model.library.features]) for name in others}
    return all(bool((clear & reads[name][rows] & others[name]).any()) for name in others)


def acts_at_once(model: SindyModel, signal: str) -> bool:
    """Tell whether an input that a state of a model follows stands in other equations, too."""
    others = (each for each in model.library.features if "ahead" not in [factor.function for factor in each.factors])
    return signal in model.signature.input_names and any(signal in each.variables for each in others)


def with_lag_state(model: SindyModel, signal: str, beside: bool = False) -> SindyModel:
    """Return a model with one state more, which follows a signal, without coefficients but those that are known.

    Args:
        model: what may act through a lag.
        signal: the input in whose place the state stands, or a measured state that it stands beside.
        beside: whether an input acts both at once and through the lag, each where it may: on a part of a plant that is
            measured later than the others it acts late.
    """
    old, name = model.signature, f"{signal}_lagging"
    own, states = of("ahead", signal, name), model.signature.state_names
    read, more, rows = list(model.library.features), {}, list(range(len(model.library)))
    if signal in old.input_names:
        signature = old.with_state(name, "1")
        through = [feature.renamed({signal: name}) for feature in read]
        late = [k for k, feature in enumerate(read) if beside and signal in feature.variables]
        read, rows = (read if beside else through) + [through[k] for k in late], rows + late
    else:
        place = old.state_index(signal)
        signature = old.with_state(name, old.state_units[place], old.x_scale[place])
        more = {states[_moved(model, place)[0]]: [own.name()]}
    written, known = [feature.name() for feature in read], rate_states(model.library, model.constraints)
    allowed = {
        state: [n for n, k in zip(written, rows, strict=True) if model.constraints.free[k, i]] + more.get(state, [])
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
    bands, force = np.ones((2, len(signal))), np.where(anew, signal, (1 - left) * signal)
    bands[1, :-1] = np.where(anew[1:], 0.0, -left)  # each end but the first of a stretch hangs on the one before
    found = torch.from_numpy(solve_banded((1, 0), bands, force))
    return torch.where(anew, signal, found.roll(1)), found


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
        level = _level(guess, names, signal)
        behind = _lag_dynamics(level, data, 1 / float(model.coefficients[:, place].sum()))[1] - level
        found[place] = float(behind.min()), float(behind.max())
    return found


def widened(data: Transitions, count: int = 1) -> Transitions:
    """Return a recording with so many more states, which no sensor sees."""
    if not count:
        return data
    unseen = torch.full_like(data.x[:, :1], torch.nan).expand(-1, count)
    return replace(data, x=torch.cat([data.x, unseen], -1), x_next=torch.cat([data.x_next, unseen], -1))
