"""Dead zones and saturations of inputs, read off equations, or seen in what equations without them leave over.

Both are piecewise linear in the input: a dead zone is flat between two bends, a saturation beyond one or two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import torch
from torch import Tensor

from dynasindy.sindy.codegen import generate
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.reconstruction import (
    DelayedRecording,
    RegressionData,
    rate_states,
    reconstruct,
    settle_lag_states,
)
from dynasindy.sindy.regression import least_squares
from dynasindy.systems.transitions import Transitions

FLAT = 0.1
"""Slope in a part of the range of an input below which it does nothing there [largest slope]."""
ROUGHLY = 0.25
"""The same where slopes are a first guess."""
HALF = 0.5
"""Part of the squared errors that bends may leave over."""
PLACES = tuple(0.05 * k for k in range(2, 19))
"""Parts of the samples of an input below the bends that are tried."""
NARROW = 0.1
"""Part of the range of an input, at least, that a bend leaves between its ends: a jump is neither of the two."""
LEVELS = 10
"""Values of an input from which on its bends can be told."""


@dataclass(frozen=True)
class InputNonlinearity:
    """Hold where an input does nothing.

    Attributes:
        input: the input.
        kind: what it is.
        low: lower end of a dead zone, and of what lies between two ends of a saturation [of the model's input].
        high: upper end, likewise; a saturation may lack either, which is infinite then.
    """

    input: str
    kind: Literal["dead zone", "saturation"]
    low: float
    high: float


def _classify_nonlinearity(
    name: str, edges: Sequence[float], slopes: Sequence[float], flat: float = FLAT
) -> InputNonlinearity | None:
    """Return what a piecewise linear function of an input is, None where it is neither.

    It bends at `edges`, which rise; `slopes` are below the first, between them, and above the last one. A slope is none
    that is below `flat` times the largest one.
    """
    still = [abs(slope) <= flat * max(map(abs, slopes)) for slope in slopes]
    if not edges or all(still):
        return None
    if still[0] or still[-1]:
        ends = (edges[0] if still[0] else -math.inf), (edges[-1] if still[-1] else math.inf)
        return InputNonlinearity(name, "saturation", *ends)
    if True in still:
        k = still.index(True)
        return InputNonlinearity(name, "dead zone", edges[k - 1], edges[k])
    return None


def read_nonlinearity(model: SindyModel, state: int, name: str) -> InputNonlinearity | None:
    """Return the dead zone or the saturation of an input in an equation, None where it has neither.

    Args:
        model: a fitted model.
        state: whose equation it is.
        name: the input, or the state that stands for it.
    """
    edges: dict[float, float] = {}
    slope = 0.0
    for k in model.coefficients[:, state].nonzero().flatten().tolist():
        feature, size = model.library.features[k], float(model.coefficients[k, state])
        if name not in feature.variables:
            continue
        (first, *others) = feature.factors
        if others or first.power != 1 or first.variables != (name,) or first.function not in ("id", "hinge"):
            return None
        if first.function == "id":
            slope += size
        else:
            edges[first.frequency] = edges.get(first.frequency, 0.0) + size
    slopes, rising = [slope], sorted(edges)
    for edge in rising:
        slopes.append(slopes[-1] + edges[edge])
    return _classify_nonlinearity(name, rising, slopes) if any(slopes) else None


def find_missing_nonlinearity(model: SindyModel, data: Transitions) -> InputNonlinearity | None:
    """Return the dead zone or the saturation that what the equations leave over looks like most, None if neither.

    Two bends of each input are tried beside the functions of each equation that reads it, by regressions of the rates
    of change.

    Args:
        model: a fitted model.
        data: the log that it was fitted to, NaN where a state was not measured.
    """
    data = data.to(torch.float64)
    rates = rate_states(model.library, model.constraints)
    guess = settle_lag_states(reconstruct(data, rates), model.followers)
    seen = DelayedRecording.of(data, guess, rates, model.delay).brief(model.delay).seen(model.delay)
    found: InputNonlinearity | None = None
    least = HALF
    for place, name in enumerate(model.signature.input_names):
        u = seen.guess.u[:, place]
        edges = sorted({*torch.quantile(u, torch.tensor(PLACES, dtype=u.dtype)).tolist()})
        if len(u.unique()) < LEVELS or len(edges) < 2 or name in model.followed.values():
            continue
        for part, ends, slopes in _bent(model, seen, name, edges):
            bend = _classify_nonlinearity(name, ends, slopes, ROUGHLY)
            if part < least and bend is not None and ends[-1] - ends[0] >= NARROW * float(u.max() - u.min()):
                found, least = bend, part
    return found


def _bent(
    model: SindyModel, seen: RegressionData, name: str, edges: Sequence[float]
) -> Iterator[tuple[float, Sequence[float], list[float]]]:
    """Yield, of each equation that reads an input, what its two best bends leave over, where they are, and slopes."""
    straight, bent = [CONSTANT, variable(name)], [of("hinge", name, frequency=edge) for edge in edges]
    library = Library(model.signature, [*straight, *bent, *model.library.features])
    places = {feature.key: k for k, feature in enumerate(library.features)}
    theta, dx = seen.rows(library, generate(model.library, model.coefficients))
    for column, target in zip(model.coefficients.unbind(-1), dx.unbind(-1), strict=True):
        own = [model.library.features[k].key for k in column.nonzero().flatten().tolist()]
        if variable(name).key not in own:
            continue
        base = theta[:, [places[key] for key in dict.fromkeys([variable(name).key, CONSTANT.key, *own])]]
        tried = []
        for pair in combinations(zip(edges, bent, strict=True), 2):
            more = theta[:, [places[feature.key] for _, feature in pair]]
            tried.append((*_left(torch.cat([base, more], -1), target), [edge for edge, _ in pair]))
        after, xi, ends = min(tried, key=lambda trial: (math.isnan(trial[0]), trial[0]))
        before = _left(base, target)[0]
        if before > 0:
            yield after / before, ends, torch.stack([xi[0], xi[-2], xi[-1]]).cumsum(0).tolist()


def _left(columns: Tensor, target: Tensor) -> tuple[float, Tensor]:
    """Return the squares that least squares leave over, and the coefficients."""
    scale = columns.norm(dim=0).clamp_min(1e-300)
    xi = least_squares(columns / scale, target) / scale
    return float((target - columns @ xi).square().sum()), xi
