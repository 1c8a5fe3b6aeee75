"""A flight of a rig: targets, what was measured, the inputs, the ranges of its guard, and what ended it early."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dynasindy.text import format_duration
from dynasindy.viz.identification import training_data
from dynasindy.viz.response import tracking
from dynasindy.viz.style import GREY, ORANGE, RED, legend_above, styled, time_axis

if TYPE_CHECKING:  # figures know a flight by its attributes alone
    from dynasindy.rig import Guard, Wiring
    from dynasindy.rig.base import Array
    from dynasindy.rig.log import FlightRecord

LATE = 0.02
"""Share of the planned time that is left free beside what was flown, for the line at which a flight ended."""


@styled
def draw_flight(shown: FlightRecord, wiring: Wiring, guard: Guard, name: str) -> Figure:
    """Draw a flight on the time that was planned for it.

    Args:
        shown: The flight, with one sample or more.
        wiring: What of the plant is measured, and how often.
        guard: Tells the ranges of the outputs within which a flight goes on; drawn where they are near.
        name: Of the flight, such as `flight_1`.
    """
    units = [f"{output} [{unit}]" for output, unit in zip(shown.names, shown.units, strict=True)]
    measured = {"measured": shown.outputs}
    planned = max(shown.planned, len(shown.time)) * wiring.dt
    title = f"{name.replace('_', ' ').capitalize()} on the rig"
    ended = float(shown.time[-1]) + wiring.dt
    if shown.fault:
        title += f", ended after {format_duration(ended, planned)} of {format_duration(planned)} by {shown.fault}"
    inputs = {"measured": shown.inputs}
    figure = tracking(shown.time, shown.references, measured, inputs, units, wiring.signature, title)
    for column, (axis, output) in enumerate(zip(figure.axes, shown.names, strict=False)):
        if np.isnan(shown.outputs[:, column]).all():
            axis.text(0.5, 0.5, "not measured", transform=axis.transAxes, ha="center", va="center", color=GREY)
        for line in axis.lines:
            if line.get_label() == "reference":  # a target is held, and the next one follows at once
                line.set_drawstyle("steps-post")
        _mark_isolated_samples(axis, shown.time, shown.outputs[:, column])
        _draw_range(figure, axis, guard.ranges.get(output, ()))
    for axis in figure.axes:
        if shown.fault:
            axis.axvline(ended, color=RED, linewidth=1.0, label="ended, safe input")
    time_axis(figure.axes[-1], (0.0, planned))
    figure.axes[-1].set_xlim(0.0, planned * (1 + LATE * bool(shown.fault)))
    legend_above(figure.axes[0])
    return figure


@styled
def draw_rig_excitation(samples: tuple[Array, Array, Array], wiring: Wiring, guard: Guard, title: str) -> Figure:
    """Draw what an excitation moved, and the ranges of the guard where they are near.

    Args:
        samples: Times `(T,)` [s], states `(T, n_x)`, NaN where they were not measured, and inputs `(T, n_u)`.
        wiring: Tells names and units, and what is measured.
        guard: Tells the ranges of the states within which a flight goes on.
        title: Of the figure.
    """
    time, states, inputs = samples
    figure = training_data(time, states, inputs, wiring.signature, title)
    seen = [i for i in range(states.shape[1]) if not np.isnan(states[:, i]).all()]
    for axis, place in zip(figure.axes, seen, strict=False):
        _draw_range(figure, axis, guard.ranges.get(wiring.signature.state_names[place], ()))
    if figure.axes[0].get_legend_handles_labels()[0]:
        legend_above(figure.axes[0])
    return figure


def _draw_range(figure: Figure, axis: Axes, ends: Sequence[float]) -> None:
    """Draw the ends of a range of the guard that are near; one that is far off would flatten the flight."""
    bottom, top = axis.get_ylim()
    room = 0.3 * (top - bottom)
    for end in ends:
        if bottom - room < end < top + room:
            axis.axhline(end, color=ORANGE, linestyle="-.", linewidth=1.0)
            figure.axes[0].plot([], [], color=ORANGE, linestyle="-.", linewidth=1.0, label="range of the guard")


def _mark_isolated_samples(axis: Axes, time: Array, values: Array) -> None:
    """Mark samples between two that were lost, of which a line shows nothing."""
    known = np.isfinite(np.concatenate([[np.nan], values, [np.nan]]))
    alone = known[1:-1] & ~known[:-2] & ~known[2:]
    if alone.any():
        measured = next(line for line in axis.lines if line.get_label() == "measured")
        axis.plot(time[alone], values[alone], ".", color=measured.get_color(), markersize=3.0)
