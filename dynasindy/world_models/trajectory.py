"""Gauss-Newton on the error of whole trajectories, their start states estimated too: for data as sensors give them.

Noise in the states makes regression biased (errors in variables), and a state that no sensor sees cannot be put into
a function at all. Here the states are never put into the functions: the model's own trajectory is, from a start state
that is estimated with the coefficients, which is the maximum likelihood estimate for white measurement noise. The
trajectory is cut into windows whose start states are unknowns of their own, so that windows are integrated side by
side and a poor first model does not run away (multiple shooting, Bock 1981); in each step the conditions that windows
join are eliminated (condensing). Where windows are not joined, each begins at a state of its own: the error is then
that of a prediction over one window, which random pushes on the plant spoil less.

| name     | meaning                                             | shape      |
| -------- | --------------------------------------------------- | ---------- |
| nodes    | start states of the windows                         | `(W, n_x)` |
| shapes   | numbers inside the fitted factors of the library    | `(S,)`     |
| fixed    | unknowns that always stay: first nodes and shapes   | F of them  |
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.library import Library
from dynasindy.world_models.selection import reconsider, walk_down
from dynasindy.world_models.sensitivity import Parameters, Propagator
from dynasindy.world_models.windows import Windows

EXACT = 1e-100
"""Error taken for that of a state that is met exactly, as one that never moves; its inverse has a finite square."""
NOISY = 1e-7
"""Part of a coefficient's effect that those of others leave over, below which data cannot tell it from them."""
FINE, STABLE, MOST_STEPS = 0.1, 1.5, 10
"""Runge-Kutta step times the fastest rate of the model: for an error of 1e-7, and the most that is stable; and how many
steps of an interval the first may ask for."""


class RunsAway(ValueError):
    """A model leaves all bounds within the shortest of windows."""


@dataclass
class Estimate:
    """Hold the unknowns of a fit to trajectories: the library with its shapes, Xi, and the nodes."""

    library: Library
    xi: Tensor
    nodes: Tensor


@dataclass(frozen=True)
class Flow:
    """Hold the trajectories of all windows and their sensitivities.

    Attributes:
        predicted: states at the ends of the intervals, `(W, L, n_x)`.
        s: their derivatives by the window's start, the shapes and the coefficients, `(W, L, n_x, n_x + S + P)`.
    """

    predicted: Tensor
    s: Tensor

    @classmethod
    def of(cls, estimate: Estimate, parameters: Parameters, windows: Windows) -> Flow:
        """Integrate all windows."""
        propagator = Propagator(estimate.library, estimate.xi, parameters, estimate.library.shapes)
        x, s = estimate.nodes, propagator.start(len(estimate.nodes))
        states, slopes = [], []
        for u in windows.inputs.unbind(1):
            x, s = propagator.advance(x, s, u, windows.dt, windows.substeps)
            states.append(x)
            slopes.append(s)
        return cls(torch.stack(states, 1), torch.stack(slopes, 1))

    def lost(self) -> Tensor:
        """Return which windows the model runs away in, bool `(W,)`."""
        finite = self.predicted.square().isfinite().all(-1) & self.s.square().isfinite().all(-1).all(-1)
        return ~finite.all(-1)

    def sigma(self, windows: Windows) -> Tensor:
        """Return the error of each state, `(n_x,)`; `EXACT` where none was measured."""
        error = (windows.measured - self.predicted) * windows.mask
        return (error.square().sum((0, 1)) / windows.mask.sum((0, 1)).clamp_min(1)).sqrt().clamp_min(EXACT)


@dataclass(frozen=True)
class Linearised:
    """Hold the condensed linear model at an estimate.

    Attributes:
        triangle: R of [fixed unknowns, coefficients, target], all weighted and scaled.
        scale: norms of the columns.
        cost: sum of squared errors and of squared gaps between windows, both weighted.
        moves: how the node of each window moves with the unknowns, `(W, n_x, F + P + 1)`.
        sigma: error of each state, `(n_x,)`.
    """

    triangle: Tensor
    scale: Tensor
    cost: float
    moves: Tensor
    sigma: Tensor


def linearise(
    estimate: Estimate, parameters: Parameters, windows: Windows, sigma: Tensor | None = None, flow: Flow | None = None
) -> Linearised:
    """Integrate all windows with sensitivities and eliminate the nodes that continue a window.

    Args:
        estimate: coefficients and nodes.
        parameters: coefficients to differentiate by, P of them.
        windows: the recording.
        sigma: error of each state, the weights; from the errors themselves if omitted.
        flow: what was integrated already.

    Raises:
        RunsAway: without `sigma`, so at an estimate that is no trial, the model runs away within a window.
    """
    flow = flow or Flow.of(estimate, parameters, windows)
    if sigma is None:
        _require_bounded(flow, windows)
        sigma = flow.sigma(windows)
    error = (windows.measured - flow.predicted) * windows.mask
    begun = ~windows.joined
    start_error = (windows.first - estimate.nodes)[begun]
    moves, gaps = _condense(estimate.nodes, flow, windows, len(parameters))
    n_x, n_fixed = estimate.xi.shape[1], moves.shape[-1] - len(parameters) - 1
    # error - d predicted: the node's move, then shapes and coefficients.
    columns = flow.s[..., :n_x] @ moves.unsqueeze(1)
    n_own = flow.s.shape[-1] - n_x
    columns[..., -1 - n_own : -1] += flow.s[..., n_x:]
    columns[..., -1] = error - columns[..., -1]
    columns = columns * (windows.mask / sigma).unsqueeze(-1)
    starts = moves[begun].clone()
    starts[..., -1] = start_error
    starts = torch.where(start_error.isnan().unsqueeze(-1), 0.0, starts / sigma.unsqueeze(-1))
    rows = torch.cat([columns.reshape(-1, columns.shape[-1]), starts.reshape(-1, columns.shape[-1])])
    scale = rows[:, :-1].norm(dim=0).clamp_min(1e-300)
    target = rows[:, -1:] + rows[:, n_fixed:-1] @ parameters.read(estimate.xi).unsqueeze(-1)
    triangle = torch.linalg.qr(torch.cat([rows[:, :-1] / scale, target], -1), mode="r")[1]
    # A gap shifts all samples that follow, so closing it is worth more than the errors it hid.
    gap_weight = 10.0 * windows.mask.shape[1]
    weighted = (
        (1.0, error / sigma),
        (1.0, start_error.nan_to_num() / sigma),
        (gap_weight, gaps / _gap_sigma(sigma, estimate)),
    )
    cost = float(sum((w * e.square().sum() for w, e in weighted), torch.zeros(())))
    return Linearised(triangle, scale, cost, moves, sigma)


def _gap_sigma(sigma: Tensor, estimate: Estimate) -> Tensor:
    """Return what a gap of each state is weighed against; of one that no sensor sees, by the errors of the others."""
    spread = estimate.nodes.std(0, correction=0).clamp_min(1e-12)
    seen = sigma > EXACT
    relative = (sigma / spread)[seen].median() if bool(seen.any()) else torch.ones(())
    return torch.where(seen, sigma, relative * spread).clamp_min(EXACT)


def _require_bounded(flow: Flow, windows: Windows) -> None:
    if bool((lost := flow.lost()).any()):
        raise RunsAway(
            f"refinement.method=trajectory: the model runs away in {int(lost.sum())} of {len(lost)} windows of "
            f"{windows.mask.shape[1]} samples, the first of them number {int(lost.nonzero()[0])}; look for outliers "
            "there, lower refinement.window, or choose another refinement.method"
        )


def _condense(nodes: Tensor, flow: Flow, windows: Windows, n_p: int) -> tuple[Tensor, Tensor]:
    """Express the move of every node by the moves of the first nodes, of the shapes and of the coefficients.

    A window that continues another one starts where that one ends:
    d node_j = gap_j + A d node_(j-1) + B d (shapes, xi), A and B the sensitivities at the end of window j - 1.
    """
    n_x, s = nodes.shape[1], flow.s
    n_own, n_start = s.shape[-1] - n_x, n_x * int((~windows.joined).sum())
    moves = torch.zeros(len(nodes), n_x, n_start + n_own + 1, dtype=nodes.dtype)
    gaps = torch.zeros_like(nodes)
    seen = 0
    for j, joined in enumerate(windows.joined.tolist()):
        if joined:
            moves[j] = s[j - 1, -1, :, :n_x] @ moves[j - 1]
            moves[j, :, n_start : n_start + n_own] += s[j - 1, -1, :, n_x:]
            gaps[j] = flow.predicted[j - 1, -1] - nodes[j]
            moves[j, :, -1] += gaps[j]
        else:
            moves[j, :, seen : seen + n_x] = torch.eye(n_x, dtype=nodes.dtype)
            seen += n_x
    return moves, gaps


def refine_trajectory(
    library: Library,
    xi: Tensor,
    free: Tensor,
    data: Transitions,
    window: int,
    max_rounds: int = 30,
    start: Tensor | None = None,
    joined: bool = True,
) -> tuple[Library, Tensor]:
    """Minimise the error of whole trajectories over coefficients and start states; drop what does not matter.

    Args:
        library: candidate functions.
        xi: first estimate, `(n_features, n_x)`.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: transitions in segments that are long against the window, NaN where a state was not measured.
        window: sampling intervals in a window; fewer to begin with where the first estimate runs away.
        max_rounds: limit on Gauss-Newton steps.
        start: guess of the states before each transition, `(N, n_x)`; the measured ones if omitted.
        joined: whether the windows join to one trajectory.

    Returns:
        The library with its shapes, and coefficients, `(n_features, n_x)`.

    Raises:
        RunsAway: the model runs away within the shortest of windows.
    """
    data, limit = data.to(torch.float64), math.log(max(len(data), 2))
    guess = data.x if start is None else start.to(torch.float64)
    support = (xi != 0) & free
    start_at = Estimate(library, xi, guess)
    estimate, windows = _grown(start_at, support, data, (window, joined, max_rounds))
    for _ in range(6):
        estimate, support = _descend(estimate, support, windows, (limit, max_rounds))
        active, others = Parameters.where(support), Parameters.where(free & ~support)
        if not len(active) or not len(others):
            break
        model = linearise(estimate, active + others, windows)
        n_fixed = len(model.scale) - len(active) - len(others)
        better = reconsider(model.triangle, n_fixed, active, others, limit)
        if better is None:
            break
        chosen = (active + others).take(better)
        changed = _changed(
            estimate, model, active + others, torch.cat([torch.arange(n_fixed), n_fixed + better]), windows
        )
        if changed is None:
            break
        estimate, support = changed, chosen.support(support.shape)
    return estimate.library, estimate.xi


def trajectory_cost(
    library: Library,
    xi: Tensor,
    free: Tensor,
    data: Transitions,
    window: int,
    rounds: int,
    start: Tensor,
    joined: bool = True,
) -> float:
    """Return N/2 times the logarithm of the squared errors that a few steps leave over, summed over measured states.

    Args:
        library: candidate functions.
        xi: first estimate, `(n_features, n_x)`; its support stays.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: the recording.
        window: sampling intervals in a window.
        rounds: Gauss-Newton steps.
        start: guess of the states before each transition, `(N, n_x)`.
        joined: whether the windows join to one trajectory.
    """
    support, data = (xi != 0) & free, data.to(torch.float64)
    estimate, windows = _grown(Estimate(library, xi, start), support, data, (window, joined, rounds))
    parameters = Parameters.where(support)
    estimate = _converge(estimate, parameters, windows, rounds)
    sigma = Flow.of(estimate, parameters, windows).sigma(windows)
    counts, seen = windows.mask.sum((0, 1)), sigma > EXACT
    return float((counts * sigma.log())[seen].sum())


def substeps_for(library: Library, xi: Tensor, x: Tensor, u: Tensor, dt: float) -> int:
    """Return into how many Runge-Kutta steps an interval is divided, by the fastest rate of a model.

    Args:
        library: candidate functions.
        xi: coefficients, `(n_features, n_x)`.
        x: states that occur, `(N, n_x)`.
        u: inputs there, `(N, n_u)`.
        dt: length of an interval [s].
    """
    slopes = Propagator(library, xi, Parameters.where(xi != 0)).slopes_by_state(x, u)
    rates = torch.linalg.eigvals(slopes[slopes.isfinite().all(-1).all(-1)]).abs().amax(-1)
    if not len(rates):
        return 1
    turn = dt * float(torch.quantile(rates[-100_000:], 0.999))
    return max(1, min(math.ceil(turn / FINE - 1e-6), MOST_STEPS), min(math.ceil(turn / STABLE), 10 * MOST_STEPS))


def _grown(
    estimate: Estimate, support: Tensor, data: Transitions, limits: tuple[int, bool, int]
) -> tuple[Estimate, Windows]:
    """Return windows of the wanted length, and an estimate that does not run away in them.

    Args:
        estimate: first estimate; its nodes are a guess of the states before each transition, `(N, n_x)`.
        support: coefficients in the model.
        data: the recording.
        limits: wanted length, whether the windows join, and the limit on Gauss-Newton steps of each length.
    """
    window, joined, max_rounds = limits
    substeps = substeps_for(estimate.library, estimate.xi, estimate.nodes, data.u, data.dt)
    parameters, guess = Parameters.where(support), estimate.nodes
    lengths = [window]
    while True:
        windows = Windows.of(data, lengths[0], joined, substeps)
        trial = replace(estimate, nodes=guess[windows.rows])
        if lengths[0] <= 2 or not bool(Flow.of(trial, parameters, windows).lost().any()):
            break
        lengths.insert(0, max(2, lengths[0] // 4))
    for length in lengths[1:]:
        trial = _converge(trial, parameters, windows, max_rounds)
        guess = guess.index_copy(0, windows.rows, trial.nodes)
        windows = Windows.of(data, length, joined, substeps)
        trial = replace(trial, nodes=guess[windows.rows])
    return trial, windows


def _descend(
    estimate: Estimate, support: Tensor, windows: Windows, limits: tuple[float, int]
) -> tuple[Estimate, Tensor]:
    """Converge and drop until the support stands still."""
    while bool(support.any()):
        parameters = Parameters.where(support)
        estimate = _converge(estimate, parameters, windows, limits[1])
        model = linearise(estimate, parameters, windows)
        n_fixed = len(model.scale) - len(parameters)
        kept, _ = walk_down(model.triangle, torch.arange(len(model.scale)) >= n_fixed, limits[0], NOISY)
        if len(kept) == len(model.scale):
            break
        changed = _changed(estimate, model, parameters, kept, windows)
        if changed is None:
            break
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
        return _move(estimate, model, parameters, kept)
    bare = chosen.write(parameters.write(estimate.xi, 0 * parameters.read(estimate.xi)), chosen.read(estimate.xi))
    for trial in (_move(estimate, model, parameters, kept), replace(estimate, xi=bare)):
        if not bool(Flow.of(trial, chosen, windows).lost().any()):
            return trial
    return None


def _converge(estimate: Estimate, parameters: Parameters, windows: Windows, max_rounds: int) -> Estimate:
    """Make Levenberg-Marquardt steps until the cost stands still."""
    damping = 0.0
    model = linearise(estimate, parameters, windows)
    for _ in range(max_rounds):
        candidate = _move(estimate, model, parameters, torch.arange(len(model.scale)), damping)
        flow = Flow.of(candidate, parameters, windows)
        trial = linearise(candidate, parameters, windows, model.sigma, flow)
        if not (trial.cost < model.cost and bool(trial.triangle.isfinite().all())):
            if damping > 1e6 or abs(trial.cost - model.cost) < 1e-6 * model.cost:
                break
            damping = max(10 * damping, 1e-3)
            continue
        gain = (model.cost - trial.cost) / model.cost
        estimate, damping = candidate, damping / 10 if damping > 1e-6 else 0.0
        model = linearise(estimate, parameters, windows, None, flow)
        if gain < 1e-5:
            break
    return estimate


def _move(
    estimate: Estimate, model: Linearised, parameters: Parameters, kept: Tensor | Sequence[int], damping: float = 0.0
) -> Estimate:
    """Solve the linear model over the kept unknowns and move coefficients, shapes and nodes accordingly."""
    kept = torch.as_tensor(kept)
    square, n_fixed = model.triangle[:, kept], len(model.scale) - len(parameters)
    old = torch.cat([torch.zeros(n_fixed), parameters.read(estimate.xi)]) * model.scale
    target = model.triangle[:, -1]
    if damping:
        square = torch.cat([square, damping**0.5 * torch.eye(len(kept), dtype=square.dtype)])
        target = torch.cat([target, damping**0.5 * old[kept]])
    solution = torch.linalg.lstsq(square, target.unsqueeze(-1), driver="gelsd").solution.squeeze(-1)
    values = torch.zeros_like(old).index_copy(0, kept, solution) / model.scale
    step = values.clone()
    step[n_fixed:] -= parameters.read(estimate.xi)
    nodes = estimate.nodes + model.moves[..., :-1] @ step + model.moves[..., -1]
    library, shapes = estimate.library, estimate.library.shapes
    if shapes:
        numbers = step[n_fixed - len(shapes) : n_fixed].tolist()
        library = library.with_shapes([shape.frequency + by for shape, by in zip(shapes, numbers, strict=True)])
    return Estimate(library, parameters.write(estimate.xi, values[n_fixed:]), nodes)
