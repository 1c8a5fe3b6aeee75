"""Margins of large movements: flights of the model whose inputs act more strongly, or later, until the plant is lost.

The slope of a model at rest takes dry friction for strong damping, which it is for small movements only. So a plant
that rubs is flown from each target to the opposite one, with a worse and worse loop, and the largest movements decide.
All inputs are worse together. A flight is lost where an output runs away, or where it still swings at the end, and no
less than before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.checking.flights import TOLERANCE, fly
from dynasindy.checking.loop import Loop
from dynasindy.sindy import SindyModel

GAINS = torch.linspace(1.0, 4.0, 25, dtype=torch.float64)
"""Factors on the effect of the inputs that are tried, that of the model first."""
LATEST = 8.0
"""Delay up to which flights are tried [control periods]."""
HALVINGS, WHOLE = 4, 3
"""Times that the range in which the delay lies is halved, and how often so that it stays whole periods."""
DIES_OUT = 0.9
"""Part of its swing before that an output which comes to rest has at most in the last quarter of a flight."""
PHASE = "large movements with stronger and later inputs"


@dataclass(frozen=True)
class Flown:
    """Margins in flight: the largest values that were tried where nothing was lost, 0 where the loop as it is is lost.

    Attributes:
        gain: Factor by which the effect of all inputs may grow.
        delay: How much later all inputs may act [control periods].
    """

    gain: float
    delay: float


def rubs(model: SindyModel) -> bool:
    """Tell whether the equations have dry friction, or another function with a kink that is steep at rest only."""
    used = model.coefficients.any(-1).tolist()
    features = (feature for feature, found in zip(model.library.features, used, strict=True) if found)
    return any(factor.function == "tanh" for feature in features for factor in feature.factors)


def flown(loop: Loop, x: Tensor, r: Tensor, seconds: float) -> Flown:
    """Return the margins of movements from states to references.

    Args:
        loop: The loop.
        x: States at which flights begin, `(rows, n_x)`.
        r: References, `(rows, n_r)`.
        seconds: Length of each flight [s].
    """
    gains = GAINS.repeat_interleave(len(x)).unsqueeze(-1)
    worse, many = loop.worse(gains, 0.0), len(GAINS)
    lost = _lost(worse, x.repeat(many, 1), r.repeat(many, 1), seconds).unflatten(0, (many, len(x))).any(-1)
    if bool(lost[0]):
        return Flown(0.0, 0.0)
    first = int(lost.long().argmax()) if bool(lost.any()) else many

    def _held(periods: float) -> bool:
        return not bool(_lost(loop.worse(1.0, periods * loop.dt), x, r, seconds).any())

    # A difference equation cannot get its inputs a part of a step late.
    halvings = HALVINGS if loop.plant.model.step is None else WHOLE
    return Flown(float(GAINS[first - 1]), _largest(_held, LATEST, halvings))


def _largest(held: Callable[[float], bool], end: float, halvings: int) -> float:
    """Return the largest number that is held, up to an end, if all below it are held, too."""
    if held(end):
        return end
    good, bad = 0.0, end
    for _ in range(halvings):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if held(middle) else (good, middle)
    return good


def _lost(loop: Loop, x: Tensor, r: Tensor, seconds: float) -> Tensor:
    """Return which flights are lost, bool `(rows,)`."""
    flights = fly(loop, x, r, seconds, PHASE)
    y = flights.x[..., flights.outputs]
    quarter = max(2, y.shape[1] // 4)
    before, last = (part.amax(1) - part.amin(1) for part in (y[:, -2 * quarter : -quarter], y[:, -quarter:]))
    still = last <= TOLERANCE * loop.task.boxes().to(last)
    return ~((still | (last < DIES_OUT * before)) & y.isfinite().all(1)).all(-1)
