"""Whether a log is too quiet to tell: states that move by a few steps of their sensors only."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from dynasindy.evaluation.forecast_errors import ForecastErrors
from dynasindy.evaluation.recording_diagnostics import all_samples_of, coarse_resolution
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


def describe_low_signals(data: Transitions, signature: Signature, but: Collection[int] = ()) -> str:
    """Say which states a log is too quiet to tell of, which inputs to move, and how far; empty where there are none.

    Args:
        data: The log.
        signature: Names, units and ends.
        but: Places of states that are not asked about.
    """
    moved = low_signal_states(data, but)
    if not moved:
        return ""
    times = max(WANTED / steps for steps in moved.values())
    names = signature.state_names
    told = " and ".join(f"{names[i]}, which moves by {round(steps)} steps of its sensor" for i, steps in moved.items())
    return (
        f"the log is too quiet to tell of {told}, where some {WANTED:g} are wanted: {_louder(data, signature, times)}"
    )


def describe_low_signal_targets(data: Transitions, signature: Signature, targets: Mapping[str, Sequence[float]]) -> str:
    """Say which of the states that are to be held a log is too quiet to tell of; empty where there are none.

    Args:
        data: The log.
        signature: Names, units and ends.
        targets: Lower and upper end of the targets of each output.

    Raises:
        ValueError: The targets of such a state lie far beyond the log.
    """
    places = [signature.state_index(name) for name in targets if name in signature.state_names]
    told = describe_low_signals(data, signature, set(range(signature.n_x)) - set(places))
    for place in low_signal_states(data) if told else ():
        name, unit = signature.state_names[place], signature.state_units[place]
        reach, ends = float(data.x[:, place].abs().nan_to_num(nan=0.0).max()), targets.get(name, (0.0,))
        if max(map(abs, ends)) > FAR * reach:
            raise ValueError(
                f"the targets of {name} go from {ends[0]:g} to {ends[1]:g} {unit}, the log to {reach:.2g} only; {told}"
            )
    return told


def _louder(data: Transitions, signature: Signature, times: float) -> str:
    """Say how far the inputs went, and that they are to go `times` as far, or as far as their actuators reach."""
    limits = signature.input_limits or (WHOLE,) * signature.n_u
    low, high = data.u.amin(0).double().numpy(), data.u.amax(0).double().numpy()
    ends = signature.in_own_units(np.stack([low, high])).T.tolist()
    units = signature.input_units or ("-",) * signature.n_u
    words = []
    for i, name in enumerate(signature.input_names):
        unit = "" if units[i] == "-" else f" {units[i]}"
        went = f"{name}, which goes from {ends[i][0]:.2g} to {ends[i][1]:.2g}{unit},"
        room = (limits[i][1] - limits[i][0]) / (high[i] - low[i]) if high[i] - low[i] > TINY else np.inf
        if not np.isfinite(room):
            words.append(f"{name}, which does not move")
        elif room < times:
            words.append(f"{went} as far as its actuator reaches, about {room:.2g} times as far")
        else:
            words.append(f"{went} about {times:.2g} times as far")
    return f"log it anew and move {', or '.join(words)}"
