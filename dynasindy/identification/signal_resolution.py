"""Whether a log is too quiet to tell: states that move by a few steps of their sensors only."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from dynasindy.findings import Finding, LogError, weak
from dynasindy.identification.forecast_errors import ForecastErrors
from dynasindy.identification.recording_diagnostics import all_samples_of, coarse_resolution
from dynasindy.systems.base import WHOLE, Signature
from dynasindy.systems.transitions import Transitions

FEW = 10.0
"""Steps of its sensor that a state has to move by, for its log to tell anything."""
WANTED = 100.0
"""Steps that a state should move by in a log."""
FAR = 5.0
"""Targets this many times as far as a quiet log went are not planned for."""
TINY = 1e-9
"""Movement of an input that is none."""


def low_signal_states(data: Transitions, but: Collection[int] = ()) -> dict[int, float]:
    """Return the places of states that move by less than `FEW` steps of their sensors, and by how many they move.

    A state that does not move at all is none of them, nor one whose sensor shows no steps.

    Args:
        data: The log.
        but: Places of states that are not asked about: rates made of differences move in steps of their own.
    """
    moved = {}
    for place, column in enumerate(all_samples_of(data)):
        step = 0.0 if place in but else coarse_resolution(column)
        if step and (steps := float(np.nanmax(column) - np.nanmin(column)) / step) < FEW:
            moved[place] = steps
    return moved


def resolved_errors(forecasts: ForecastErrors | None, quiet: Collection[int]) -> ForecastErrors | None:
    """Return errors of predictions without those of quiet states, as if they had not been measured; None if none stay.

    Args:
        forecasts: The errors, if there are any.
        quiet: Places of the states that the log is too quiet to tell of.
    """
    if forecasts is None or not quiet:
        return forecasts
    model, held = forecasts.model.clone(), forecasts.held.clone()
    model[:, list(quiet)] = held[:, list(quiet)] = torch.nan
    return None if bool(held.isnan().all()) else replace(forecasts, model=model, held=held)


def low_signal_findings(data: Transitions, signature: Signature, but: Collection[int] = ()) -> list[Finding]:
    """Return which states a log is too quiet to tell of, which inputs to move, and how far.

    Args:
        data: The log.
        signature: Names, units and ends.
        but: Places of states that are not asked about.
    """
    if not (moved := low_signal_states(data, but)):
        return []
    steps = {signature.state_names[i]: round(count) for i, count in moved.items()}
    inputs = _louder(data, signature, max(WANTED / count for count in moved.values()))
    return [weak("log.low_signal", steps=steps, wanted=round(WANTED), inputs=inputs)]


def low_signal_targets(
    data: Transitions, signature: Signature, targets: Mapping[str, Sequence[float]]
) -> list[Finding]:
    """Return which of the states that are to be held a log is too quiet to tell of.

    Args:
        data: The log.
        signature: Names, units and ends.
        targets: Lower and upper end of the targets of each output.

    Raises:
        LogError: The targets of such a state lie far beyond the log.
    """
    places = [signature.state_index(name) for name in targets if name in signature.state_names]
    findings = low_signal_findings(data, signature, set(range(signature.n_x)) - set(places))
    for place in low_signal_states(data) if findings else ():
        name, unit = signature.state_names[place], signature.state_units[place]
        reach, ends = float(data.x[:, place].abs().nan_to_num(nan=0.0).max()), targets.get(name, (0.0,))
        if max(map(abs, ends)) > FAR * reach:
            facts = {"state": name, "unit": unit, "low": ends[0], "high": ends[1], "reach": reach}
            raise LogError("log.low_signal_targets", **facts, quiet=findings[0])
    return findings


def _louder(data: Transitions, signature: Signature, times: float) -> list[dict[str, Any]]:
    """Return how far the inputs went, and that they are to go `times` as far, or as far as their actuators reach."""
    limits = signature.input_limits or (WHOLE,) * signature.n_u
    low, high = data.u.amin(0).double().numpy(), data.u.amax(0).double().numpy()
    ends = signature.in_own_units(np.stack([low, high])).T.tolist()
    units, found = signature.input_units or ("-",) * signature.n_u, []
    for i, name in enumerate(signature.input_names):
        moves = high[i] - low[i] > TINY
        room = (limits[i][1] - limits[i][0]) / (high[i] - low[i]) if moves else math.inf
        further = min(room, times) if moves else None
        own = {"input": name, "low": ends[i][0], "high": ends[i][1], "unit": units[i]}
        found.append({**own, "times": further, "limited": bool(room < times)})
    return found
