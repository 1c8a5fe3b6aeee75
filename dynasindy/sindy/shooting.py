"""Multiple shooting: trajectories of windows, their sensitivities, and the linear model of their errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dynasindy.sentences import setting
from dynasindy.sindy.codegen import simulate
from dynasindy.sindy.covariance import STRETCHES, Covariance, jackknife
from dynasindy.sindy.library import Library
from dynasindy.sindy.sensitivity import Parameters, slopes_by_state, trajectory_sensitivities
from dynasindy.systems.interpreter import MeasurementUpdate
from dynasindy.systems.transitions import Transitions

ENOUGH = 10_000
"""Rows of a recording on which functions are chosen; the coefficients are fitted on all."""
CHOSEN_STRETCHES = 10
"""Stretches that the rows lie in that are chosen of a long recording."""
CHUNK, TALL = 100_000, 4
"""Slopes, about, that are condensed at once, so that they stay in fast memory, and rows at least for each column, by
which condensing them is worth its cost."""
MOST_SLOPES = 10_000_000
"""Slopes, about, that are computed at once, and held in memory."""


@dataclass(frozen=True)
class Descent:
    """Say how trajectories are fitted.

    Attributes:
        window: sampling intervals in a window; fewer where the model runs away in windows as long as that.
        joined: whether windows join to one trajectory, which begins anew where small errors grow too far, as in chaos.
        select: whether functions come in and go; if not, those of the first estimate stay.
        penalty: factor on the squared error that a coefficient must be worth.
        floor: errors that are as good as none, `(n_x,)`, where samples have no noise: each window begins where it was
            measured. Else None.
        before: inputs of the M samples before each row, `(N, M, n_u)`, where the delay is fitted after which they act.
    """

    window: int
    joined: bool = True
    select: bool = True
    penalty: float = 1.0
    floor: Tensor | None = None
    before: Tensor | None = None


@dataclass(frozen=True)
class Windows:
    """Hold a recording cut into W windows of L sampling intervals.

    Attributes:
        rows: place of the first transition of each window in the recording, `(W,)`.
        first: states measured at the beginning of each window, `(W, n_x)`, NaN where not measured.
        inputs: inputs at the start of each interval, `(W, L, n_u)`.
        measured: states measured at the ends of the intervals, `(W, L, n_x)`, zero where not measured.
        mask: 1 where a state was measured at the end of an interval of the recording, else 0, `(W, L, n_x)`.
        joined: whether a window continues the one before, bool `(W,)`.
        dt: length of an interval [s].
        descent: how they are fitted.
        substeps: Runge-Kutta steps in an interval.
        last_inputs: inputs at the end of each interval, `(W, L, n_u)`; None where they are held.
        history: inputs as they were applied, from M samples before each window to its end, `(W, M + L + 1, n_u)`; with
            them the delay after which they act is fitted, without `inputs` stay as they are.
    """

    rows: Tensor
    first: Tensor
    inputs: Tensor
    measured: Tensor
    mask: Tensor
    joined: Tensor
    dt: float
    descent: Descent
    substeps: int = 1
    last_inputs: Tensor | None = None
    history: Tensor | None = None

    @classmethod
    def of(cls, data: Transitions, descent: Descent, substeps: int = 1) -> Windows:
        """Cut every segment of a recording into windows; the last one may be shorter.

        Args:
            data: the recording; NaN where a state was not measured.
            descent: how long they are, and whether each continues the one before or begins at a state of its own.
            substeps: Runge-Kutta steps in an interval.
        """
        length, before = descent.window, descent.before
        within_segment = torch.arange(len(data)) - data.segment_starts()
        starts = (within_segment % length == 0).nonzero().flatten()
        ends = torch.cat([starts[1:], torch.tensor([len(data)])]).unsqueeze(-1)
        places = starts.unsqueeze(-1) + torch.arange(length)
        within, places = places < ends, torch.minimum(places, ends - 1)
        u, u_end = data.inputs_of(places)
        after = data.x_next[places]
        return cls(
            rows=starts,
            first=data.x[starts],
            inputs=u,
            measured=after.nan_to_num(),
            mask=(within.unsqueeze(-1) & ~after.isnan()).to(after.dtype),
            joined=descent.joined & ~data.begins()[starts],
            dt=data.dt,
            descent=descent,
            substeps=substeps,
            last_inputs=u_end,
            history=None if before is None else torch.cat([before[starts], u, data.last_inputs[places[:, -1:]]], 1),
        )

    def delayed(self, delay: float) -> Windows:
        """Return the windows under inputs that act `delay` seconds later, `longest` at most."""
        if self.history is None:
            return self
        whole, part = divmod(delay / self.dt, 1.0)
        first = self.history.shape[1] - 1 - self.length - int(whole)
        sooner, now, later = (self.history[:, first + k : first + k + self.length] for k in (-1, 0, 1))
        inputs = (1 - part) * now + part * sooner
        if self.last_inputs is None:
            return replace(self, inputs=inputs)
        linear = (self.last_inputs != self.inputs).flatten(0, 1).any(0)
        return replace(self, inputs=inputs, last_inputs=torch.where(linear, (1 - part) * later + part * now, inputs))

    @property
    def longest(self) -> float:
        """Longest delay of the inputs that is fitted [s]."""
        return 0.0 if self.history is None else (self.history.shape[1] - self.length - 2) * self.dt

    def of_states(self, chosen: Tensor) -> Windows:
        """Return what was measured of some states, bool `(n_x,)`."""
        measured, mask = self.measured[..., chosen], self.mask[..., chosen]
        return replace(self, first=self.first[:, chosen], measured=measured, mask=mask)

    def part(self, rows: slice) -> Windows:
        """Return some of the windows."""
        names = ("rows", "first", "inputs", "measured", "mask", "joined", "last_inputs", "history")
        parts: dict[str, Any] = {name: None if (each := getattr(self, name)) is None else each[rows] for name in names}
        return replace(self, **parts)

    def __len__(self) -> int:
        """Count the windows."""
        return len(self.rows)

    @property
    def length(self) -> int:
        """Count the sampling intervals of a window."""
        return self.mask.shape[1]


def choose_stretches(n: int, wanted: int, window: int = 1) -> Tensor:
    """Choose rows of a long recording in evenly spread stretches of equal length, bool `(n,)`; all of a short one.

    Each is two windows long or more, of so many rows, where there are so many.
    """
    if n <= wanted:
        return torch.ones(n, dtype=torch.bool)
    count = max(1, min(CHOSEN_STRETCHES, wanted // (2 * window)))
    length = wanted // count
    begins = torch.linspace(0, n - length, count).long()
    chosen = torch.zeros(n, dtype=torch.bool)
    chosen[(begins.unsqueeze(-1) + torch.arange(length)).flatten()] = True
    return chosen


STEP = 1e-3
"""Samples by which inputs are shifted, to differentiate by their delay."""
EXACT = 1e-100
"""Error taken for that of a state that is met exactly, as one that never moves; its inverse has a finite square."""
ROUNDING = 1e-12
"""Part of a state below which errors are those of arithmetic, which differ from processor to processor."""
FINEST, FINE, COARSE, STABLE, MOST_STEPS = 0.02, 0.1, 0.3, 1.5, 10
"""Runge-Kutta step times the fastest rate of the model: for errors of 1e-9, 1e-7, and 2e-5, by which functions are
compared, and the most that is stable; and how many steps of an interval the next two, and five times as many the first,
may ask for."""


@dataclass
class Estimate:
    """Hold the unknowns of a fit to trajectories.

    Attributes:
        library: functions with their shapes.
        xi: coefficients, `(n_features, n_x)`.
        nodes: states at the begin of each window, `(W, n_x)`.
        delay: of the inputs [s], where it is fitted.
        gain: of the observer that corrects the states after each interval, `(n_x, n_x)`; None of simulations.
        gain_mask: which of its elements are fitted, bool `(n_x, n_x)`.
    """

    library: Library
    xi: Tensor
    nodes: Tensor
    delay: float = 0.0
    gain: Tensor | None = None
    gain_mask: Tensor | None = None

    def measurement_update(self, windows: Windows) -> MeasurementUpdate | None:
        """Return what corrects the states in windows."""
        if self.gain is None:
            return None
        fitted = None if self.gain_mask is None else self.gain_mask.nonzero().mT
        return MeasurementUpdate(torch.where(windows.mask > 0, windows.measured, math.nan), self.gain, fitted)


@dataclass(frozen=True)
class Flow:
    """Hold the trajectories of all windows; their sensitivities are computed when they are first asked for.

    Attributes:
        estimate: coefficients and nodes.
        parameters: coefficients to differentiate by, P of them.
        windows: the recording.
        predicted: states at the ends of the intervals, `(W, L, n_x)`.
    """

    estimate: Estimate
    parameters: Parameters
    windows: Windows
    predicted: Tensor

    @classmethod
    def of(cls, estimate: Estimate, parameters: Parameters, windows: Windows) -> Flow:
        """Integrate all windows."""
        windows = windows.delayed(estimate.delay)
        return cls(estimate, parameters, windows, _states_of(estimate, windows))

    @cached_property
    def s(self) -> Tensor:
        """Derivatives of the states by the window's start, gain, delay, shapes and Xi, `(W, L, n_x, n_x + D + S + P)`.

        D numbers of the gain and the delay are fitted.
        """
        estimate, windows = self.estimate, self.windows
        begin = estimate.nodes, windows.inputs, windows.dt, windows.substeps, windows.last_inputs
        update = estimate.measurement_update(windows)
        s = trajectory_sensitivities(estimate.library, estimate.xi, self.parameters, *begin, update)[1]
        if windows.history is None:
            return s
        later = _states_of(estimate, windows.delayed(estimate.delay + STEP * windows.dt))
        place = s.shape[-1] - len(estimate.library.shapes) - len(self.parameters)
        by_delay = ((later - self.predicted) / (STEP * windows.dt)).unsqueeze(-1)
        return torch.cat([s[..., :place], by_delay, s[..., place:]], -1)

    @property
    def count(self) -> int:
        """Count the slopes."""
        columns = self.predicted.shape[-1] + len(self.estimate.library.shapes) + len(self.parameters)
        return self.predicted.numel() * columns

    @property
    def pieces(self) -> int:
        """Count the parts of the recording whose slopes are condensed one after the other."""
        n_x, seen = self.predicted.shape[-1], int(_observed(self.windows).sum())
        tall = self.predicted.numel() ** 2 * seen // (TALL * n_x**2 * self.count)
        return max(1, min(1 + self.count // CHUNK, tall))

    def part(self, rows: slice) -> Flow:
        """Return the trajectories of some of the windows."""
        estimate = replace(self.estimate, nodes=self.estimate.nodes[rows])
        return Flow(estimate, self.parameters, self.windows.part(rows), self.predicted[rows])

    def parts(self, count: int) -> Iterator[tuple[slice, Flow]]:
        """Yield so many parts of the windows, and their trajectories; slopes are computed of many windows at once."""
        begin, some, block = 0, len(self.windows) * MOST_SLOPES // max(self.count, 1), self.part(slice(0))
        for each in torch.arange(len(self.windows)).tensor_split(min(count, len(self.windows))):
            rows = slice(int(each[0]), int(each[-1]) + 1)
            if rows.stop > begin + len(block.windows):
                begin, block = rows.start, self.part(slice(rows.start, max(rows.stop, rows.start + some)))
            part = self.part(rows)
            part.__dict__["s"] = block.s[rows.start - begin : rows.stop - begin]
            yield rows, part

    def lost(self) -> Tensor:
        """Return which windows the model runs away in, bool `(W,)`."""
        return ~self.predicted.square().isfinite().all(-1).all(-1)

    def sigma(self) -> Tensor:
        """Return the error of each state, `(n_x,)`, not below rounding.

        It is `EXACT` where none was measured, or a state is zero throughout.
        """
        windows = self.windows
        error = (windows.measured - self.predicted) * windows.mask
        size = (windows.measured * windows.mask).square().sum((0, 1))
        squares = (error.square().sum((0, 1)), ROUNDING**2 * size)
        found = (torch.maximum(*squares) / windows.mask.sum((0, 1)).clamp_min(1)).sqrt().clamp_min(EXACT)
        return found if windows.descent.floor is None else found.maximum(windows.descent.floor)


def _states_of(estimate: Estimate, windows: Windows) -> Tensor:
    """Return the states at the ends of the intervals of all windows, `(W, L, n_x)`."""
    if not bool(estimate.xi.isfinite().all()):
        return torch.full((*windows.mask.shape[:2], estimate.xi.shape[1]), math.nan, dtype=estimate.nodes.dtype)
    inputs = windows.inputs, windows.dt, windows.substeps, windows.last_inputs
    return simulate(estimate.library, estimate.xi, estimate.nodes, *inputs, estimate.measurement_update(windows))


def relative_step(library: Library, xi: Tensor, x: Tensor, u: Tensor, dt: float) -> float:
    """Return the length of an interval by the time of the fastest motion of a model: its rate times `dt`.

    A difference equation does not move within its steps, so that it is 0, however fast the equation is.
    """
    if library.step is not None or not bool(xi.any()):
        return 0.0
    slopes = slopes_by_state(library, xi, x, u)
    rates = torch.linalg.eigvals(slopes[slopes.isfinite().all(-1).all(-1)]).abs().amax(-1)
    return dt * float(torch.quantile(rates[-100_000:], 0.999)) if len(rates) else 0.0


def substeps_for(turn: float, turned: float = FINE) -> int:
    """Return into how many steps an interval is divided so that a step is `turned` long, see `relative_step`."""
    most = MOST_STEPS if turned > FINEST else 5 * MOST_STEPS
    return max(1, min(math.ceil(turn / turned - 1e-6), most), min(math.ceil(turn / STABLE), 10 * MOST_STEPS))


TRUST = 2.0
"""Factor by which a step may change the number inside a function."""
UNOBSERVABLE = 1e-300
"""Weight of an unknown that nothing measured depends on."""


class RunsAway(ValueError):
    """A model leaves all bounds within the shortest of windows."""


@dataclass(frozen=True)
class Linearised:
    """Hold the condensed linear model at an estimate.

    Attributes:
        triangle: R of [fixed unknowns, coefficients, target], all weighted and scaled.
        scale: norms of the columns.
        cost: sum of squared errors and of squared gaps between windows, both weighted.
        moves: how the node of each window moves with the unknowns, `(W, n_x, F + P + 1)`.
        sigma: error of each state, `(n_x,)`.
        least: whether no step from here was found to lower the cost.
    """

    triangle: Tensor
    scale: Tensor
    cost: float
    moves: Tensor
    sigma: Tensor
    least: bool = False


def linearise_windows(flow: Flow, sigma: Tensor | None = None) -> Linearised:
    """Take all windows with their sensitivities and eliminate the nodes that continue a window.

    `sigma` `(n_x,)`, the weights, are the errors of each state, by default those of the trajectories.

    Raises:
        RunsAway: without `sigma`, so at an estimate that is no trial, the model runs away within a window.
    """
    if sigma is None:
        if bool((lost := flow.lost()).any()):
            method, window = (setting(f"world_model.refinement.{key}") for key in ("method", "window"))
            raise RunsAway(
                f"{method}=trajectory: the model runs away in {int(lost.sum())} of {len(lost)} windows of "
                f"{flow.windows.length} samples, the first of them number {int(lost.nonzero()[0])}; look for outliers "
                f"there, lower {window}, or choose another {method}"
            )
        sigma = flow.sigma()
    triangles, rest, moves = _condensed(flow, sigma, flow.pieces)
    parameters, rows = flow.parameters, torch.linalg.qr(torch.cat([*triangles, rest]), mode="r")[1]
    n_fixed = moves.shape[-1] - len(parameters) - 1
    scale = rows[:, :-1].norm(dim=0).clamp_min(UNOBSERVABLE)
    target = rows[:, -1:] + rows[:, n_fixed:-1] @ parameters.read(flow.estimate.xi).unsqueeze(-1)
    triangle = torch.linalg.qr(torch.cat([rows[:, :-1] / scale, target], -1), mode="r")[1]
    return Linearised(triangle, scale, cost_of(flow, sigma), moves, sigma)


def shooting_covariance(flow: Flow) -> Covariance | None:
    """Return the covariance of the coefficients of trajectories that fit best, starts and shapes unknown as well.

    It is None where nothing is estimated, or the model runs away.
    """
    if not len(flow.parameters) or bool(flow.lost().any()):
        return None
    # Errors within a window have its start in common, so it is left out as a whole where there are enough of them.
    triangles, rest, _ = _condensed(flow, flow.sigma(), STRETCHES)
    factor, count = jackknife(triangles, rest), len(flow.parameters)
    return None if factor is None else Covariance(flow.parameters.features, flow.parameters.states, factor[-count:])


def _condensed(flow: Flow, sigma: Tensor, count: int) -> tuple[list[Tensor], Tensor, Tensor]:
    """Condense the weighted errors and their slopes by the unknowns, part by part, so that each stays in fast memory.

    Returns R of the errors of `count` parts of the recording, rows that are of none, and the moves of all nodes.
    """
    windows, observed = flow.windows, _observed(flow.windows)
    joined, n_seen = bool(windows.joined.any()), int(observed.sum())
    triangles, moves, ahead = list[Tensor](), list[Tensor](), None
    parts = 1 if len(windows) < count else count
    for mine, part in flow.parts(parts):
        if joined:
            moved, ahead = _node_moves(flow, mine, part.s[:, -1], ahead)
            rows = _joined(part, sigma, moved, observed)
        else:
            rows, moved = _alone(part, sigma, observed)
        units = len(windows) if len(windows) >= count // parts > 1 else len(rows) // n_seen
        pieces = rows.unflatten(0, (units, -1)).tensor_split(count // parts)
        triangles += [torch.linalg.qr(piece.flatten(0, 1), mode="r")[1] for piece in pieces if len(piece)]
        moves.append(moved)
    nodes = torch.cat(moves) if windows.descent.floor is None else moves[0]
    return triangles, _starts(flow, sigma, nodes) if joined else triangles[0][:0], nodes


def _observed(windows: Windows) -> Tensor:
    """Return which states have errors, bool `(n_x,)`: the rows of the others are zero. All where none has."""
    seen = windows.mask.flatten(0, 1).any(0) | ~windows.first.isnan().all(0)
    return seen if bool(seen.any()) else ~seen


def _joined(flow: Flow, sigma: Tensor, moves: Tensor, observed: Tensor) -> Tensor:
    """Return the weighted rows of windows of one trajectory, `(W L n_seen, F + P + 1)`; `moves` are of their nodes."""
    n_x, windows = flow.predicted.shape[-1], flow.windows.of_states(observed)
    s = flow.s[:, :, observed]
    # error - d predicted: the node's move, then shapes and coefficients.
    columns = (s[..., :n_x].flatten(1, 2) @ moves).unflatten(1, s.shape[1:3])
    columns[..., -1 - s.shape[-1] + n_x : -1] += s[..., n_x:]
    columns[..., -1] = windows.measured - flow.predicted[..., observed] - columns[..., -1]
    return columns.mul_((windows.mask / sigma[observed]).unsqueeze(-1)).flatten(0, 2)


def _starts(flow: Flow, sigma: Tensor, moves: Tensor) -> Tensor:
    """Return the weighted rows of the starts of trajectories, `(S n_x, F + P + 1)`."""
    begun = ~flow.windows.joined
    start_error = (flow.windows.first - flow.estimate.nodes)[begun]
    starts = moves[begun].clone()
    starts[..., -1] = start_error - starts[..., -1]
    return torch.where(start_error.isnan().unsqueeze(-1), 0.0, starts / sigma.unsqueeze(-1)).flatten(0, 1)


def cost_of(flow: Flow, sigma: Tensor) -> float:
    """Return the cost of `linearise_windows`, by no slopes."""
    estimate, windows = flow.estimate, flow.windows
    weighed = (windows.measured - flow.predicted) * windows.mask / sigma
    starts = (windows.first - estimate.nodes)[~windows.joined].nan_to_num() / sigma
    cost = float(weighed.square().sum() + starts.square().sum())
    if bool(windows.joined.any()):
        # A gap shifts all samples that follow, so closing it is worth more than the errors it hid.
        gap_weight = 10.0 * windows.mask.shape[1]
        # What no sensor sees is weighed by the errors of the others.
        spread, seen = estimate.nodes.std(0, correction=0).clamp_min(1e-12), sigma > EXACT
        relative = (sigma / spread)[seen].median() if bool(seen.any()) else torch.ones(())
        gap_sigma = torch.where(seen, sigma, relative * spread).clamp_min(EXACT)
        cost += gap_weight * float((_gaps(flow) / gap_sigma).square().sum())
    return cost


def _alone(flow: Flow, sigma: Tensor, observed: Tensor) -> tuple[Tensor, Tensor]:
    """Return weighted rows of windows on their own, `(W (L + 1) n_seen, F + P + 1)`, and how their nodes move.

    Each moves as fits its window best (variable projection); none where windows begin as measured: one row tells.
    """
    n_x = flow.predicted.shape[-1]
    if flow.windows.descent.floor is not None:
        error = flow.windows.measured - flow.predicted
        rows = torch.cat([flow.s[..., n_x:], error.unsqueeze(-1)], -1) / sigma.unsqueeze(-1)
        return rows[:, :, observed].flatten(0, 2), rows.new_zeros(1, n_x, rows.shape[-1])
    rows = _every(flow, observed).div_(sigma[observed].unsqueeze(-1)).flatten(1, 2)
    # A trial step may run away: its cost is infinite whatever these are, but the solver takes finite numbers alone.
    finite = rows.nan_to_num(0.0, 0.0, 0.0)
    q, r = torch.linalg.qr(finite[..., :n_x])
    best = torch.linalg.lstsq(r, q.mT @ finite[..., n_x:], driver="gelsd").solution
    moves = torch.cat([-best[..., :-1], best[..., -1:]], -1)
    return (rows[..., n_x:] - rows[..., :n_x] @ best).flatten(0, 1), moves


def _every(flow: Flow, observed: Tensor) -> Tensor:
    """Return slopes and errors of starts and samples, `(W, L + 1, n_seen, n_x + S + P + 1)`, zero where unmeasured."""
    windows, s = flow.windows.of_states(observed), flow.s[:, :, observed]
    start_error = windows.first - flow.estimate.nodes[:, observed]
    every = s.new_zeros(len(s), s.shape[1] + 1, *s.shape[2:-1], s.shape[-1] + 1)
    every[:, 0, :, : len(observed)] = torch.eye(len(observed), dtype=s.dtype)[observed]
    every[:, 1:, :, :-1] = s
    every[..., -1] = torch.cat([start_error.unsqueeze(1), windows.measured - flow.predicted[..., observed]], 1)
    seen = torch.cat([~start_error.isnan().unsqueeze(1), windows.mask > 0], 1)
    return every.masked_fill_(~seen.unsqueeze(-1), 0.0)


def _node_moves(flow: Flow, mine: slice, s: Tensor, ahead: Tensor | None) -> tuple[Tensor, Tensor]:
    """Express the moves of nodes, `(W, n_x, F + P + 1)`, by those of the first nodes, the shapes and the coefficients.

    A window that continues another one starts where that one ends, and `ahead` is how the end of the one before moves:
    d node_j = gap_j + A d node_(j-1) + B d (shapes, xi), A and B the sensitivities `s` at the end of window j - 1.
    """
    joined, gaps = flow.windows.joined, _gaps(flow)
    n_x, n_own, n_start = s.shape[1], s.shape[2] - s.shape[1], s.shape[1] * int((~joined).sum())
    moves = s.new_zeros(len(s), n_x, n_start + n_own + 1)
    begun = n_x * ((~joined).cumsum(0) - 1)
    own, slopes, end = moves.numpy(), s.numpy(), None if ahead is None else ahead.numpy()
    with np.errstate(all="ignore"):  # what runs away is told by what is left of it
        for k, j in enumerate(range(mine.start, mine.stop)):
            if bool(joined[j]):
                own[k] = end
                own[k, :, -1] += gaps[j].numpy()
            else:
                own[k, :, int(begun[j]) : int(begun[j]) + n_x] = np.eye(n_x)
            end = slopes[k, :, :n_x] @ own[k]
            end[:, -1 - n_own : -1] += slopes[k, :, n_x:]
    return moves, torch.from_numpy(end)


def _gaps(flow: Flow) -> Tensor:
    """Return by how much windows end beside those that continue them, `(W, n_x)`; zero at those that begin anew."""
    nodes, windows = flow.estimate.nodes, flow.windows
    ends = torch.cat([nodes[:1], flow.predicted[:-1, -1]])
    return torch.where(windows.joined.unsqueeze(-1), ends - nodes, 0.0)


def _limits(flow: Flow, n_fixed: int) -> Tensor:
    """Return how far each fixed unknown may move, `(2, F)`; gain, delay and shapes are last.

    Far from a straight line, as by its number, nothing tells the way back, so a step goes to some multiple at most.
    """
    estimate, windows, limits = flow.estimate, flow.windows, list[tuple[float, float]]()
    if estimate.gain is not None and estimate.gain_mask is not None:
        for i, j in estimate.gain_mask.nonzero().tolist():
            limits.append((-float(estimate.gain[i, j]) if i == j else -math.inf, math.inf))
    if windows.history is not None:
        limits.append((-estimate.delay, windows.longest - estimate.delay))
    for shape in estimate.library.shapes:
        (low, high), number = shape.limits, shape.frequency
        near, far = sorted((number / TRUST, number * TRUST))
        limits.append((max(low, near) - number, min(high, far) - number))
    free = [(-math.inf, math.inf)] * (n_fixed - len(limits))
    return torch.tensor([*free, *limits], dtype=torch.float64).reshape(-1, 2).mT


def _solve_within(square: Tensor, target: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return the least squares solution within limits; what has none to move in stays zero."""
    free, solution = low < high, torch.zeros_like(low)
    square, low, high = square[:, free], low[free], high[free]
    found = torch.linalg.lstsq(square, target.unsqueeze(-1), driver="gelsd").solution.squeeze(-1)
    if bool(((found < low) | (found > high)).any()):
        from scipy.optimize import lsq_linear  # a third of a second of imports

        bounds = low.numpy(), high.numpy()
        found = torch.from_numpy(lsq_linear(square.numpy(), target.numpy(), bounds, method="bvls").x)
    solution[free] = found
    return solution


def move(flow: Flow, model: Linearised, kept: Tensor | Sequence[int], damping: float = 0.0) -> Estimate:
    """Solve the linear model over the kept unknowns, the others zero, and move coefficients, shapes and nodes.

    `damping` is that of Levenberg and Marquardt.

    Raises:
        RunsAway: the linear model is not finite.
    """
    kept, estimate, parameters = torch.as_tensor(kept), flow.estimate, flow.parameters
    square, n_fixed = model.triangle[:, kept], len(model.scale) - len(parameters)
    old = torch.cat([torch.zeros(n_fixed), parameters.read(estimate.xi)]) * model.scale
    target = model.triangle[:, -1]
    if damping:
        square = torch.cat([square, damping**0.5 * torch.eye(len(kept), dtype=square.dtype)])
        target = torch.cat([target, damping**0.5 * old[kept]])
    if not bool(square.isfinite().all() & target.isfinite().all()):
        method, window = (setting(f"world_model.refinement.{key}") for key in ("method", "window"))
        raise RunsAway(
            f"{method}=trajectory: the trajectories leave all finite numbers; give a better first guess, lower "
            f"{window}, or choose another {method}"
        )
    low, high = torch.full_like(old, -math.inf), torch.full_like(old, math.inf)
    limits = _limits(flow, n_fixed) * model.scale[:n_fixed]
    # What nothing measured depends on would go anywhere by chance.
    low[:n_fixed], high[:n_fixed] = torch.where(model.scale[:n_fixed] > UNOBSERVABLE, limits, 0.0)
    solution = _solve_within(square, target, low[kept], high[kept])
    values = torch.zeros_like(old).index_copy(0, kept, solution) / model.scale
    step = values.clone()
    step[n_fixed:] -= parameters.read(estimate.xi)
    nodes = estimate.nodes + model.moves[..., :-1] @ step + model.moves[..., -1] / (1 + damping)
    library, shapes = estimate.library, estimate.library.shapes
    if shapes:
        numbers = step[n_fixed - len(shapes) : n_fixed].tolist()
        library = library.with_shapes([shape.frequency + by for shape, by in zip(shapes, numbers, strict=True)])
    delay, gain, place = estimate.delay, estimate.gain, n_fixed - len(shapes)
    if flow.windows.history is not None:
        place -= 1
        delay = min(max(delay + float(step[place]), 0.0), flow.windows.longest)
    if gain is not None and (mask := estimate.gain_mask) is not None:
        gain = gain.masked_scatter(mask, gain[mask] + step[place - int(mask.sum()) : place])
    xi = parameters.write(estimate.xi, values[n_fixed:])
    return replace(estimate, library=library, xi=xi, nodes=nodes, delay=delay, gain=gain)
