"""Which functions a fit to trajectories needs: converge, drop, and let in what is worth more than it costs."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.told import tell
from dynasindy.world_models.refinement.plainer import plainer
from dynasindy.world_models.refinement.repeated import repetition
from dynasindy.world_models.refinement.shooting import Estimate, Flow, Linearised, RunsAway, left_over, linearise, move
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
    support = (estimate.xi != 0) & free
    came = failed = torch.zeros_like(free)
    best: tuple[Estimate, Tensor] | None = None
    least, fewest = math.inf, 0
    for _ in range(TRIES):
        try:
            estimate, support = descend(estimate, support, windows, limits)
        except RunsAway:
            if best is None:
                raise
            break
        if not bool(support.any()):
            break
        active = Parameters.where(support)
        flow = Flow.of(estimate, active, windows)
        model = linearise(estimate, active, windows, None, flow)
        limit, left = limits.at(model.errors, windows), left_over(model, windows)
        if best is not None and 2 * (left - least) + limit * (len(active) - fewest) >= 0:
            estimate, support = best
            if not bool((came & ~support & ~failed).any()):
                break  # it only left functions out, and would do so again
            failed = failed | (came & ~support)
            active = Parameters.where(support)
        else:
            best, least, fewest = (estimate, support), left, len(active)
        others = Parameters.where(free & ~support & ~failed)
        if not len(others):
            break
        tell("fit", words=f"which of {len(others)} terms that were left out should come in")
        flow = Flow.of(estimate, active + others, windows)
        model = linearise(estimate, active + others, windows, None, flow)
        n_fixed = len(model.scale) - len(active) - len(others)
        better = reconsider(model.triangle, n_fixed, active, others, limits.at(model.errors, windows))
        if better is None:
            break
        chosen = (active + others).take(better)
        kept = torch.cat([torch.arange(n_fixed), n_fixed + better])
        changed = _changed(estimate, model, active + others, kept, windows)
        if changed is None:
            break
        estimate, support = changed, chosen.support(support.shape)
        came = support
    found = estimate if best is None else best[0]
    for place in range(len(found.library.shapes)):
        simple = plainer(found.library, found.xi, free, place)
        if simple is not None:
            found = _cheaper(found, replace(found, xi=simple), free, windows, limits)
    return found


def _cheaper(estimate: Estimate, simple: Estimate, free: Tensor, windows: Windows, limits: Limits) -> Estimate:
    """Return the simpler one of two estimates where what it loses is not worth a coefficient."""
    with suppress(RunsAway):
        simple, support = descend(simple, (simple.xi != 0) & free, windows, limits)
        models = (linearise(e, Parameters.where((e.xi != 0) & free), windows) for e in (estimate, simple))
        (before, full), (after, _) = ((left_over(model, windows), model) for model in models)
        if bool(support.any()) and 2 * (after - before) <= limits.at(full.errors, windows):
            return simple
    return estimate


def descend(estimate: Estimate, support: Tensor, windows: Windows, limits: Limits) -> tuple[Estimate, Tensor]:
    """Converge and drop until the support stands still; what turns out worth more than was foreseen comes back."""
    before: tuple[Estimate, Tensor] | None = None
    left, allowed, enough = math.inf, 0.0, ROUGH
    while bool(support.any()):
        parameters = Parameters.where(support)
        try:
            estimate = converge(estimate, parameters, windows, limits.max_rounds, enough)
            flow = Flow.of(estimate, parameters, windows)
            model = linearise(estimate, parameters, windows, None, flow)
        except RunsAway:
            if before is None:
                raise
            return before
        cost = left_over(model, windows)
        if before is not None and 2 * (cost - left) > allowed:
            return converge(before[0], Parameters.where(before[1]), windows, limits.max_rounds), before[1]
        n_fixed = len(model.scale) - len(parameters)
        limit = limits.at(model.errors, windows)
        kept, _ = walk_down(model.triangle, torch.arange(len(model.scale)) >= n_fixed, limit, NOISY)
        if len(kept) == len(model.scale):
            if enough == SETTLED:
                break
            enough = SETTLED  # what may go is judged once more where the steps have come to their end
            continue
        changed = _changed(estimate, model, parameters, kept, windows)
        if changed is None:
            break
        before, left, allowed = (estimate, support), cost, 2 * limit * (len(model.scale) - len(kept))
        estimate, support = changed, parameters.take(kept[kept >= n_fixed] - n_fixed).support(support.shape)
    return estimate, support


def _changed(
    estimate: Estimate, model: Linearised, parameters: Parameters, kept: Tensor, windows: Windows
) -> Estimate | None:
    """Return the estimate with the kept unknowns alone; None where that runs away however it is made.

    A whole step of the linear model comes first; where it is too long, what goes is only left out.
    """
    n_fixed = len(model.scale) - len(parameters)
    chosen = parameters.take(kept[kept >= n_fixed] - n_fixed)
    if not len(chosen):
        return move(estimate, model, parameters, kept)
    bare = chosen.write(parameters.write(estimate.xi, 0 * parameters.read(estimate.xi)), chosen.read(estimate.xi))
    for trial in (move(estimate, model, parameters, kept), replace(estimate, xi=bare)):
        if not bool(Flow.of(trial, chosen, windows).lost().any()):
            return trial
    return None


def converge(
    estimate: Estimate, parameters: Parameters, windows: Windows, max_rounds: int, enough: float = SETTLED
) -> Estimate:
    """Make Levenberg-Marquardt steps until one gains less than a part of the cost, `enough`."""
    damping = 0.0
    model = linearise(estimate, parameters, windows)
    what = f"{len(parameters)} coefficients, by simulations of {len(windows) * windows.length} samples"
    for k in range(max_rounds):
        tell("fit", words=f"step {k + 1} of at most {max_rounds} for {what}")
        candidate = move(estimate, model, parameters, torch.arange(len(model.scale)), damping)
        flow = Flow.of(candidate, parameters, windows)
        lost = bool(flow.lost().any())
        trial = model if lost else linearise(candidate, parameters, windows, model.sigma, flow)
        if not (trial.cost < model.cost and bool(trial.triangle.isfinite().all())):
            if damping > 1e6 or (not lost and abs(trial.cost - model.cost) < 1e-6 * model.cost):
                break
            damping = max(10 * damping, 1e-3)
            continue
        gain = (model.cost - trial.cost) / model.cost
        estimate, damping = candidate, damping / 10 if damping > 1e-6 else 0.0
        model = linearise(estimate, parameters, windows, None, flow)
        if gain < enough:
            break
    return estimate
