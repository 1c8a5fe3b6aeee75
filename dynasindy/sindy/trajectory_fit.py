"""Gauss-Newton on the error of whole trajectories, start states estimated too, and the functions it needs."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import torch
from torch import Tensor

from dynasindy.progress import TimeIsUp, report_progress
from dynasindy.sindy.library import Library
from dynasindy.sindy.regression import least_missed, walk_down
from dynasindy.sindy.sensitivity import Parameters
from dynasindy.sindy.shooting import (
    COARSE,
    ENOUGH,
    EXACT,
    FINE,
    FINEST,
    Descent,
    Estimate,
    Flow,
    Linearised,
    RunsAway,
    Windows,
    choose_stretches,
    cost_of,
    linearise_windows,
    move,
    relative_step,
    substeps_for,
)
from dynasindy.systems.transitions import Transitions

NOISY = 1e-7
"""Part of a coefficient's effect that those of others leave over, below which data cannot tell it from them."""
ROUGH, MOVES_LITTLE = 1e-4, 1e-5
"""Part of the cost that a step gains, below which steps end: where functions may still go, and where none does."""
ELEMENTS, FEWEST = 300_000_000, 2000
"""Numbers in the products that choose functions, about, and rows that they are chosen by, at least."""
SHORTEST_DELAY = 0.01
"""Shortest delay of the inputs that is believed [samples]."""
SLIGHT = 0.2
"""Squared error, in units of its variance, below which a step tells nothing of a fit to innovations: an observer that
hardly corrects moves on and on."""
STEPS = 30
"""Steps of Levenberg and Marquardt's method at most between two changes of the equations."""
BETTER = 2.0
"""Squared weighted error that an exchange of one coefficient for one other must gain."""
TRIES = 10
"""Sets of functions that are tried at most."""


def selection_rows(free: Tensor, observed: bool) -> int:
    """Return how many rows of a recording functions are chosen by.

    Of innovations, of which every sample tells as much, the fewer, the more there are to choose from.

    Args:
        free: coefficients to choose from, bool `(n_features, n_x)`.
        observed: whether innovations of an observer are minimised.
    """
    if not observed:
        return ENOUGH
    return max(FEWEST, min(ENOUGH, round(ELEMENTS / max(int(free.sum()), 1) ** 2)))


def _price(n: int, free: Tensor) -> float:
    """Return the squared weighted error that a coefficient must be worth: extended BIC (Chen and Chen 2008)."""
    return math.log(max(n, 2)) + 2 * math.log(max(int(free.sum(0).max()), 1))


def _search_functions(estimate: Estimate, free: Tensor, windows: Windows, price: float) -> Estimate:
    """Converge, drop and reconsider until nothing is better; what was there before stays if it was, once converged."""
    flow = Flow.of(estimate, Parameters.where((estimate.xi != 0) & free), windows)
    best: tuple[Flow, Linearised] | None = None
    least, fewest = math.inf, 0
    for _ in range(TRIES):
        try:
            flow, model = _descended(flow, price)
        except RunsAway:
            if best is None:
                raise
            break
        if model is None:
            break
        left = _left_over(model, windows)
        if best is not None and 2 * (left - least) + price * (len(flow.parameters) - fewest) >= 0:
            break
        best, least, fewest = (flow, model), left, len(flow.parameters)
        active = flow.parameters
        others = Parameters.where(free & ~active.support(free.shape))
        if not len(others):
            break
        try:
            report_progress("fit", note=f"which of {len(others)} terms that were left out should come in")
        except TimeIsUp:
            break
        wider = replace(flow, parameters=active + others)
        model = linearise_windows(wider)
        n_fixed = len(model.scale) - len(wider.parameters)
        better = _reconsider(model.triangle, n_fixed, active, others, price)
        if better is None:
            break
        kept = torch.cat([torch.arange(n_fixed), n_fixed + better])
        changed = _changed(wider, model, kept)
        if changed is None:
            break
        flow = changed
    return flow.estimate if best is None else best[0].estimate


def _reconsider(triangle: Tensor, n_fixed: int, active: Parameters, others: Parameters, limit: float) -> Tensor | None:
    """Return places in `active + others` of a better set, by R of [fixed unknowns, active, others, target], or None."""
    n = n_fixed + len(active)
    # A score test: the best function of each equation comes in that would lower the error by more than it costs.
    columns, error = triangle[n:, n:-1], triangle[n:, -1]
    growth = (columns.mT @ error).square() / columns.square().sum(0).clamp_min(1e-12)
    firsts = [int(growth.where(others.states == state, -1.0).argmax()) for state in others.states.unique()]
    if best := [first for first in firsts if float(growth[first]) > 2 * limit]:
        return torch.cat([torch.arange(len(active)), len(active) + torch.tensor(best)])
    # An exchange: one comes in for two or more of any equation, as sin(alpha) for three that imitate it at small
    # angles, for a wrong one may hold another that makes up for it; at last the best one for one, within an equation.
    swaps: dict[float, Tensor] = {}
    for k in range(len(others)):
        state = others.states[k]
        chosen = [*range(n), n + k, triangle.shape[1] - 1]
        small = torch.linalg.qr(triangle[:, chosen], mode="r")[1]
        removable = torch.zeros(n + 1, dtype=torch.bool)
        removable[n_fixed:n] = True
        kept, _ = walk_down(small, removable, limit)
        if len(kept) <= n - 1:
            stay = kept[(kept >= n_fixed) & (kept < n)] - n_fixed
            return torch.cat([stay, torch.tensor([len(active) + k])])
        removable[n_fixed:n] = active.states == state
        out, missed = least_missed(small, n + 1, removable)
        if float(growth[k]) > missed + BETTER:
            stay = torch.tensor([j for j in range(len(active)) if j != out - n_fixed], dtype=torch.int64)
            swaps[float(growth[k]) - missed] = torch.cat([stay, torch.tensor([len(active) + k])])
    return swaps[max(swaps)] if swaps else None


def _left_over(model: Linearised, windows: Windows) -> float:
    """Return N/2 times the logarithm of the squared errors, summed over measured states."""
    counts, sigma = windows.mask.sum((0, 1)), model.sigma
    seen = sigma > EXACT
    return float((counts * sigma.log())[seen].sum())


def _descended(flow: Flow, price: float) -> tuple[Flow, Linearised | None]:
    """Converge and drop until the support stands still; drops that cost more than foreseen come back. None of none."""
    before: tuple[Flow, Linearised] | None = None
    model: Linearised | None = None
    left, allowed, enough, windows = math.inf, 0.0, ROUGH, flow.windows
    while len(flow.parameters):
        try:
            flow, model = _settle(flow, enough, model)
        except RunsAway:
            if before is None:
                raise
            return before
        cost = _left_over(model, windows)
        if before is not None and 2 * (cost - left) > allowed:
            return _settle(before[0], MOVES_LITTLE, before[1])
        n_fixed = len(model.scale) - len(flow.parameters)
        kept, _ = walk_down(model.triangle, torch.arange(len(model.scale)) >= n_fixed, price, NOISY)
        if len(kept) == len(model.scale):
            if enough == MOVES_LITTLE:
                break
            enough = MOVES_LITTLE  # what may go is judged once more where the steps have come to their end
            continue
        changed = _changed(flow, model, kept)
        if changed is None:
            break
        before, left, allowed = (flow, model), cost, 2 * price * (len(model.scale) - len(kept))
        flow, model = changed, None
    return flow, model


def _changed(flow: Flow, model: Linearised, kept: Tensor) -> Flow | None:
    """Return the trajectories with the kept unknowns alone, by a whole step or as they are; None where all run away."""
    estimate, parameters = flow.estimate, flow.parameters
    n_fixed = len(model.scale) - len(parameters)
    chosen = parameters.take(kept[kept >= n_fixed] - n_fixed)
    whole, bare = move(flow, model, kept), 0 * parameters.read(estimate.xi)
    left_out = chosen.write(parameters.write(estimate.xi, bare), chosen.read(estimate.xi))
    chosen = Parameters.where(chosen.support(estimate.xi.shape))
    trials = (Flow.of(trial, chosen, flow.windows) for trial in (whole, replace(estimate, xi=left_out)))
    return next((trial for trial in trials if not (len(chosen) and bool(trial.lost().any()))), None)


def _settle(flow: Flow, enough: float = MOVES_LITTLE, model: Linearised | None = None) -> tuple[Flow, Linearised]:
    """Make Levenberg-Marquardt steps until one gains less than a part `enough` of the cost; `model` is of `flow`."""
    damping, parameters, windows = 0.0, flow.parameters, flow.windows
    model = model or linearise_windows(flow)
    what = f"{len(parameters)} coefficients, by simulations of {len(windows) * windows.length} samples"
    for k in range(0 if model.least else STEPS):
        try:
            report_progress("fit", note=f"step {k + 1} of at most {STEPS} for {what}")
        except TimeIsUp:
            break
        candidate = move(flow, model, torch.arange(len(model.scale)), damping)
        trial = Flow.of(candidate, parameters, windows)
        cost = cost_of(trial, model.sigma) if bool(trial.predicted.square().isfinite().all()) else math.inf
        lost = not cost < math.inf or (cost < model.cost and bool(trial.lost().any()))
        after = linearise_windows(trial) if cost < model.cost and not lost else None
        if after is None or not bool(after.triangle.isfinite().all()):
            if damping > 1e6 or (not lost and abs(cost - model.cost) < 1e-6 * model.cost):
                return flow, replace(model, least=True)
            damping = max(10 * damping, 1e-3)
            continue
        gain = (model.cost - cost) / model.cost
        slight = flow.estimate.gain is not None and model.cost - cost < SLIGHT
        flow, model, damping = trial, after, damping / 10 if damping > 1e-6 else 0.0
        if gain < enough or slight:
            break
    return flow, model


FARTHEST = 1e6
"""Factor by which errors grow along a trajectory, beyond which it begins anew: coefficients look alike after that."""
SHORTEST = 2
"""Sampling intervals in the shortest window."""


def refine_trajectory(
    library: Library,
    xi: Tensor,
    free: Tensor,
    data: Transitions,
    descent: Descent,
    start: Tensor | None = None,
    delay: float = 0.0,
    gain: tuple[Tensor, Tensor] | None = None,
) -> Flow:
    """Minimise the error of whole trajectories over coefficients and start states; drop what does not matter.

    Segments are to be long against the window. `start` is a guess of the states before each transition, `(N, n_x)`; the
    measured ones by default. Where a descent has the inputs `before` each row, their delay is fitted, too, from a first
    guess [s] on, and left out where it is not worth a coefficient. With a first guess of the `gain` of an observer, and
    where it is fitted, what is minimised are its innovations: errors of one step ahead, the states of which are
    estimated from all samples before (Ljung 1999, section 7.2). They are white where the model is right, whether the
    plant is pushed at random, the sensors are noisy, or both.

    Raises:
        RunsAway: the model runs away within the shortest of windows.
    """
    free = free if descent.select else free & (xi != 0)
    data = data.to(torch.float64)
    guess = data.x if start is None else start.to(torch.float64)
    some, before = choose_stretches(len(data), selection_rows(free, gain is not None)), descent.before

    def _priced(n: int) -> float:
        return descent.penalty * _price(n, free) if descent.select else 0.0

    price, first = _priced(int(some.sum())), Estimate(library, xi, guess[some], delay, *(gain or ()))
    brief = descent if before is None else replace(descent, before=before[some])
    turned = COARSE if descent.floor is None else FINEST
    flow = _grown(first, (xi != 0) & free, data.select(some), brief, turned)
    found, windows = flow.estimate, flow.windows
    if descent.joined and not bool(data.x_next.isnan().any()):  # windows on their own tell little of unmeasured states
        found = _search_functions(found, free, replace(windows, joined=torch.zeros_like(windows.joined)), price)
    if descent.joined:
        windows = replace(windows, joined=_joins(Flow.of(found, flow.parameters.take(slice(0)), windows)))
    found = _search_functions(found, free, windows, price)
    if bool(some.all()):
        found, windows = _finely(found, free, windows, price)
    else:
        support = (found.xi != 0) & free
        flow = _grown(replace(found, nodes=guess), support, data, descent, min(turned, FINE))
        windows = replace(flow.windows, joined=_joins(flow)) if descent.joined else flow.windows
        flow = Flow.of(flow.estimate, Parameters.where(support), windows)
        found = _descended(flow, _priced(len(data)))[0].estimate
    found = _without_delay(found, free, windows)
    return Flow.of(found, Parameters.where((found.xi != 0) & free), windows)


def _without_delay(found: Estimate, free: Tensor, windows: Windows) -> Estimate:
    """Return an estimate without its delay, where that is not worth a coefficient, or a hundredth of a sample."""
    support = (found.xi != 0) & free
    if not found.delay or not bool(support.any()):
        return found
    with suppress(RunsAway):
        prompt = replace(windows.delayed(0.0), history=None)
        flow, parameters = Flow.of(found, Parameters.where(support), windows), Parameters.where(support)
        simple, model = _settle(Flow.of(replace(found, delay=0.0), parameters, prompt), ROUGH)
        worth = _price(int(windows.mask.sum()), free)
        told = found.delay > SHORTEST_DELAY * windows.dt
        if not told or 2 * (_left_over(model, prompt) - _left_over(linearise_windows(flow), windows)) <= worth:
            return _settle(simple, MOVES_LITTLE, model)[0].estimate
    return found


def _finely(found: Estimate, free: Tensor, windows: Windows, price: float) -> tuple[Estimate, Windows]:
    """Return an estimate by the steps that its fastest rate asks for, where it was found by longer ones."""
    support = (found.xi != 0) & free
    if not bool(support.any()):
        return found, windows
    turn = relative_step(found.library, found.xi, found.nodes, windows.inputs[:, 0], windows.dt)
    wanted = substeps_for(turn, FINE if windows.descent.floor is None else FINEST)
    if wanted <= windows.substeps:
        return found, windows
    finer = replace(windows, substeps=wanted)
    with suppress(RunsAway):  # what was found is no worse for it
        return _descended(Flow.of(found, Parameters.where(support), finer), price)[0].estimate, finer
    return found, windows


def _joins(flow: Flow) -> Tensor:
    """Return which windows continue the one before, bool `(W,)`: not where an error of a start has grown too far."""
    windows, spread = flow.windows, flow.estimate.nodes.std(0, correction=0).clamp_min(1e-12)
    grown, joined = torch.eye(len(spread), dtype=spread.dtype), windows.joined.clone()
    ends = torch.cat([part.s[:, -1, :, : len(spread)] for _, part in flow.parts(flow.pieces)])
    for j, step in enumerate((ends * spread / spread.unsqueeze(-1)).unbind()):
        joined[j] = bool(joined[j]) and bool((step @ grown).norm() <= FARTHEST)
        grown = step @ grown if joined[j] else step
    return joined


def _with_fitted_starts(flow: Flow) -> Flow:
    """Return trajectories that begin where each window tells it best, where a state is seen by no sensor."""
    estimate, windows = flow.estimate, flow.windows
    if bool(windows.mask.flatten(0, 1).any(0).all()) or windows.descent.floor is not None or bool(flow.lost().any()):
        return flow
    alone = replace(windows, joined=torch.zeros_like(windows.joined))
    model = linearise_windows(Flow.of(estimate, flow.parameters.take(slice(0)), alone))
    trial = Flow.of(replace(estimate, nodes=estimate.nodes + model.moves[..., -1]), flow.parameters, windows)
    return trial if cost_of(trial, model.sigma) < cost_of(flow, model.sigma) else flow


def _grown(estimate: Estimate, support: Tensor, data: Transitions, descent: Descent, turned: float) -> Flow:
    """Return trajectories in windows of the wanted length, or as long as there are, in which they do not run away."""
    turn = relative_step(estimate.library, estimate.xi, estimate.nodes, data.u, data.dt)
    substeps, parameters = substeps_for(turn, turned), Parameters.where(support)
    guess, length = estimate.nodes, descent.window

    def _cut(found: Estimate, length: int) -> tuple[Flow, bool]:
        windows = Windows.of(data, replace(descent, window=length), substeps)
        trial = _with_fitted_starts(Flow.of(replace(found, nodes=guess[windows.rows]), parameters, windows))
        return trial, bool(trial.lost().any())

    flow, lost = _cut(estimate, length)
    while lost and length > SHORTEST:
        length = max(SHORTEST, length // 4)
        flow, lost = _cut(estimate, length)
    while length < descent.window:
        flow = _settle(flow)[0]
        guess = guess.index_copy(0, flow.windows.rows, flow.estimate.nodes)
        longer = min(2 * length, descent.window)
        found, lost = _cut(flow.estimate, longer)
        if lost:
            break  # a model that runs away in longer windows is fitted to these
        flow, length = found, longer
    return flow
