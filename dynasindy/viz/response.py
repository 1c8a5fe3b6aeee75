"""How a controlled plant responds: steps, sines and squares, and the error over many references."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dynasindy.evaluation.metrics import SETTLING_BAND, steady_seconds
from dynasindy.systems import Signature
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.text import format_duration
from dynasindy.viz.controllers import line_styles
from dynasindy.viz.style import (
    BLACK,
    BLUE,
    GREY,
    Array,
    array,
    input_axis,
    label,
    legend_above,
    panels,
    styled,
    time_axis,
    time_span,
    zero_order_hold,
)

AXES = SIGNATURE.state_names[:2]
LEAST = 1e-5
"""Errors below this part of the band that is paid for are not drawn: ten millionths of a radian for the twin rotor."""


@styled
def tracking(
    time: ArrayLike,
    reference: ArrayLike | None,
    outputs: Mapping[str, ArrayLike],
    inputs: Mapping[str, ArrayLike] | None = None,
    names: Sequence[str] = AXES,
    signature: Signature = SIGNATURE,
    title: str = "",
) -> Figure:
    """Draw the tracked axes of one or several controllers against the same reference.

    Args:
        time: `(T,)` at which each control period begins [s].
        reference: `(T, n_r)`, or as many rows as the outputs; None of a task that has none.
        outputs: `(T, n_r)` per controller, or `(T + 1, n_r)` with those after the last period.
        inputs: `(T, n_u)` per controller, in [-1, 1]; adds one panel per input, in its own unit.
        names: tracked states, with their units unless these are rad: `height [m]`.
        signature: tells the inputs, their units and ranges.
        title: of the figure.
    """
    seconds, target = array(time), None if reference is None else array(reference)
    inputs = inputs or {}
    n_u = signature.n_u if inputs else 0
    figure, axes = panels(len(names) + n_u, 1, (7.0, 2.1 * len(names) + 1.4 * n_u + 0.5), title)
    for i, name in enumerate(names):
        if target is not None:
            look: Any = {"color": BLACK, "linestyle": "--", "linewidth": 1.2}
            axes[i].plot(_row_times(seconds, target), target[:, i], label="reference", **look)
        _lines(axes[i], seconds, outputs, i)
        axes[i].set_ylabel(label(*_with_unit(name)))
    for i in range(n_u):
        _inputs(axes[len(names) + i], seconds, inputs, i, signature)
    legend_above(axes[0])
    time_axis(axes[-1], time_span(seconds))
    axes[-1].set_xlim(*time_span(seconds))
    return figure


@styled
def step_response(
    time: ArrayLike,
    reference: ArrayLike,
    outputs: Mapping[str, ArrayLike],
    inputs: Mapping[str, ArrayLike] | None = None,
    names: Sequence[str] = AXES,
    signature: Signature = SIGNATURE,
    title: str = "Step response",
) -> Figure:
    """Draw `tracking` with what the step metrics use: the settling band and the final seconds."""
    figure = tracking(time, reference, outputs, inputs, names, signature, title)
    seconds, target = array(time), array(reference)
    steady = steady_seconds(float(seconds[1] - seconds[0]), len(seconds)) if len(seconds) > 1 else 0.0
    for i, axis in enumerate(figure.axes[: len(names)]):
        starts = [array(y)[0, i] for y in outputs.values()]
        half = SETTLING_BAND * max((abs(target[-1, i] - start) for start in starts), default=0.0)
        band = f"{100 * SETTLING_BAND:g} % band"
        axis.axhspan(target[-1, i] - half, target[-1, i] + half, color=GREY, alpha=0.2, lw=0, label=band)
        start, end = time_span(seconds)
        text = f"steady state: last {format_duration(steady, longest=end - start, digits=3)}"
        axis.axvspan(end - steady, end, color=GREY, alpha=0.08, lw=0, label=text)
    legend_above(figure.axes[0])
    return figure


@styled
def error_fan(
    time: ArrayLike,
    outputs: ArrayLike,
    references: ArrayLike,
    names: Sequence[str] = AXES,
    title: str = "Tracking error over all references",
    band: Sequence[float] = (0.01,),
) -> Figure:
    """Draw the absolute error over a batch of references: median, middle half and 5 to 95 %.

    Args:
        time: `(T,)` [s].
        outputs: `(N, T, n_r)`.
        references: `(N, T, n_r)`.
        names: tracked states, with their units unless these are rad.
        title: of the figure.
        band: half width of the band that is paid for, of each output or of all.
    """
    seconds = array(time)
    error = np.abs(array(outputs) - array(references))
    bands = np.broadcast_to(np.asarray(band, dtype=np.float64), len(names))
    p05, p25, p50, p75, p95 = np.quantile(error, (0.05, 0.25, 0.5, 0.75, 0.95), axis=0)
    figure, axes = panels(len(names), 1, (7.0, 2.2 * len(names) + 0.5), f"{title} ({len(error)})")
    for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
        axis.fill_between(seconds, p05[:, i], p95[:, i], color=BLUE, alpha=0.15, lw=0, label="5 to 95 %")
        axis.fill_between(seconds, p25[:, i], p75[:, i], color=BLUE, alpha=0.3, lw=0, label="middle half")
        axis.plot(seconds, p50[:, i], color=BLUE, label="median")
        unit = _with_unit(name)[1]
        least_paid = " ".join([f"{bands[i]:.3g}", *([unit] if unit != "-" else [])])
        text = f"the reward pays a bonus below {least_paid}"
        axis.axhline(bands[i], color=BLACK, linestyle=":", linewidth=1.0, label=text)
        axis.set_yscale("log")
        # The middle half stays inside, and the wide band nearly all the time; what is less, or zero, leaves the axis
        # and is not laid flat on a floor.
        inner, outer = p25[:, i], p05[p05[:, i] > 0, i]
        least = float(inner.min(where=inner > 0, initial=bands[i]))
        least = min(least, float(np.quantile(outer, 0.1))) if len(outer) else least
        axis.set_ylim(bottom=0.5 * max(least, LEAST * float(bands[i])))
        axis.set_ylabel(f"|error| of {label(*_with_unit(name))}")
    legend_above(axes[0])
    time_axis(axes[-1], time_span(seconds))
    axes[-1].set_xlim(*time_span(seconds))
    return figure


def _with_unit(name: str) -> tuple[str, str]:
    """Return the name and the unit of `name [unit]`."""
    bare, _, unit = name.partition(" [")
    return bare, unit.removesuffix("]") or "rad"


def _row_times(seconds: Array, rows: Array) -> Array:
    """Return the times of rows, the last of which may be a row after the last control period."""
    return seconds if len(rows) <= len(seconds) else np.append(seconds, time_span(seconds)[1])


def _lines(axis: Axes, seconds: Array, outputs: Mapping[str, ArrayLike], column: int) -> None:
    for (name, values), look in zip(outputs.items(), line_styles(outputs).values()):
        rows = array(values)
        axis.plot(_row_times(seconds, rows), rows[:, column], label=name, **look)


def _inputs(axis: Axes, seconds: Array, inputs: Mapping[str, ArrayLike], column: int, signature: Signature) -> None:
    for (of, values), look in zip(inputs.items(), line_styles(inputs).values()):
        # Zero-order hold: the input is constant until the next sample, the last one until the end.
        own = signature.in_own_units(array(values))[:, column]
        axis.step(*zero_order_hold(seconds, own), where="post", linewidth=1.0, label=of, **look)
    input_axis(axis, signature, column)
