"""Which functions a fit to trajectories needs: converge, drop, and let in what is worth more than it costs."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.told import tell
from dynasindy.world_models.refinement.flow import Estimate, Flow
from dynasindy.world_models.refinement.plainer import plainer
from dynasindy.world_models.refinement.repeated import repetition
from dynasindy.world_models.refinement.shooting import (
    Linearised,
    RunsAway,
    cost_of,
    left_over,
    linearise,
    move,
)
from dynasindy.world_models.refinement.windows import Windows
from dynasindy.world_models.regression.selection import reconsider, walk_down
from dynasindy.world_models.regression.sensitivity import Parameters

NOISY = 1e-7
"""Part of a coefficient's effect that those of others leave over, below which data cannot tell it from them."""
ROUGH, SETTLED = 1e-4, 1e-5
"""Part of the cost that a step gains, below which steps end: where functions may still go, and where none does."""
TRIES = 10
"""Sets of functions that are tried at most."""


@dataclass(frozen=True)
class Limits:
    """Say what a coefficient must be worth, and how many steps are made.

    Attributes:
        price: squared error, in units of its variance, that a coefficient must be worth where errors are white.
        max_rounds: limit on Gauss-Newton steps between two changes of the equations.
        correlated: whether it must be worth the more, the longer errors last.
    """

    price: float
    max_rounds: int
    correlated: bool = False

    def at(self, errors: Tensor, windows: Windows) -> float:
        """Return what a coefficient must be worth where a model leaves over these errors, `(W, L, n_x)`."""
        return self.price * repetition(errors, windows.mask, windows.joined) if self.correlated else self.price


def price(n: int, free: Tensor) -> float:
    """Return the squared weighted error that a coefficient must be worth: extended Bayesian criterion.

    The more functions there are to choose from, the better is the best one of those that mean nothing (Chen and
    Chen 2008).

    Args:
        n: transitions.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
    """
    return math.log(max(n, 2)) + 2 * math.log(max(int(free.sum(0).max()), 1))


def search(estimate: Estimate, free: Tensor, windows: Windows, limits: Limits) -> Estimate:
    """Converge, drop and reconsider until there is nothing better.

    What is better to first order may be worse once it has converged, as on a plant that runs away. Then what was there
    before stays, and the coefficients that came in are not tried again.
    """
    flow = Flow.of(estimate, Parameters.where((estimate.xi != 0) & free), windows)
    came = failed = torch.zeros_like(free)
    best: tuple[Flow, Linearised] | None = None
    least, fewest = math.inf, 0
    for _ in range(TRIES):
        try:
            flow, model = _descended(flow, limits)
        except RunsAway:
            if best is None:
                raise
            break
        if model is None:
            break
        limit, left = limits.at(model.errors, windows), left_over(model, windows)
        if best is not None and 2 * (left - least) + limit * (len(flow.parameters) - fewest) >= 0:
            flow, model = best
            support = flow.parameters.support(free.shape)
            if not bool((came & ~support & ~failed).any()):
                break  # it only left functions out, and would do so again
            failed = failed | (came & ~support)
        else:
            best, least, fewest = (flow, model), left, len(flow.parameters)
            support = flow.parameters.support(free.shape)
        active, others = flow.parameters, Parameters.where(free & ~support & ~failed)
        if not len(others):
            break
        tell("fit", words=f"which of {len(others)} terms that were left out should come in")
        wider = replace(flow, parameters=active + others)
        model = linearise(wider)
        n_fixed = len(model.scale) - len(wider.parameters)
        better = reconsider(model.triangle, n_fixed, active, others, limits.at(model.errors, windows))
        if better is None:
            break
        kept = torch.cat([torch.arange(n_fixed), n_fixed + better])
        changed = _changed(wider, model, kept)
        if changed is None:
            break
        flow, came = changed, changed.parameters.support(free.shape)
    found = flow.estimate if best is None else best[0].estimate
    for place in range(len(found.library.shapes)):
        simple = plainer(found.library, found.xi, free, place)
        if simple is not None:
            found = _cheaper(found, replace(found, xi=simple), free, windows, limits)
    return found


def _cheaper(estimate: Estimate, simple: Estimate, free: Tensor, windows: Windows, limits: Limits) -> Estimate:
    """Return the simpler one of two estimates where what it loses is not worth a coefficient."""
    with suppress(RunsAway):
        simple, support = descend(simple, (simple.xi != 0) & free, windows, limits)
        flows = (Flow.of(e, Parameters.where((e.xi != 0) & free), windows) for e in (estimate, simple))
        (before, full), (after, _) = ((left_over(model, windows), model) for model in map(linearise, flows))
        if bool(support.any()) and 2 * (after - before) <= limits.at(full.errors, windows):
            return simple
    return estimate


def descend(estimate: Estimate, support: Tensor, windows: Windows, limits: Limits) -> tuple[Estimate, Tensor]:
    """Converge and drop until the support stands still; what turns out worth more than was foreseen comes back."""
    flow = _descended(Flow.of(estimate, Parameters.where(support), windows), limits)[0]
    return flow.estimate, flow.parameters.support(support.shape)


def _descended(flow: Flow, limits: Limits) -> tuple[Flow, Linearised | None]:
    """Return the trajectories after that, and the linear model there; none where no coefficient is left."""
    before: tuple[Flow, Linearised] | None = None
    model: Linearised | None = None
    left, allowed, enough, windows = math.inf, 0.0, ROUGH, flow.windows
    while len(flow.parameters):
        try:
            flow, model = settled(flow, limits.max_rounds, enough, model)
        except RunsAway:
            if before is None:
                raise
            return before
        cost = left_over(model, windows)
        if before is not None and 2 * (cost - left) > allowed:
            return settled(before[0], limits.max_rounds, SETTLED, before[1])
        limit, n_fixed = limits.at(model.errors, windows), len(model.scale) - len(flow.parameters)
        kept, _ = walk_down(model.triangle, torch.arange(len(model.scale)) >= n_fixed, limit, NOISY)
        if len(kept) == len(model.scale):
            if enough == SETTLED:
                break
            enough = SETTLED  # what may go is judged once more where the steps have come to their end
            continue
        changed = _changed(flow, model, kept)
        if changed is None:
            break
        before, left, allowed = (flow, model), cost, 2 * limit * (len(model.scale) - len(kept))
        flow, model = changed, None
    return flow, model


def _changed(flow: Flow, model: Linearised, kept: Tensor) -> Flow | None:
    """Return the trajectories with the kept unknowns alone; None where they run away however they are made.

    A whole step of the linear model comes first; where it is too long, what goes is only left out.
    """
    estimate, parameters = flow.estimate, flow.parameters
    n_fixed = len(model.scale) - len(parameters)
    chosen = parameters.take(kept[kept >= n_fixed] - n_fixed)
    whole, bare = move(flow, model, kept), 0 * parameters.read(estimate.xi)
    left_out = chosen.write(parameters.write(estimate.xi, bare), chosen.read(estimate.xi))
    chosen = Parameters.where(chosen.support(estimate.xi.shape))
    trials = (Flow.of(trial, chosen, flow.windows) for trial in (whole, replace(estimate, xi=left_out)))
    return next((trial for trial in trials if not (len(chosen) and bool(trial.lost().any()))), None)


def converge(
    estimate: Estimate, parameters: Parameters, windows: Windows, max_rounds: int, enough: float = SETTLED
) -> Estimate:
    """Make Levenberg-Marquardt steps until one gains less than a part of the cost, `enough`."""
    return settled(Flow.of(estimate, parameters, windows), max_rounds, enough)[0].estimate


def settled(
    flow: Flow, max_rounds: int, enough: float = SETTLED, model: Linearised | None = None
) -> tuple[Flow, Linearised]:
    """Return the trajectories after the steps of `converge`, and the linear model there.

    Args:
        flow: trajectories to begin with.
        max_rounds: limit on the steps.
        enough: part of the cost that a step gains, below which steps end.
        model: the linear model of `flow`, if it is known.
    """
    damping, parameters, windows = 0.0, flow.parameters, flow.windows
    model = model or linearise(flow)
    what = f"{len(parameters)} coefficients, by simulations of {len(windows) * windows.length} samples"
    for k in range(max_rounds):
        tell("fit", words=f"step {k + 1} of at most {max_rounds} for {what}")
        candidate = move(flow, model, torch.arange(len(model.scale)), damping)
        trial = Flow.of(candidate, parameters, windows)
        cost = cost_of(trial, model.sigma) if bool(trial.predicted.square().isfinite().all()) else math.inf
        lost = not cost < math.inf or (cost < model.cost and bool(trial.lost().any()))
        after = linearise(trial) if cost < model.cost and not lost else None
        if after is None or not bool(after.triangle.isfinite().all()):
            if damping > 1e6 or (not lost and abs(cost - model.cost) < 1e-6 * model.cost):
                break
            damping = max(10 * damping, 1e-3)
            continue
        gain = (model.cost - cost) / model.cost
        flow, model, damping = trial, after, damping / 10 if damping > 1e-6 else 0.0
        if gain < enough:
            break
    return flow, model
