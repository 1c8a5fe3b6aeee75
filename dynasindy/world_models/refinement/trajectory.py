"""Gauss-Newton on the error of whole trajectories, their start states estimated too: for data as sensors give them.

Noise in the states makes regression biased (errors in variables), and a state that no sensor sees cannot be put into
a function at all. Here the states are never put into the functions: the model's own trajectory is, from a start state
that is estimated with the coefficients, which is the maximum likelihood estimate for white measurement noise. The
trajectory is cut into windows whose start states are unknowns of their own, so that windows are integrated side by
side and a poor first model does not run away (multiple shooting, Bock 1981); in each step the conditions that windows
join are eliminated (condensing). Where windows are not joined, each begins at a state of its own: the error is then
that of a prediction over one window, which random pushes on the plant spoil less.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.libraries.library import Library
from dynasindy.world_models.refinement.choosing import Limits, converge, descend, price, search, settled
from dynasindy.world_models.refinement.descent import Descent
from dynasindy.world_models.refinement.flow import COARSE, EXACT, FINE, Estimate, Flow, growth, substeps_for, turn_of
from dynasindy.world_models.refinement.shooting import lasting_of, left_over, noise_of
from dynasindy.world_models.refinement.windows import ENOUGH, Windows, spread
from dynasindy.world_models.regression.prior import likely
from dynasindy.world_models.regression.sensitivity import Parameters

GROWN = 100.0
"""Factor by which errors grow along a trajectory, beyond which functions are chosen on windows on their own."""
FARTHEST = 1e6
"""The same, beyond which a trajectory begins anew: the effects of all coefficients look alike after such a growth."""
WORSE = 1.2
"""Factor on the errors of windows on their own, beyond which a trajectory through all of them does not fit."""
TURNS = 4
"""Turns at most in which the model, and the sizes of pushes and noise, are estimated."""
SETTLED = 1e-3
"""Part of a coefficient by which it may still change in the last of these turns."""
SHORTEST = 2
"""Sampling intervals in the shortest window."""
LEAPS = (4, 2)
"""Factors by which windows grow, the larger one where the model does not run away in windows as long as that."""
NEGLIGIBLE = 1e-6
"""Part of the spread of a state below which its error is of the arithmetic, and tells nothing of the plant."""


class Fitted(NamedTuple):
    """Hold the library with its shapes, coefficients `(n_features, n_x)`, the length of the windows, and their flow."""

    library: Library
    coefficients: Tensor
    window: int
    flow: Flow

    @classmethod
    def of(cls, found: Estimate, free: Tensor, windows: Windows) -> Fitted:
        """Return what was found in windows, with their trajectories."""
        flow = Flow.of(found, Parameters.where((found.xi != 0) & free), windows)
        return cls(found.library, found.xi, windows.length, flow)


def refine_trajectory(
    library: Library,
    xi: Tensor,
    free: Tensor,
    data: Transitions,
    descent: Descent,
    start: Tensor | None = None,
) -> Fitted:
    """Minimise the error of whole trajectories over coefficients and start states; drop what does not matter.

    Args:
        library: candidate functions.
        xi: first estimate, `(n_features, n_x)`.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: transitions in segments that are long against the window, NaN where a state was not measured.
        descent: how they are fitted.
        start: guess of the states before each transition, `(N, n_x)`; the measured ones if omitted.

    Raises:
        RunsAway: the model runs away within the shortest of windows.
    """
    data = data.to(torch.float64)
    guess = data.x if start is None else start.to(torch.float64)
    joined = descent.joined
    some = spread(len(data), ENOUGH)
    part, limits = data.select(some), Limits(price(int(some.sum()), free), descent.max_rounds, descent.correlated)
    weighed = descent.pushed or descent.coloured
    first = Estimate(library, xi, guess[some])
    found, windows = _grown(first, (xi != 0) & free, part, descent, FINE if weighed else COARSE)
    if weighed:
        return _refine_weighed(found, free, windows, (data, guess), limits, descent)
    may_begin_anew = joined is None
    # Windows on their own tell little of a state that was not measured: then they begin anew where they have to.
    seen = not bool(data.x_next.isnan().any())
    if may_begin_anew and not seen:
        windows = replace(windows, joined=_grows(found, windows)[1])
    if may_begin_anew and seen and _grows(found, windows)[0] > GROWN:
        alone = replace(windows, joined=torch.zeros_like(windows.joined))
        own = search(found, free, alone, limits)
        windows = replace(windows, joined=_grows(own, windows)[1])
        found = search(own, free, windows, limits)
        if not bool((_sigma(found, windows) < WORSE * _sigma(own, alone)).all()):
            found, joined, may_begin_anew = own, False, False
    else:
        found = search(found, free, windows, limits)
    if bool(some.all()):
        found, windows = _finely(found, free, windows, limits)
    else:
        support = (found.xi != 0) & free
        whole, windows = _grown(replace(found, nodes=guess), support, data, replace(descent, joined=joined))
        if may_begin_anew:
            windows = replace(windows, joined=_grows(whole, windows)[1])
        found, _ = descend(whole, support, windows, replace(limits, price=price(len(data), free)))
    return Fitted.of(found, free, windows)


def _finely(found: Estimate, free: Tensor, windows: Windows, limits: Limits) -> tuple[Estimate, Windows]:
    """Return an estimate by the steps that its fastest rate asks for, where it was found by longer ones."""
    support = (found.xi != 0) & free
    if not bool(support.any()):
        return found, windows
    wanted = substeps_for(turn_of(found.library, found.xi, found.nodes, windows.inputs[:, 0], windows.dt))
    if wanted <= windows.substeps:
        return found, windows
    windows = replace(windows, substeps=wanted)
    return descend(found, support, windows, limits)[0], windows


def _refine_weighed(
    found: Estimate, free: Tensor, windows: Windows, whole: tuple[Transitions, Tensor], limits: Limits, descent: Descent
) -> Fitted:
    """Minimise errors made white, and what makes them so in turn with it: pushes and noise, or how long errors last."""
    data, guess = whole
    if descent.coloured:  # errors of a first guess last whatever the plant does
        found = search(found, free, windows, limits)
    for _ in range(TURNS):
        windows = _weighed(found, free, windows, descent)
        last, found = found, search(found, free, windows, limits)
        if bool(((found.xi != 0) == (last.xi != 0)).all()) and bool(
            ((found.xi - last.xi).abs() <= SETTLED * found.xi.abs()).all()
        ):
            break
    if len(data) > ENOUGH:
        support = (found.xi != 0) & free
        found, windows = _grown(replace(found, nodes=guess), support, data, descent)
        windows = _weighed(found, free, windows, descent)
        found, _ = descend(found, support, windows, replace(limits, price=price(len(data), free)))
    return Fitted.of(found, free, windows)


def _weighed(found: Estimate, free: Tensor, windows: Windows, descent: Descent) -> Windows:
    """Return the recording with what makes the errors of an estimate white."""
    if descent.pushed:
        return replace(windows, noise=noise_of(found, windows, free.any(0)))
    return replace(windows, lasting=lasting_of(found, windows))


def _grows(estimate: Estimate, windows: Windows) -> tuple[float, Tensor]:
    """Return how much small errors grow, and which windows join if they may not grow beyond all measure."""
    return growth(Flow.of(estimate, Parameters.where(estimate.xi != 0), windows), FARTHEST)


def _sigma(estimate: Estimate, windows: Windows) -> Tensor:
    """Return the error of each state; infinite where no coefficient is left."""
    if not bool(estimate.xi.any()):
        return torch.full((estimate.xi.shape[1],), math.inf)
    return Flow.of(estimate, Parameters.where(estimate.xi != 0), windows).sigma()


def few_steps(
    library: Library, xi: Tensor, free: Tensor, data: Transitions, descent: Descent, start: Tensor
) -> tuple[float, Estimate, Tensor | None]:
    """Return N/2 log of the squared errors that a few steps leave, summed, their estimate, and errors by window.

    There are no errors by window, `(W, n_x)`, where the model runs away in windows of the wanted length.

    Args:
        library: candidate functions.
        xi: first estimate, `(n_features, n_x)`; its support stays.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: the recording.
        descent: how many steps, over which windows.
        start: guess of the states before each transition, `(N, n_x)`.
    """
    some = spread(len(data), ENOUGH)
    support, data = (xi != 0) & free, data.to(torch.float64).select(some)
    estimate, windows = _grown(Estimate(library, xi, start[some]), support, data, descent, COARSE)
    flow, model = settled(Flow.of(estimate, Parameters.where(support), windows), descent.max_rounds)
    errors = (model.errors * model.sigma).square().sum(1) if windows.length == descent.window else None
    return left_over(model, windows), flow.estimate, errors


def strain(library: Library, xi: Tensor, free: Tensor, data: Transitions, descent: Descent, start: Tensor) -> Tensor:
    """Return how many times the error of windows on their own a trajectory has, `(n_x,)`; 0 of unmeasured states.

    With noise of the sensors alone it is 1, but for the start states of windows on their own, which fit a part of the
    noise and are allowed for. Where something pushes the plant, or functions are missing, a trajectory strays; it is
    infinite where no function is left.

    Args:
        library: candidate functions.
        xi: what was found, `(n_features, n_x)`; its support stays.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: the recording, NaN where a state was not measured.
        descent: how many steps, over which windows.
        start: guess of the states before each transition, `(N, n_x)`.
    """
    some = spread(len(data), ENOUGH)
    support, data = (xi != 0) & free, data.to(torch.float64).select(some)
    if not bool(support.any()):
        return torch.full(xi.shape[1:], math.inf, dtype=torch.float64)
    first, windows = _grown(Estimate(library, xi, start[some]), support, data, replace(descent, joined=None), COARSE)
    if not bool(data.x_next.isnan().any()):
        windows = replace(windows, joined=_grows(first, windows)[1])
    alone, parameters = replace(windows, joined=torch.zeros_like(windows.joined)), Parameters.where(support)
    ends = (settled(Flow.of(first, parameters, part), descent.max_rounds)[0] for part in (windows, alone))
    error, own = (end.sigma() for end in ends)
    told = float(windows.mask.sum() + (~windows.first.isnan()).sum())
    allowed = math.sqrt(max(1 - first.nodes.numel() / max(told, 1.0), NEGLIGIBLE))
    floor = NEGLIGIBLE * first.nodes.std(0, correction=0) + EXACT
    return torch.where(error > EXACT, (error + floor) / (own / allowed + floor), 0.0)


def _grown(
    estimate: Estimate, support: Tensor, data: Transitions, descent: Descent, turned: float = FINE
) -> tuple[Estimate, Windows]:
    """Return windows of the wanted length, or as long as there are, and an estimate that does not run away in them.

    Args:
        estimate: first estimate; its nodes are a guess of the states before each transition, `(N, n_x)`.
        support: coefficients in the model.
        data: the recording.
        descent: wanted length, whether the windows join, and the limit on the steps of each length.
        turned: Runge-Kutta step times the fastest rate of the model.
    """
    turn = turn_of(estimate.library, estimate.xi, estimate.nodes, data.u, data.dt)
    substeps, parameters = substeps_for(turn, turned), Parameters.where(support)
    guess, length = estimate.nodes, descent.window
    prior = likely(estimate.library, estimate.xi, guess, data, length)

    def _cut(found: Estimate, length: int) -> tuple[Estimate, Windows, bool]:
        windows = replace(Windows.of(data, length, descent.joins, substeps), likely=prior)
        trial = replace(found, nodes=guess[windows.rows])
        return trial, windows, bool(Flow.of(trial, parameters, windows).lost().any())

    trial, windows, lost = _cut(estimate, length)
    while lost and length > SHORTEST:
        length = max(SHORTEST, length // LEAPS[0])
        trial, windows, lost = _cut(estimate, length)
    while length < descent.window:
        trial = converge(trial, parameters, windows, descent.max_rounds)
        guess = guess.index_copy(0, windows.rows, trial.nodes)
        longer = [min(leap * length, descent.window) for leap in LEAPS]
        cuts = ((*_cut(trial, wanted), wanted) for wanted in dict.fromkeys(longer))
        found = next((cut for cut in cuts if not cut[2]), None)
        if found is None:
            break  # a model that runs away in longer windows is fitted to these
        trial, windows, _, length = found
    return trial, windows
