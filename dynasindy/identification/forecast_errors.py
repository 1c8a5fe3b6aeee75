"""How far ahead a model predicts: errors over horizons that matter, from many start times, beside simpler predictions.

Each horizon is judged by the root-mean-square error over all samples up to it. A model starts from states that are
estimated on the samples before, since what no sensor sees cannot be read off and what sensors see is noisy.

| name    | meaning                                   | shape           |
| ------- | ----------------------------------------- | --------------- |
| starts  | rows at which predictions begin           | `(S,)`          |
| steps   | sampling times in each horizon            | `(H,)`          |
| errors  | root-mean-square error over each horizon  | `(H, n_x)`      |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from dynasindy.identification.recording_diagnostics import resolutions, sensor_errors
from dynasindy.sindy import SindyModel
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.reconstruction import rate_states, reconstruct
from dynasindy.sindy.regression import least_squares
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.sindy.world_model import variance
from dynasindy.systems.base import Signature, turn_of
from dynasindy.systems.equilibria import LocalModes, central_differences
from dynasindy.systems.kalman import kalman_update
from dynasindy.systems.transitions import Transitions

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 20)
"""Numbers of past samples to choose from."""
ENOUGH_ROWS, ENOUGH_SAMPLES = 20_000, 200_000
"""Rows of a long recording that tell some fifty weights as well as all of them, and predicted samples that tell which
of two models is better."""


@dataclass(frozen=True)
class LinearModel:
    """A linear model on past samples.

    Attributes:
        order: past samples that it reads.
        seen: states that it reads and predicts, bool `(n_x,)`: those that were measured twice in a row.
        weights: of past outputs and inputs, newest first, of inputs at the end of an interval, and of one,
            `(order * (n_y + n_u) + n_linear + 1, n_y)`.
        linear: inputs that move within an interval, which it also reads at its end, bool `(n_u,)`.
    """

    order: int
    seen: Tensor
    weights: Tensor
    linear: Tensor

    @classmethod
    def fit(cls, data: Transitions, steps: int, most: int) -> LinearModel:
        """Fit the order that predicts the data themselves best, over as many steps.

        Rows that read a lost sample are left out. Where too few are complete for any order, the model has no weights.

        Args:
            data: the recording, NaN where a state was not measured.
            steps: sampling times over which orders are compared.
            most: largest order.
        """
        starts, _ = start_rows(data, most, steps)
        starts = starts[:: 1 + len(starts) * steps // ENOUGH_SAMPLES]
        later, real = samples_after(data, starts, steps)
        spread = variance(data.x_next.double()).clamp_min(1e-300)

        def _error(model: LinearModel) -> float:
            error = (model.predict(data, starts, later) - real).square().nanmean((0, 1)) / spread
            return float(error[model.seen].sum().nan_to_num(math.inf, math.inf))

        none = cls(1, _seen(data), torch.zeros(0), data.linear_inputs)
        return min(cls.candidates(data, most), key=_error, default=none)

    @classmethod
    def candidates(cls, data: Transitions, most: int) -> list[LinearModel]:
        """Fit models of all orders, up to `most` samples."""
        models = (cls._of_order(data, order) for order in ORDERS if order <= most)
        return [model for model in models if model is not None]

    @classmethod
    def _of_order(cls, data: Transitions, order: int) -> LinearModel | None:
        seen, rows = _seen(data), torch.arange(order - 1, len(data))
        rows = rows[data.segment[rows] == data.segment[rows - order + 1]]
        rows = rows[choose_stretches(len(rows), ENOUGH_ROWS)]
        past = rows.unsqueeze(-1) - torch.arange(order)
        parts = [data.x[past][..., seen].flatten(1), data.u[past].flatten(1)]
        parts += [data.last_inputs[rows][:, data.linear_inputs], torch.ones(len(rows), 1)]
        columns = torch.cat([part.double() for part in parts], -1)
        target = data.x_next[rows][:, seen].double()
        complete = ~(columns.isnan().any(-1) | target.isnan().any(-1))
        columns, target = columns[complete], target[complete]
        if not bool(seen.any()) or len(columns) < 2 * columns.shape[1]:
            return None
        scale = columns.norm(dim=0).clamp_min(1e-300)
        weights = least_squares(columns / scale, target) / scale.unsqueeze(-1)
        return cls(order, seen, weights, data.linear_inputs)

    def predict(self, data: Transitions, starts: Tensor, later: Tensor) -> Tensor:
        """Predict from some rows on, `(S, T, n_x)`; infinite where it runs away.

        States that were not measured are NaN, and all of them where one of the past samples was lost.

        Args:
            data: the recording.
            starts: rows at which predictions begin, with `order` rows of their segment before them, `(S,)`.
            later: rows whose inputs act in turn, `(S, T)`.
        """
        predicted = torch.full((*later.shape, len(self.seen)), math.nan, dtype=torch.float64)
        if not len(self.weights):
            return predicted
        past = (starts.unsqueeze(-1) - torch.arange(self.order)).clamp_min(0)
        outputs = data.x[past][..., self.seen].double()
        inputs = torch.cat([data.u[past[:, 1:]].flip(1), data.u[later]], 1).double()
        lost, n_y, n_u = outputs.isnan().flatten(1).any(-1), outputs.shape[-1], inputs.shape[-1]
        sizes = self.order * n_y, self.order * n_u, int(self.linear.sum()), 1
        own, driven, ending, constant = self.weights.split(sizes)
        forced = constant + data.last_inputs[later][..., self.linear].double() @ ending
        for k, weights in enumerate(driven.split(n_u)):
            forced += inputs[:, self.order - 1 - k : self.order - 1 - k + later.shape[1]] @ weights
        # Of the outputs themselves each needs the one before: a loop of few and small products, the newest first.
        found = torch.cat([forced.flip(1), outputs], 1).permute(1, 2, 0).flatten(0, 1).contiguous().numpy()
        weights, width = own.mT.contiguous().numpy(), self.order * n_y
        with np.errstate(all="ignore"):
            for place in range((later.shape[1] - 1) * n_y, -1, -n_y):
                found[place : place + n_y] += weights @ found[place + n_y : place + n_y + width]
        moved = torch.from_numpy(found).unflatten(0, (-1, n_y))[: later.shape[1]].flip(0).permute(2, 0, 1)
        predicted[:, :, self.seen] = moved.nan_to_num(math.inf, math.inf, -math.inf)
        predicted[lost] = math.nan
        return predicted


def _seen(data: Transitions) -> Tensor:
    """Return which states were measured at both ends of an interval, bool `(n_x,)`: others have no such equation."""
    return ~(data.x.isnan() | data.x_next.isnan()).all(0)


STARTS = 200
"""Start times, at most; as many tell, on the data of the fit, on how many samples start states are best estimated."""
FARTHEST = 10_000
"""Samples ahead up to which predictions are judged; of what wanders for longer nothing more is told."""
SHORTEST_FIT, LONGEST_FIT = 10, 200
"""Samples before a start on which its states are estimated, at least and at most."""
LONGEST_STEP, MOST_STEPS = 0.01, 20
"""Longest Runge-Kutta step [s], unless a sampling time would take more than so many."""
LOST = 10.0
"""Error beyond which a prediction has run away [ranges of the state]."""
ALIKE = 1e-9
"""Error that is as good as none where numbers of samples are compared [share of `LOST`]."""
PAIRS = 200_000
"""Pairs of samples, about, that tell how far the states of a long recording move in a time."""
NUDGE, SLOPE = 1e-6, 1e-4
"""Steps of the differences by which start states are fitted, and by which they are filtered [ranges of the states]."""
SETTLED = 1e-4
"""Part of its squared error that no start gains or loses any more, where fits of start states end."""
UNKNOWN, LEAST_ERROR = 0.1, 1e-6
"""Standard deviation of a state that no sensor sees where a filter begins, and least error of a sensor [ranges]."""
HOUR, MANY = 3600.0, 10_000.0
"""An hour [s], and the time from which on horizons are some hours [s]."""


@dataclass(frozen=True)
class ForecastErrors:
    """Hold what a model and simpler predictions reach on data that no fit has seen.

    Attributes:
        horizons: times ahead [s].
        characteristic: time in which the slowest measured state changes by its own spread [s].
        starts: start times.
        model: errors of the model, `(H, n_x)`; NaN for a state that was not measured, infinite where it runs away.
        linear: of a linear model fitted to the same data, on past inputs and outputs.
        held: of the last measured value.
        resolution: what the sensors can tell, `(n_x,)`.
        order: past samples that the linear model reads.
    """

    horizons: tuple[float, ...]
    characteristic: float
    starts: int
    model: Tensor
    linear: Tensor
    held: Tensor
    resolution: Tensor
    order: int

    @property
    def middle(self) -> int:
        """Return the place of the horizon next to the characteristic time."""
        return self.nearest(self.characteristic)

    def nearest(self, seconds: float) -> int:
        """Return the place of the horizon next to a time [s], as a ratio."""
        return min(range(len(self.horizons)), key=lambda k: abs(math.log(self.horizons[k] / seconds)))

    def without(self, states: Collection[int]) -> ForecastErrors | None:
        """Return the errors without those of some states, as if they had not been measured; None if none stay."""
        model, held = self.model.clone(), self.held.clone()
        model[:, list(states)] = held[:, list(states)] = torch.nan
        return None if bool(held.isnan().all()) else replace(self, model=model, held=held)


def forecast_errors(
    model: SindyModel, training: Transitions, validation: Transitions, horizons: Sequence[float] | None = None
) -> ForecastErrors | None:
    """Judge a model from many start times; None where the validation data are too short for that.

    Args:
        model: a fitted model.
        training: data that a linear model is fitted to.
        validation: data to judge on, NaN where a state was not measured.
        horizons: times ahead [s]. If omitted, they begin at half of the fastest time constant of the model, where the
            data mostly are, or at a tenth of the time in which the slowest measured state changes, whichever is
            shorter, and end at three times the latter.
    """
    if not len(validation):
        return None
    time = characteristic(training, model.signature)
    fit = min(max(round(time / 4 / validation.dt), round(model.memory / validation.dt), SHORTEST_FIT), LONGEST_FIT)
    while (reach := start_rows(validation, fit)[1]) < 2 * fit and fit > 2:
        fit //= 2
    steps = [round(h / validation.dt) for h in horizons or _horizons(model, training, time)]
    steps = sorted({k for k in steps if 1 <= k <= min(reach, FARTHEST)})
    if not steps:
        return None
    starts, _ = start_rows(validation, fit, steps[0])
    later, real = samples_after(validation, starts, steps[-1])
    # As for the linear model, the middle horizon counts: what is farther says little of where a prediction began.
    usual = [k for k in steps if k * validation.dt >= time / 10] or steps
    middle = usual[len(usual) // 2]
    length, sensors = _length(model, training, fit, [k for k in usual if k <= middle]), sensor_errors(training)
    begin = starting_states(model, validation, starts, length, sensors)
    predicted = predict_from(model, validation, begin, later)
    linear = LinearModel.fit(training, middle, fit)
    # The last value of each state that was measured in its segment until a start.
    places, x = torch.arange(len(validation)), validation.x
    seen, first = torch.where(x.isnan(), -1, places.unsqueeze(-1)).cummax(0).values, places - _beside(validation)[0]
    held = torch.where(seen >= first.unsqueeze(-1), x.gather(0, seen.clamp_min(0)), math.nan)[starts]
    held = held.unsqueeze(1).expand_as(real)
    both = (predicted, linear.predict(validation, starts, later), held)
    ours, simple, last = (errors_over(guess, real, steps) for guess in both)
    return ForecastErrors(
        tuple(k * validation.dt for k in steps),
        time,
        len(starts),
        ours,
        simple,
        last,
        resolutions(training, model),
        linear.order,
    )


def _horizons(model: SindyModel, data: Transitions, time: float) -> list[float]:
    """Return times ahead over which a model is judged [s], of data whose slowest state changes in some time [s]."""
    x = reconstruct(data, rate_states(model.library, model.constraints)).x.double().nanmedian(0).values
    measured = [i for i, blind in enumerate(data.x.isnan().all(0).tolist()) if not blind]
    fastest = LocalModes(model, x.nan_to_num(0.0), data.u.double().median(0).values, measured).time_constant
    low, high = max(data.dt, min(time / 10, fastest / 2)), 3 * time
    # 1, 2, 5, 10 ... of seconds, from 10000 s on of hours.
    decades = range(math.floor(math.log10(low / HOUR)), math.ceil(math.log10(high)) + 1)
    series = [n * 10.0**k for k in decades for n in (1, 2, 5)]
    times = [n for n in series if n < MANY] + [HOUR * n for n in series if HOUR * n >= MANY]
    return [each for each in times if low <= each <= high]


def _length(model: SindyModel, data: Transitions, longest: int, steps: Sequence[int]) -> int:
    """Return on how many samples before a start its states are best estimated: doubled while that helps.

    Where a fit has kept data to tell, it is as many as were best there.
    """
    if model.memory:
        return min(longest, max(1, round(model.memory / data.dt)))
    # More of them average the noise, but what the model lacks, pushes, and what grows spoil an estimate the more.
    lengths = [longest >> k for k in range(longest.bit_length()) if not k or longest >> k >= SHORTEST_FIT]
    starts, _ = start_rows(data, longest, steps[0])
    if len(lengths) < 2 or not len(starts):
        return longest
    later, real = samples_after(data, starts, steps[-1])
    most = LOST * torch.tensor(model.signature.x_scale, dtype=torch.float64)

    def _cost(length: int) -> float:
        predicted = predict_from(model, data, starting_states(model, data, starts, length), later)
        return float(errors_over(predicted, real, steps).clamp(ALIKE * most, most).log().nanmean())

    best, least = longest, math.inf
    for length in reversed(lengths):
        if not (cost := _cost(length)) < least:
            break
        best, least = length, cost
    return best


def starting_states(
    model: SindyModel, data: Transitions, starts: Tensor, length: int, sensors: Tensor | None = None
) -> Tensor:
    """Return the states at some rows, `(S, n_x)`, that a model tells from so many samples before each.

    A plant that nothing else moves is where a simulation through these samples ends, one with process noise where a
    Kalman filter ends.

    Args:
        model: a fitted model.
        data: the recording, NaN where a state was not measured.
        starts: the rows, `(S,)`.
        length: the samples.
        sensors: errors of the sensors of the first states, as `sensor_errors` tells them, of the recording if omitted.
    """
    late = delay_inputs(data, model.delay)
    if model.process_noise:
        sensors = sensor_errors(data) if sensors is None else sensors
        return _filtered_states(model, late, starts - length, length, sensors)
    return estimate(model, late, starts - length, length)[1]


def _filtered_states(model: SindyModel, data: Transitions, rows: Tensor, length: int, sensors: Tensor) -> Tensor:
    """Return the states `(S, n_x)` of an extended Kalman filter that many samples after some rows.

    Source: Simon, Optimal State Estimation (2006), section 13.2.
    """
    rates, n_x = rate_states(model.library, model.constraints), model.signature.n_x
    guess = model.guess_states(data)
    scale = torch.tensor(model.signature.x_scale, dtype=torch.float64)
    error = torch.cat([sensors.double(), scale.new_full((n_x - len(sensors),), math.nan)])
    variance = torch.where(error.isnan(), scale, error.maximum(LEAST_ERROR * scale)).square()
    noise = torch.full_like(scale, model.process_noise)
    noise[[*rates.values(), *model.followers]] = 0.0  # a place moves by its rate alone, a lag by what it follows
    pushed = torch.diag((noise * scale).square() * data.dt)
    first = torch.where(data.x[rows].isnan(), (UNKNOWN * scale).square(), variance)
    x, covariance = guess.x[rows].double(), torch.diag_embed(first)
    for row in (rows + k for k in range(length)):
        ahead = partial(_simulated, model, inputs=data.inputs_of(row.reshape(-1, 1, 1)), dt=data.dt)
        moved, slopes = _slopes(ahead, x, SLOPE * scale)
        spread = slopes @ covariance @ slopes.mT + pushed
        sound = moved.isfinite().all(-1) & spread.isfinite().all((-2, -1))
        x = torch.where(sound.unsqueeze(-1), moved, x)
        covariance = torch.where(sound[:, None, None], spread, covariance)
        x, covariance, _, _ = kalman_update(x, covariance, data.x_next[row].double(), variance)
    return x


def _slopes(ahead: Callable[[Tensor], Tensor], x: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
    """Return states after an interval, `(S, n_x)`, and their slopes by those before it, `(S, n_x, n_x)`."""
    return central_differences(lambda off: ahead(x.unsqueeze(-2) + off).squeeze(-2), steps)


def predict_from(model: SindyModel, data: Transitions, begin: Tensor, later: Tensor) -> Tensor:
    """Return what a model predicts for some rows from states on, `(S, T, n_x)`, infinite where it runs away."""
    inputs = delay_inputs(data, model.delay).inputs_of(later)
    return _simulated(model, begin, inputs, data.dt).nan_to_num(math.inf, math.inf, -math.inf)


def predict_ahead(model: SindyModel, training: Transitions, data: Transitions, starts: Tensor, steps: int) -> Tensor:
    """Return what a model predicts after some rows, `(S, steps, n_x)`, infinite where it runs away.

    Its states are estimated on samples before, as many as `forecast_errors` would take, or as there are.

    Args:
        model: a fitted model.
        training: what it was fitted to, its states those of the model.
        data: the recording, likewise.
        starts: rows of the last samples that are known, one segment's, `(S,)`.
        steps: sampling times that are predicted.
    """
    longest = int(starts.max())
    length = _length(model, training, min(LONGEST_FIT, longest), [steps]) if len(starts) > 1 else longest
    begin = torch.zeros(len(starts), model.signature.n_x, dtype=torch.float64)
    before, sensors = starts.clamp_max(length), sensor_errors(training)
    for count in before.unique().tolist():
        begin[before == count] = starting_states(model, data, starts[before == count], count, sensors)
    return predict_from(model, data, begin, starts.unsqueeze(-1) + torch.arange(steps))


def start_rows(data: Transitions, before: int, after: int = 1) -> tuple[Tensor, int]:
    """Return rows with so many rows before and after them in their segments, and how many the longest has after it.

    The rows, `(S,)`, are evenly spread, `STARTS` at most.
    """
    back, ahead = _beside(data)
    rows = ((back >= before) & (ahead >= after)).nonzero().flatten()
    spread = torch.linspace(0, len(rows) - 1, min(STARTS, len(rows))).round().long().unique()
    return rows[spread], int(torch.where(back >= before, ahead, 0).max())


def samples_after(data: Transitions, starts: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Return the rows of so many samples after each start, `(S, T)`, and what was measured there, `(S, T, n_x)`.

    It is NaN where nothing was, or beyond the segment.
    """
    later = starts.unsqueeze(-1) + torch.arange(steps)
    inside, later = torch.arange(steps) < _beside(data)[1][starts].unsqueeze(-1), later.clamp_max(len(data) - 1)
    return later, torch.where(inside.unsqueeze(-1), data.x_next[later], math.nan)


def characteristic(data: Transitions, signature: Signature) -> float:
    """Return the time in which the slowest measured state changes by its own spread [s]; a third of a log at most.

    An angle that turns over is as far from where it was after a part of a turn as it ever is.
    """
    longest = max(2, data.longest_segment // 3)
    lags = sorted({round(1.15**k) for k in range(200) if round(1.15**k) <= longest})
    waiting = [i for i in range(data.x.shape[1]) if float(data.x_next[:, i].nan_to_num().std()) > 0]
    turns = torch.tensor([turn_of(unit) for unit in signature.state_units], dtype=torch.float64)
    spread = (data.x_next - data.x_next.nanmean(0)).square().nanmean(0).sqrt().minimum(turns / math.sqrt(12))
    stride = -(-len(data) // PAIRS)
    for lag in lags:
        later, sooner = slice(lag, None, stride), slice(None, -lag, stride)
        same = data.segment[later] == data.segment[sooner]
        change = (data.x_next[later] - data.x_next[sooner])[same].square().nanmean(0).sqrt()
        waiting = [i for i in waiting if not change[i] >= spread[i]]
        if not waiting:
            return lag * data.dt
    return lags[-1] * data.dt


def estimate(model: SindyModel, data: Transitions, rows: Tensor, length: int) -> tuple[Tensor, Tensor]:
    """Fit the states at some rows to what was measured in the samples after them.

    Args:
        model: a fitted model.
        data: the recording, its inputs delayed as the model's are; NaN where a state was not measured.
        rows: rows at which the fits begin, `(S,)`.
        length: sampling times that each fit covers.

    Returns:
        States at the beginning and at the end of each fit, `(S, n_x)` both.
    """
    after = rows.unsqueeze(-1) + torch.arange(length)
    measured = torch.cat([data.x[rows].unsqueeze(1), data.x_next[after]], 1)
    mask, inputs = ~measured.isnan(), data.inputs_of(after)
    guess = model.guess_states(data)
    x = guess.x[rows].double()
    scale = torch.tensor(model.signature.x_scale, dtype=torch.float64)
    damping = torch.full((len(rows),), 1e-3, dtype=torch.float64)
    path = torch.cat([x.unsqueeze(1), _simulated(model, x, inputs, data.dt)], 1)
    for _ in range(8):
        kept = path.isfinite().all(-1).all(-1)  # those that do not run away
        squares = torch.where(mask, measured - path, 0.0)[kept].square().sum((0, 1))
        sigma = (squares / mask[kept].sum((0, 1)).clamp_min(1)).sqrt().clamp_min(1e-9 * scale)
        nudged = x + NUDGE * torch.diag(scale).unsqueeze(1)
        moved = _simulated(model, nudged, inputs, data.dt)
        slopes = (torch.cat([nudged.unsqueeze(2), moved], 2) - path) / NUDGE  # by each state [its range]
        weight = mask / sigma
        columns = (slopes * weight).flatten(2).permute(1, 2, 0)
        error = ((measured - path).nan_to_num(nan=0.0) * weight).flatten(1)
        sound = columns.isfinite().all(-1).all(-1) & error.isfinite().all(-1)
        columns, error = torch.where(sound[:, None, None], columns, 0.0), torch.where(sound[:, None], error, 0.0)
        normal = columns.mT @ columns
        ridge = damping.unsqueeze(-1) * normal.diagonal(dim1=-2, dim2=-1) + 1e-6
        step = torch.linalg.solve(normal + torch.diag_embed(ridge), (columns.mT @ error.unsqueeze(-1))).squeeze(-1)
        trial = x + step * scale
        tried = torch.cat([trial.unsqueeze(1), _simulated(model, trial, inputs, data.dt)], 1)
        now, then = (((measured - p).nan_to_num(nan=0.0) * weight).square().sum((1, 2)) for p in (path, tried))
        # What runs away is worse than anything finite.
        better = (then < now) | (then.isfinite() & ~now.isfinite())
        better &= tried.isfinite().all(-1).all(-1)
        x = torch.where(better[:, None], trial, x)
        path = torch.where(better[:, None, None], tried, path)
        damping = torch.where(better, damping / 10, damping * 10)
        if bool(((now - then).abs() <= SETTLED * now).all()):  # a step that was refused is tried again, shorter
            break
    end = path[:, -1]
    return x, torch.where(end.isfinite(), end, guess.x[rows + length - 1].double())


def with_start_states(model: SindyModel, data: Transitions) -> Transitions:
    """Return a recording whose segments begin at known states, under inputs delayed as the model's are.

    Args:
        model: a fitted model.
        data: the recording; the first states of each segment are those that its first samples tell, as one sample is
            noisy and lacks what no sensor sees.
    """
    late = delay_inputs(data, model.delay)
    x, back = late.x.double().clone(), _beside(data)[0]
    for first in (back == 0).nonzero().flatten().tolist():
        rest = data.segment[first:] == data.segment[first]
        length = min(SHORTEST_FIT * 5, int(rest.long().cumprod(0).sum()))
        x[first] = estimate(model, late, torch.tensor([first]), length)[0][0]
    return replace(late, x=x)


def _simulated(model: SindyModel, x: Tensor, inputs: tuple[Tensor, Tensor | None], dt: float) -> Tensor:
    """Predict states after each interval, `(*batch, T, n_x)`, under inputs at both ends of each."""
    wide = (*x.shape[:-1], *inputs[0].shape[-2:])
    u, u_end = inputs[0].double().expand(wide), None if inputs[1] is None else inputs[1].double().expand(wide)
    with torch.no_grad():
        substeps = max(min(math.ceil(dt / LONGEST_STEP - 1e-9), MOST_STEPS), model.substeps(dt))
        return model.simulate(x, u, dt, substeps, u_end)[..., 1:, :]


def errors_over(predicted: Tensor, real: Tensor, steps: Sequence[int]) -> Tensor:
    """Return the root-mean-square error over each horizon, `(H, n_x)`; what is NaN of either does not count."""
    squared, last = (predicted - real).square(), torch.tensor(steps) - 1
    counts = (~squared.isnan()).sum(0).cumsum(0)[last]
    return (squared.nansum(0).cumsum(0)[last] / counts).sqrt()


def _beside(data: Transitions) -> tuple[Tensor, Tensor]:
    """Return how many rows of its segment come before each row, and how many from it on, `(N,)` both."""
    label = data.begins().long().cumsum(0) - 1
    back = torch.arange(len(data)) - data.segment_starts()
    return back, torch.bincount(label)[label] - back
