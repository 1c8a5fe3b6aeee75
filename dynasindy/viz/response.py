"""How a controlled plant responds: steps, sines and squares, evaluations over many references, flights of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dynasindy.evaluation.metrics import SETTLING_BAND, steady_seconds
from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.systems import Signature
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.text import format_duration
from dynasindy.viz import style
from dynasindy.viz.identification import training_data

if TYPE_CHECKING:  # figures know a flight by its attributes alone
    from dynasindy.rig import Wiring
    from dynasindy.rig.log import FlightRecord
    from dynasindy.rig.session import Session

AXES = SIGNATURE.state_names[:2]
MOST = 10
"""States that a figure has, those that are tracked first; all of these are in it."""
LATE = 0.02
"""Share of the planned time that is left free beside what was flown, for the line at which a flight ended."""


@style.styled
def tracking(
    time: ArrayLike,
    reference: ArrayLike | None,
    outputs: Mapping[str, ArrayLike],
    inputs: Mapping[str, ArrayLike] | None = None,
    names: Sequence[str] = AXES,
    signature: Signature = SIGNATURE,
    title: str = "",
    settling: bool = True,
) -> Figure:
    """Draw the states of one or several controllers, those that are tracked against the same reference.

    Where targets stay, the time ends with twice what passes until nothing moves any more.

    Args:
        time: `(T,)` at which each control period begins [s].
        reference: `(T, n_r)`, or as many rows as the outputs; None of a task that has none.
        outputs: `(T, n)` per controller, or `(T + 1, n)` with those after the last period; the first `n_r` of the
            states are tracked.
        inputs: `(T, n_u)` per controller, in [-1, 1]; adds one panel per input, in its own unit.
        names: The states.
        signature: tells the units of states, and inputs with their units and ranges.
        title: of the figure.
        settling: Whether a reference that stays has what the step metrics use: the settling band and the final seconds.
    """
    seconds = style.array(time)
    target = np.zeros((len(seconds), 0)) if reference is None else style.array(reference)
    inputs = inputs or {}
    names = names[: max(target.shape[1], MOST)]
    moving = signature.input_names if inputs else ()
    units = [signature.state_units[signature.state_index(name)] for name in names]
    figure, axes = style.time_panels([*names, *moving], [*units, *("-" for _ in moving)], title)
    settling = settling and bool(target.size and (target == target[0]).all())
    for i, axis in enumerate(axes[: len(names)]):
        if i < target.shape[1]:
            look: Any = {"color": style.BLACK, "linestyle": "--", "linewidth": 1.2}
            axis.plot(_row_times(seconds, target), target[:, i], label="reference", **look)
        for (of, y), look in zip(outputs.items(), style.line_styles(outputs).values(), strict=True):
            axis.plot(_row_times(seconds, style.array(y)), style.array(y)[:, i], label=of, **look)
        if settling and i < target.shape[1]:
            # The band in which the step metrics call it settled.
            aim = float(target[0, i])
            half = SETTLING_BAND * max((abs(aim - float(style.array(y)[0, i])) for y in outputs.values()), default=0.0)
            axis.axhspan(
                aim - half, aim + half, color=style.GREY, alpha=0.2, lw=0, label=f"{100 * SETTLING_BAND:g} % band"
            )
    for i, axis in enumerate(axes[len(names) :]):
        for (of, u), look in zip(inputs.items(), style.line_styles(inputs).values(), strict=True):
            style.draw_input(axis, seconds, style.array(u), signature, i, linewidth=1.0, label=of, **look)
    start, end = style.time_span(seconds)
    style.time_axis(figure, (start, end))
    if settling and len(seconds) > 1 and not style.cut_time(figure):
        steady = steady_seconds(float(seconds[1] - seconds[0]), len(seconds))
        text = f"steady state: last {format_duration(steady, longest=end - start, digits=3)}"
        for axis in axes[: target.shape[1]]:
            axis.axvspan(end - steady, end, color=style.GREY, alpha=0.08, lw=0, label=text)
    style.legend(axes[0], below=True)
    return figure


@style.styled
def _error_fan(evaluation: Evaluation, title: str) -> Figure:
    """Draw the absolute error over all references: median, middle half, 5 to 95 %."""
    seconds, names, units = style.array(evaluation.time), evaluation.output_names, [*evaluation.units.values()]
    error = np.abs(style.array(evaluation.outputs) - style.array(evaluation.references))
    p05, p25, p50, p75, p95 = np.quantile(error, (0.05, 0.25, 0.5, 0.75, 0.95), axis=0)
    figure, axes = style.panels(len(names), 1, (7.0, 2.2 * len(names) + 0.5), f"{title} ({len(error)})")
    for i, (axis, name, unit, box) in enumerate(zip(axes, names, units, evaluation.boxes, strict=True)):
        axis.fill_between(seconds, p05[:, i], p95[:, i], color=style.BLUE, alpha=0.15, lw=0, label="5 to 95 %")
        axis.fill_between(seconds, p25[:, i], p75[:, i], color=style.BLUE, alpha=0.3, lw=0, label="middle half")
        axis.plot(seconds, p50[:, i], color=style.BLUE, label="median")
        axis.set_yscale("log")
        axis.set_ylim(bottom=1e-5 * box)
        axis.set_ylabel(f"|error| of {style.label(name, unit)}")
    style.legend(axes[0], below=True)
    style.time_axis(figure, style.time_span(seconds))
    return figure


@style.styled
def draw_evaluation(
    evaluation: Evaluation,
    folder: Path,
    label: str = "policy",
    formats: Sequence[str] = ("png",),
    place: str = "",
) -> list[Path]:
    """Draw an evaluation into a folder, in files that begin with the scenario's name.

    One episode is drawn over time and, of several ones, the spread of the error. Titles say which episode is shown, and
    where it was flown, unless on the plant.

    Args:
        evaluation: What to draw.
        folder: Where; made if missing.
        label: Name of the controller in the legend.
        formats: File formats, e.g. ("png", "svg").
        place: Where it was flown, unless on the plant, such as "on a model".

    Returns:
        The files.
    """
    row, words = evaluation.representative_episode
    name, signature = evaluation.scenario, evaluation.signature
    scenario = f"Scenario '{name}'{place and f' {place}'}"
    title = "\n".join(filter(None, [scenario, words]))
    states, following = evaluation.trajectory["state"], evaluation.trajectory["next", "state"]
    x = torch.cat([states[row], following[row, -1:]])  # and the state after the last period
    columns = evaluation.state_order
    names = [signature.state_names[k] for k in columns]
    reference = evaluation.references[row] if evaluation.columns else None
    target = None if reference is None else torch.cat([reference, reference[-1:]])
    inputs = {label: evaluation.inputs[row]}
    figures = {name: tracking(evaluation.time, target, {label: x[:, columns]}, inputs, names, signature, title)}
    if evaluation.columns and len(evaluation.outputs) > 1:
        figures[f"{name}_errors"] = _error_fan(evaluation, f"{scenario}: error over all references")
    for figure in figures.values() if evaluation.windows else ():
        for axis in figure.axes:
            for start, end in evaluation.windows:
                axis.axvspan(start, end, color=style.ORANGE, alpha=0.2, lw=0, label="disturbed")
        style.legend(figure.axes[0], below=True)
    return style.save_figures(figures, folder, formats)


def draw_session(session: Session) -> list[Path]:
    """Draw the excitations of a rig, and each flight with its references and what ended it early.

    Args:
        session: Whose folder gets the figures, into `figures/`.

    Returns:
        The files.
    """
    figures = {}
    for path, rows in session.logs("excitation").items():
        if rows:
            flown = session.flights.get(path.stem)  # what ended one of an earlier session is not known
            ended = f", ended by {flown.ended}" if flown is not None and flown.ended else ""
            title = f"{path.stem.replace('_', ' ').capitalize()} of the rig{ended}"
            figures[path.stem] = training_data(*session.samples(path), session.wiring.signature, title)
    for name, shown in session.shown.items():
        if len(shown.time):  # it did not end before its first sample
            figures[name] = _draw_flight(shown, session.wiring, name)
    return style.save_figures(figures, session.folder / "figures")


@style.styled
def _draw_flight(shown: FlightRecord, wiring: Wiring, name: str) -> Figure:
    """Draw a flight on the time that was planned for it."""
    measured = {"measured": shown.outputs}
    planned = max(shown.planned, len(shown.time)) * wiring.dt
    title = f"{name.replace('_', ' ').capitalize()} on the rig"
    ended = float(shown.time[-1]) + wiring.dt
    if shown.fault:
        title += f", ended after {format_duration(ended, planned)} of {format_duration(planned)} by {shown.fault}"
    inputs = {"measured": shown.inputs}
    figure = tracking(shown.time, shown.references, measured, inputs, shown.names, wiring.signature, title, False)
    for column, axis in enumerate(figure.axes[: len(shown.names)]):
        if np.isnan(shown.outputs[:, column]).all():
            axis.text(0.5, 0.5, "not measured", transform=axis.transAxes, ha="center", va="center", color=style.GREY)
        for line in axis.lines:
            if line.get_label() == "reference":  # a target is held, and the next one follows at once
                line.set_drawstyle("steps-post")
            else:  # a line shows nothing of a sample between two that were lost
                line.set(marker=".", markersize=2.0)
    for axis in figure.axes:
        if shown.fault:
            axis.axvline(ended, color=style.RED, linewidth=1.0, label="ended, safe input")
    style.time_axis(figure, (0.0, planned))
    figure.axes[-1].set_xlim(right=planned * (1 + LATE * bool(shown.fault)))
    style.legend(figure.axes[0], below=True)
    return figure


def _row_times(seconds: style.Array, rows: style.Array) -> style.Array:
    """Return the times of rows, the last of which may be a row after the last control period."""
    return seconds if len(rows) <= len(seconds) else np.append(seconds, style.time_span(seconds)[1])
