"""Gauss-Newton on the error of whole trajectories, their start states estimated too: for data with noise.

Noise in the states makes regression biased (errors in variables). Here the states are never put into the functions:
the model's own trajectory is, from a start state that is estimated with the coefficients, which is the maximum
likelihood estimate for white measurement noise. The trajectory is cut into windows whose start states are unknowns
of their own, so that windows are integrated side by side and a poor first model does not run away (multiple
shooting, Bock 1981); in each step the conditions that windows join are eliminated (condensing).

| name    | meaning                                                     | shape                    |
| ------- | ----------------------------------------------------------- | ------------------------ |
| nodes   | start states of the windows                                 | `(W, n_x)`               |
| measured| states at the ends of the sampling intervals                | `(W, L, n_x)`            |
| mask    | 1 where an interval belongs to the recording                | `(W, L)`                 |
| joined  | whether a window continues the one before                    | bool `(W,)`              |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.library import Library
from dynasindy.world_models.selection import reconsider, walk_down
from dynasindy.world_models.sensitivity import Parameters, Propagator

EXACT = 1e-100
"""Error taken for that of a state that is met exactly, as one that never moves; its inverse has a finite square."""


@dataclass(frozen=True)
class Windows:
    """Hold a recording cut into windows of L sampling intervals; shapes are in the table above."""

    first: Tensor
    inputs: Tensor
    measured: Tensor
    mask: Tensor
    joined: Tensor
    dt: float

    @classmethod
    def of(cls, data: Transitions, length: int) -> Windows:
        """Cut every segment of a recording into windows of `length` intervals; the last one may be shorter."""
        first, inputs, measured, mask, joined = [], [], [], [], []
        for segment in data.segment.unique().tolist():
            rows = (data.segment == segment).nonzero().flatten()
            for k, part in enumerate(rows.split(length)):
                pad = torch.cat([part, part[-1:].expand(length - len(part))])
                first.append(data.x[part[0]])
                inputs.append(data.u[pad])
                measured.append(data.x_next[pad])
                mask.append((torch.arange(length) < len(part)).to(torch.float64))
                joined.append(k > 0)
        return cls(
            *(torch.stack(first), torch.stack(inputs), torch.stack(measured), torch.stack(mask)),
            joined=torch.tensor(joined),
            dt=data.dt,
        )


@dataclass
class Estimate:
    """Hold the unknowns of a fit to trajectories."""

    xi: Tensor
    nodes: Tensor


@dataclass(frozen=True)
class Linearised:
    """Hold the condensed linear model at an estimate.

    Attributes:
        triangle: R of [start states, coefficients, target], all weighted and scaled.
        scale: norms of the columns.
        cost: sum of squared errors and of squared gaps between windows, both weighted.
        moves: how the node of each window moves with the unknowns, `(W, n_x, n_start + P + 1)`.
        sigma: error of each state, `(n_x,)`.
    """

    triangle: Tensor
    scale: Tensor
    cost: float
    moves: Tensor
    sigma: Tensor


def linearise(
    library: Library, estimate: Estimate, parameters: Parameters, windows: Windows, sigma: Tensor | None
) -> Linearised:
    """Integrate all windows with sensitivities and eliminate the nodes that continue a window.

    Args:
        library: candidate functions.
        estimate: coefficients and nodes.
        parameters: coefficients to differentiate by, P of them.
        windows: the recording.
        sigma: error of each state, the weights; from the errors themselves if omitted.

    Raises:
        ValueError: without `sigma`, so at an estimate that is no trial, the model runs away within a window.
    """
    predicted, s = _integrate(library, estimate, parameters, windows)
    lost = ~(predicted.square().isfinite().all(-1) & s.square().isfinite().all(-1).all(-1)).all(-1)
    if sigma is None and bool(lost.any()):
        length = windows.mask.shape[1]
        raise ValueError(
            f"refinement.method=trajectory: the model runs away in {int(lost.sum())} of {len(lost)} windows of "
            f"{length} samples, the first of them number {int(lost.nonzero()[0])}; look for outliers there, lower "
            "refinement.window, or choose another refinement.method"
        )
    n_x, n_p = estimate.xi.shape[1], len(parameters)
    error = (windows.measured - predicted) * windows.mask.unsqueeze(-1)
    start_error = windows.first - estimate.nodes
    if sigma is None:
        sigma = (error.square().sum((0, 1)) / windows.mask.sum()).sqrt().clamp_min(EXACT)
    moves, gaps = _condense(estimate.nodes, predicted, s, windows)
    n_start = moves.shape[-1] - n_p - 1
    # error - d predicted: the node's move, then the coefficients.
    columns = s[..., :n_x] @ moves.unsqueeze(1)
    columns[..., n_start : n_start + n_p] += s[..., n_x:]
    columns[..., -1] = error - columns[..., -1]
    columns = columns * (windows.mask.unsqueeze(-1) / sigma).unsqueeze(-1)
    starts = moves[~windows.joined].clone()
    starts[..., -1] = start_error[~windows.joined]
    rows = torch.cat(
        [columns.reshape(-1, columns.shape[-1]), (starts / sigma.unsqueeze(-1)).reshape(-1, columns.shape[-1])]
    )
    scale = rows[:, :-1].norm(dim=0).clamp_min(1e-300)
    target = rows[:, -1:] + rows[:, n_start:-1] @ parameters.read(estimate.xi).unsqueeze(-1)
    triangle = torch.linalg.qr(torch.cat([rows[:, :-1] / scale, target], -1), mode="r")[1]
    # A gap shifts all samples that follow, so closing it is worth more than the errors it hid.
    gap_weight = 10.0 * windows.mask.shape[1]
    starts_off = start_error[~windows.joined]
    cost = float(
        sum((w * (e / sigma).square().sum() for w, e in ((1.0, error), (1.0, starts_off), (gap_weight, gaps))))
    )
    return Linearised(triangle, scale, cost, moves, sigma)


def _integrate(library: Library, estimate: Estimate, parameters: Parameters, windows: Windows) -> tuple[Tensor, Tensor]:
    propagator = Propagator(library, estimate.xi, parameters)
    x, s = estimate.nodes, propagator.start(len(estimate.nodes))
    states, slopes = [], []
    for u in windows.inputs.unbind(1):
        x, s = propagator.advance(x, s, u, windows.dt, max(1, math.ceil(windows.dt / 0.01 - 1e-9)))
        states.append(x)
        slopes.append(s)
    return torch.stack(states, 1), torch.stack(slopes, 1)


def _condense(nodes: Tensor, predicted: Tensor, s: Tensor, windows: Windows) -> tuple[Tensor, Tensor]:
    """Express the move of every node by the moves of the first nodes and of the coefficients.

    A window that continues another one starts where that one ends:
    d node_j = gap_j + A d node_(j-1) + B d xi, A and B the sensitivities at the end of window j - 1.
    """
    n_x, n_p = nodes.shape[1], s.shape[-1] - nodes.shape[1]
    n_start = n_x * int((~windows.joined).sum())
    moves = torch.zeros(len(nodes), n_x, n_start + n_p + 1, dtype=nodes.dtype)
    gaps = torch.zeros_like(nodes)
    seen = 0
    for j, joined in enumerate(windows.joined.tolist()):
        if joined:
            moves[j] = s[j - 1, -1, :, :n_x] @ moves[j - 1]
            moves[j, :, n_start : n_start + n_p] += s[j - 1, -1, :, n_x:]
            gaps[j] = predicted[j - 1, -1] - nodes[j]
            moves[j, :, -1] += gaps[j]
        else:
            moves[j, :, seen : seen + n_x] = torch.eye(n_x, dtype=nodes.dtype)
            seen += n_x
    return moves, gaps


def refine_trajectory(
    library: Library, xi: Tensor, free: Tensor, data: Transitions, window: int, max_rounds: int = 30
) -> Tensor:
    """Minimise the error of whole trajectories over coefficients and start states; drop what does not matter.

    Args:
        library: candidate functions.
        xi: first estimate, `(n_features, n_x)`.
        free: coefficients that may be estimated, bool `(n_features, n_x)`.
        data: transitions in segments that are long against the window.
        window: sampling intervals in a window.
        max_rounds: limit on Gauss-Newton steps.

    Returns:
        Coefficients, `(n_features, n_x)`.

    Raises:
        ValueError: the model runs away within a window.
    """
    data = data.to(torch.float64)
    windows, limit = Windows.of(data, window), math.log(len(data))
    estimate = Estimate(xi, windows.first.clone())
    support = (xi != 0) & free
    for _ in range(6):
        estimate, support = _descend(library, estimate, support, windows, (limit, max_rounds))
        active, others = Parameters.where(support), Parameters.where(free & ~support)
        if not len(active) or not len(others):
            break
        model = linearise(library, estimate, active + others, windows, None)
        n_start = len(model.scale) - len(active) - len(others)
        better = reconsider(model.triangle, n_start, active, others, limit)
        if better is None:
            break
        estimate = _move(estimate, model, active + others, torch.cat([torch.arange(n_start), n_start + better]))
        support = (active + others).take(better).support(support.shape)
    return estimate.xi


def _descend(
    library: Library, estimate: Estimate, support: Tensor, windows: Windows, limits: tuple[float, int]
) -> tuple[Estimate, Tensor]:
    """Converge and drop until the support stands still."""
    while bool(support.any()):
        parameters = Parameters.where(support)
        estimate = _converge(library, estimate, parameters, windows, limits[1])
        model = linearise(library, estimate, parameters, windows, None)
        n_start = len(model.scale) - len(parameters)
        kept, _ = walk_down(model.triangle, torch.arange(len(model.scale)) >= n_start, limits[0])
        if len(kept) == len(model.scale):
            break
        estimate = _move(estimate, model, parameters, kept)
        chosen = kept[kept >= n_start] - n_start
        support = Parameters(parameters.features[chosen], parameters.states[chosen]).support(support.shape)
    return estimate, support


def _converge(
    library: Library, estimate: Estimate, parameters: Parameters, windows: Windows, max_rounds: int
) -> Estimate:
    """Make Levenberg-Marquardt steps until the cost stands still."""
    damping, sigma = 0.0, None
    model = linearise(library, estimate, parameters, windows, sigma)
    for _ in range(max_rounds):
        candidate = _move(estimate, model, parameters, torch.arange(len(model.scale)), damping)
        trial = linearise(library, candidate, parameters, windows, model.sigma)
        if not trial.cost < model.cost:
            if damping > 1e6 or abs(trial.cost - model.cost) < 1e-6 * model.cost:
                break
            damping = max(10 * damping, 1e-3)
            continue
        gain = (model.cost - trial.cost) / model.cost
        estimate, damping = candidate, damping / 10 if damping > 1e-6 else 0.0
        model = linearise(library, estimate, parameters, windows, None)
        if gain < 1e-5:
            break
    return estimate


def _move(
    estimate: Estimate, model: Linearised, parameters: Parameters, kept: Tensor, damping: float = 0.0
) -> Estimate:
    """Solve the linear model over the kept unknowns and move coefficients and nodes accordingly."""
    n = len(kept)
    square = model.triangle[:, kept]
    old = torch.cat([torch.zeros(len(model.scale) - len(parameters)), parameters.read(estimate.xi)]) * model.scale
    if damping:
        square = torch.cat([square, damping**0.5 * torch.eye(n, dtype=square.dtype)])
        target = torch.cat([model.triangle[:, -1], damping**0.5 * old[kept]])
    else:
        target = model.triangle[:, -1]
    solution = torch.linalg.lstsq(square, target.unsqueeze(-1), driver="gelsd").solution.squeeze(-1)
    values = torch.zeros_like(old).index_copy(0, kept, solution) / model.scale
    n_start = len(old) - len(parameters)
    step = values.clone()
    step[n_start:] -= parameters.read(estimate.xi)
    nodes = estimate.nodes + model.moves[..., :-1] @ step + model.moves[..., -1]
    return Estimate(parameters.write(estimate.xi, values[n_start:]), nodes)
