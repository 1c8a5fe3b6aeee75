"""Opponents of our model of the cascaded tanks, and the error of a reading, simulated from its start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.open_loop import simulated
from benchmarks.rivals import pysindy_of
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

Array = NDArray[np.float64]
FIRST = 20
"""Samples at the beginning of a log from which its start state is read."""
FINE = 8
"""Runge-Kutta steps in a sample of the tanks, whose sensor follows within a second."""
RIM = 10.0
"""Reading at which the sensor of the tanks ends [V]."""
FAR = 1e3
"""Reading at which a model that runs away is stopped [V]."""
LINEAR = ("1", "u", "reading", "rate")
ROOTS = ("sqrt(reading)", "rate sqrt(reading)", "u sqrt(reading)")
QUADRATIC = (*LINEAR, "u^2", "u reading", "u rate", "reading^2", "reading rate", "rate^2")
SETS = (LINEAR, (*LINEAR, ROOTS[0]), (*LINEAR, *ROOTS), QUADRATIC, (*QUADRATIC, *ROOTS, "reading^3"))
"""Sets of functions of the reading and its rate that PySINDy is tried with."""


def linear_tanks() -> SindyModel:
    """Return a linear model of the tanks, of the order of theirs; the upper level's unit is held by its flow."""
    signature = Signature(("level_1", "reading"), ("V", "V"), ("u",), (10.0, 10.0))
    return SindyModel(
        signature,
        ["1", "u", "level_1", "reading"],
        Regression("bic"),
        Refinement("trajectory", window=20, error="simulation"),
        allowed={"level_1": ["1", "u", "level_1"], "reading": ["1", "reading"]},
        fixed={"reading": {"level_1": 0.04}},
        initial={"level_1": {"u": 0.04, "level_1": -0.02}, "reading": {"reading": -0.02}},
    )


def pysindy_tanks(data: Transitions, level: Array, sets: Sequence[Sequence[str]] = SETS) -> SindyModel:
    """Return PySINDy's model of the tanks: it takes no hidden state, so the rate of the reading is the second one.

    Of several sets of functions that one is taken whose error on the training log is the least.

    Args:
        data: Training log; its last state is the reading.
        level: The reading as it was measured [V], `(N + 1,)`.
        sets: Sets of functions that are tried.
    """
    signature = Signature(("reading", "rate"), ("V", "V/s"), ("u",), (10.0, 0.1))

    def _score(model: SindyModel) -> float:
        return rms(reading_errors(model, data, level))

    def _model(words: Sequence[str]) -> SindyModel:
        return SindyModel(signature, words, Regression("bic"), Refinement(), known={"reading": "rate"})

    return min((pysindy_of(_model(words), states_of(data, [-1, 0]), _score) for words in sets), key=_score)


def states_of(data: Transitions, places: list[int]) -> Transitions:
    """Return a recording of some of the states; of the tanks the last one was measured, and no other.

    Args:
        data: The recording.
        places: Columns of the states that are kept, in this order.
    """
    return replace(data, x=data.x[:, places], x_next=data.x_next[:, places])


def reading_errors(model: SindyModel, data: Transitions, level: Array) -> Array:
    """Return the errors of a simulation of the reading [V], `(N + 1,)`; its hidden states fit the first samples.

    Args:
        model: Its states are the `reading`, `float`, what the sensor makes of the lower level, and hidden ones.
        data: Recording whose inputs are read.
        level: Reading as it was measured [V], `(N + 1,)`.
    """
    names = model.signature.state_names
    reading = names.index("reading")

    def _path(start: Array, n: int) -> Array:
        part = data.select(torch.arange(len(data)) < n)
        # Of the tanks and the reading that their sensor makes of them, the latter begins where it was measured.
        seen = {"float": level[0], "reading": level[0]}
        hidden = iter(start.tolist())
        x0 = torch.tensor([seen[name] if name in seen else next(hidden) for name in names], dtype=torch.float64)
        readings: Array = simulated(model, x0, part, FINE)[:, reading].clamp_max(RIM).numpy()
        return np.clip(np.nan_to_num(readings, nan=FAR), -FAR, FAR)

    def _error(start: Array) -> Array:
        error: Array = _path(start, FIRST) - level[: FIRST + 1]
        return error

    # Within the play the reading does not move with the level: the fit begins from several places below the rim.
    lower = [level[0] - 5] if "level_2" in names else []
    starts = [[0.0]] if "rate" in names else [[upper, *lower] for upper in (2.0, 4.0, 6.0)]
    fits = (least_squares(_error, np.array(start), diff_step=1e-3) for start in starts)
    found = min(fits, key=lambda fit: float(fit.cost)).x
    errors: Array = _path(found, len(data)) - level
    return errors


def rms(errors: Array) -> float:
    """Return the root-mean-square of errors; infinite where one is not finite."""
    found = float(np.sqrt(np.mean(errors**2)))
    return found if np.isfinite(found) else float("inf")
