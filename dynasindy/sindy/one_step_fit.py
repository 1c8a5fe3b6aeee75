"""Gauss-Newton on the one-step prediction error, with the functions that matter selected on the way."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dynasindy.progress import report_progress
from dynasindy.sindy.codegen import simulate
from dynasindy.sindy.covariance import STRETCHES, Covariance, jackknife
from dynasindy.sindy.library import Library
from dynasindy.sindy.regression import least_squares, reconsider, walk_down
from dynasindy.sindy.sensitivity import Parameters, Propagator
from dynasindy.sindy.shooting import CHUNK, ENOUGH, MOST_STEPS, TALL, choose_stretches, relative_step
from dynasindy.systems.transitions import Transitions

LONGEST_STEP, MOST_TURNED, MOST = 0.005, 0.05, 200
"""Longest Runge-Kutta step [s] of a refinement: at rates of 10/s its relative error is below 1e-7. Intervals of more
than `MOST_STEPS` such steps, as a slow plant is sampled, need not have more of them than the fastest rate of the model
asks for: a step times that rate is as small, and there are `MOST` of them at most."""


def _steps_in(data: Transitions, library: Library, xi: Tensor) -> int:
    """Return into how many Runge-Kutta steps an interval of a recording is divided."""
    wanted = max(1, math.ceil(data.dt / LONGEST_STEP - 1e-9))
    if wanted <= MOST_STEPS:
        return wanted
    turn = relative_step(library, xi, data.x, data.u, data.dt)
    return min(wanted, MOST, max(MOST_STEPS, math.ceil(turn / MOST_TURNED)))


def refine_one_step(
    library: Library, xi: Tensor, free: Tensor, data: Transitions, tolerance: float, max_rounds: int = 8
) -> tuple[Library, Tensor]:
    """Minimise the one-step prediction error over the active coefficients; drop those that do not matter.

    Each round makes one Gauss-Newton step with all active coefficients; from the same linear model coefficients
    are dropped, least missed first, while the Bayesian criterion gains. When neither the support nor the
    coefficients move, functions outside the model are reconsidered. An error of `tolerance` times the change over a
    step is taken as exact.

    Returns:
        The library with its shapes, and coefficients, `(n_features, n_x)`.
    """
    whole = data.to(torch.float64)
    data = whole.select(choose_stretches(len(whole), ENOUGH))
    floor = tolerance * (whole.x_next - whole.x).square().mean(0).sqrt()
    limit = math.log(len(data))
    support, held = (xi != 0) & free, torch.where(free, 0.0, xi)
    for _ in range(6):
        library, xi, support = _descend(library, xi, support, data, floor, max_rounds)
        active, others = Parameters.where(support), Parameters.where(free & ~support)
        if not len(active) or not len(others):
            break
        report_progress("fit", note=f"which of {len(others)} terms that were left out should come in")
        (triangle, scale), n_shapes = _triangle(library, xi, active + others, data, floor), len(library.shapes)
        better = reconsider(triangle, n_shapes, active, others, limit)
        if better is None:
            break
        chosen, columns = (active + others).take(better), torch.cat([torch.arange(n_shapes), n_shapes + better])
        values = least_squares(triangle[:, columns], triangle[:, -1]) / scale[columns]
        xi = chosen.write(held, values[n_shapes:])
        support = chosen.support(support.shape)
    if len(data) < len(whole):
        library, xi, _ = _descend(library, xi, support, whole, floor, max_rounds)
    return library, xi


def _descend(
    library: Library, xi: Tensor, support: Tensor, data: Transitions, floor: Tensor, max_rounds: int
) -> tuple[Library, Tensor, Tensor]:
    """Step and drop until neither the support nor the coefficients move."""
    n_shapes = len(library.shapes)
    for k in range(max_rounds):
        parameters = Parameters.where(support)
        if not len(parameters):
            break
        what = f"{len(parameters)} coefficients, by single steps between {len(data)} samples"
        report_progress("fit", note=f"step {k + 1} of at most {max_rounds} for {what}")
        triangle, scale = _triangle(library, xi, parameters, data, floor)
        kept, values = walk_down(triangle, torch.arange(len(scale)) >= n_shapes, math.log(len(data)))
        numbers = [shape.frequency + by for shape, by in zip(library.shapes, (values / scale[kept]).tolist())]
        library = library.with_shapes(numbers) if numbers else library
        values, kept = (values / scale[kept])[n_shapes:], kept[n_shapes:] - n_shapes
        chosen = Parameters(parameters.features[kept], parameters.states[kept])
        last, xi = xi, chosen.write(torch.where(support, 0.0, xi), values)
        support = chosen.support(xi.shape)
        change = ((xi - last).abs() / xi.abs().clamp_min(1e-300))[support]
        if len(chosen) == len(parameters) and float(change.max()) < 1e-7:
            break
    return library, xi, support


def one_step_covariance(
    library: Library, xi: Tensor, free: Tensor, data: Transitions, tolerance: float
) -> Covariance | None:
    """Return the covariance of the coefficients of least one-step error, numbers inside functions unknown as well.

    It is None where nothing was estimated, or a number in it is not finite.
    """
    data, parameters = data.to(torch.float64), Parameters.where((xi != 0) & free)
    floor = tolerance * (data.x_next - data.x).square().mean(0).sqrt()
    factor = jackknife(_linear_model(library, xi, parameters, data, floor, min(STRETCHES, len(data))))
    return None if factor is None else Covariance.of(parameters, factor[len(library.shapes) :])


def one_step_errors(library: Library, xi: Tensor, data: Transitions) -> dict[str, float]:
    """Return the part of each state's change from sample to sample that a prediction of it misses (RMS)."""
    data = data.to(torch.float64)
    predicted = _predicted(library, xi, data, _steps_in(data, library, xi))
    parts = (data.x_next - predicted).norm(dim=0) / (data.x_next - data.x).norm(dim=0).clamp_min(1e-300)
    return dict(zip(library.signature.state_names, parts.tolist(), strict=True))


def _predicted(library: Library, xi: Tensor, data: Transitions, steps: int) -> Tensor:
    """Return the states one sample later, `(N, n_x)`."""
    u_end = None if data.u_end is None else data.u_end.unsqueeze(1)
    return simulate(library, xi, data.x, data.u.unsqueeze(1), data.dt, steps, u_end)[:, 0]


def _linear_model(
    library: Library, xi: Tensor, parameters: Parameters, data: Transitions, floor: Tensor, parts: int = 1
) -> list[Tensor]:
    """Linearise the one-step prediction error, each state weighted by its error, but not beyond `floor` `(n_x,)`.

    It is condensed block by block, so that slopes stay in fast memory however long a recording is.

    Returns:
        R of [J, error] of so many parts of the recording, J by the shapes and the coefficients, `(R, S + P + 1)` each.
    """
    propagator, steps = Propagator(library, xi, parameters, library.shapes), _steps_in(data, library, xi)
    error = data.x_next - _predicted(library, xi, data, steps)
    weight = 1 / torch.maximum(error.square().mean(0).sqrt(), floor).clamp_min(1e-300)
    n_x, triangles = xi.shape[1], []
    columns = n_x + len(library.shapes) + len(parameters)
    length = max(CHUNK // (n_x * columns), TALL * columns // n_x + 1)
    for part in torch.arange(len(data)).tensor_split(parts):
        condensed = []
        for rows in part.split(length):
            inputs = data.inputs_of(rows)
            s = propagator.transfer(data.x[rows], inputs[0], data.dt, steps, inputs[1])[1][:, :, n_x:]
            block = torch.cat([s, error[rows].unsqueeze(-1)], -1) * weight.unsqueeze(-1)
            condensed.append(torch.linalg.qr(block.flatten(0, 1), mode="r")[1])
        triangles.append(condensed[0] if len(condensed) == 1 else torch.linalg.qr(torch.cat(condensed), mode="r")[1])
    return triangles


def _triangle(
    library: Library, xi: Tensor, parameters: Parameters, data: Transitions, floor: Tensor
) -> tuple[Tensor, Tensor]:
    """Return R of [J, J xi + error] with columns of J of unit norm, `(S + P + 1, S + P + 1)`, and their norms."""
    (triangle,) = _linear_model(library, xi, parameters, data, floor)
    scale = triangle[:, :-1].norm(dim=0).clamp_min(1e-300)
    target = triangle[:, -1:] + triangle[:, len(library.shapes) : -1] @ parameters.read(xi).unsqueeze(-1)
    return torch.linalg.qr(torch.cat([triangle[:, :-1] / scale, target], -1), mode="r")[1], scale
