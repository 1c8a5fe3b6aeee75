"""PySINDy's regression on rows of its own and on ours, and what a regression found."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from scipy.signal import savgol_filter
from torch import Tensor

from dynasindy.sindy.library import Library
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.reconstruction import RegressionData, rate_states, reconstruct
from dynasindy.sindy.regression import Rows
from dynasindy.systems.transitions import Transitions

Score = tuple[int, int, float]
THRESHOLDS = (0.1, 0.3, 0.9, 3.0, 10.0, 30.0, 100.0, 300.0)
SCALED_THRESHOLDS = (1e-4, 3e-4, 1e-3, 3e-3, 5e-3, 1e-2)
PLAIN_THRESHOLDS = (0.01, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9)
"""That PySINDy is tried with: of coefficients of columns of unit norm, of those relative to the rates' norm, and of
coefficients as they are."""


def score(found: Tensor, truth: Tensor) -> Score:
    """Return true terms found, false terms, and the worst relative error of a true coefficient."""
    true, mine = truth != 0, found != 0
    worst = ((found - truth)[true] / truth[true]).abs().max()
    return int((true & mine).sum()), int((mine & ~true).sum()), float(worst)


def pysindy_of(model: SindyModel, data: Transitions, threshold: float) -> SindyModel:
    """Return PySINDy's model of the same functions and smoothed states, at a threshold.

    Args:
        model: Names the functions, and what is known of the equations; it is not fitted.
        data: Training log, NaN where a state was not measured.
        threshold: Of coefficients of columns and rates of unit norm.

    Raises:
        ValueError: A state is left without an equation.
    """
    import pysindy

    guess = reconstruct(data, rate_states(model.library, model.constraints), True)
    theta, dx = model.library(guess.x, guess.u), (guess.x_next - guess.x) / data.dt
    norms = dx.norm(dim=0).clamp_min(1e-300)
    optimizer = pysindy.STLSQ(threshold=threshold, alpha=0, normalize_columns=True)
    xi = stlsq((theta, dx / norms), optimizer) * norms
    theirs = SindyModel(model.signature, model.library)
    theirs.set_coefficients(torch.where(model.constraints.offset.any(0), model.constraints.offset, xi))
    if bool((theirs.coefficients == 0).all(0).any()):
        raise ValueError("a state has no equation")
    return theirs


def smoothed_rows(library: Library, data: Transitions, length: int) -> Rows:
    """Return functions and rates of states that a cubic through `length` samples smooths, as PySINDy's option does.

    Its functions would read the states as they were measured; here they read the smoothed ones, which is better.
    """
    import pysindy

    x = torch.cat([data.x, data.x_next[-1:]]).numpy()
    x = savgol_filter(x, length, 3, axis=0) if length else x
    rate = pysindy.FiniteDifference()._differentiate(x, data.dt)[:-1]
    return library(torch.from_numpy(x[:-1]), data.u), torch.from_numpy(rate)


def weak_rows(library: Library, data: Transitions) -> Rows:
    """Return our weak form of noisy states."""
    return RegressionData.of(data, {}, True).rows(library, library)


def best_threshold(
    name: str, pairs: list[Rows], truth: Tensor, scaled: bool | None = False
) -> tuple[int, str, list[Score]]:
    """Return what PySINDy's best threshold is worth, true terms less false ones over all seeds, its words and scores.

    Args:
        name: Words for the rows.
        pairs: Functions and rates, of each seed.
        truth: The true coefficients, by which the threshold is chosen.
        scaled: Whether the rates of each state are divided by their norm, so that one threshold suits all states;
            None leaves the functions as they are too.
    """
    import pysindy

    found: list[tuple[int, str, list[Score]]] = []
    for threshold in {None: PLAIN_THRESHOLDS, False: THRESHOLDS, True: SCALED_THRESHOLDS}[scaled]:
        scores = []
        for theta, dx in pairs:
            norms = dx.norm(dim=0) if scaled else torch.ones(dx.shape[1], dtype=dx.dtype)
            optimizer = pysindy.STLSQ(threshold=threshold, alpha=0, normalize_columns=scaled is not None)
            scores.append(score(stlsq((theta, dx / norms), optimizer) * norms, truth))
        how = "as they are" if scaled is None else "normalised"
        words = f"threshold={threshold:g}, alpha=0, {how}, {name}"
        found.append((sum(t - f for t, f, _ in scores), words, scores))
    return max(found, key=lambda one: one[0])


def stlsq(pair: Rows, optimizer: Any) -> Tensor:
    """Return what an optimiser of PySINDy finds, `(n_features, n_x)`."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        optimizer.fit(pair[0].numpy(), pair[1].numpy())
    return torch.from_numpy(np.asarray(optimizer.coef_)).mT
