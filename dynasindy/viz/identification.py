"""What the model was fitted to and how well it predicts: inputs, training data, prediction, coefficients."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dynasindy.identification.identify import Identified
from dynasindy.systems import Signature
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.text import unit_suffix
from dynasindy.viz import style

BEYOND = 0.6
"""A prediction is drawn as far as this part of the plant's own range beyond it."""
MARGIN = 0.06
"""Room above and below what is drawn, of the plant's own range."""
LOST = 10.0
"""A prediction ends where it is off by more than this part of the range."""
GAP = "samples missing or left out, or another recording"
MOST = 50
"""More gaps than these are not marked, as the marks would hide the data."""


def draw_identification(found: Identified, folder: Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw the data that a model was fitted to, and its prediction of those that the fit did not see.

    Returns:
        The files.
    """
    training, validation, names = found.source.training, found.source.validation, found.source.signature
    truth = "log" if found.source.logged else "plant"
    title = "Free-running prediction of unseen data"
    time, later = (np.arange(len(data)) * data.dt for data in (training, validation))
    figures = {"training_data": training_data(time, training.x, training.u, names, segment=training.segment)}
    if len(validation):
        shown = later, validation.x_next, found.predicted, names, title, validation.segment, truth
        figures["prediction"] = prediction(*shown, u=validation.u)
    return style.save_figures(figures, folder, formats)


@style.styled
def training_data(
    time: ArrayLike,
    x: ArrayLike,
    u: ArrayLike,
    signature: Signature = SIGNATURE,
    title: str = "Training data",
    segment: ArrayLike | None = None,
) -> Figure:
    """Draw the states that the model was fitted to and the inputs that moved them, over time.

    Marked are where the excitation ended early and began anew, a row without inputs, and where a log has a gap. States
    that are NaN where the inputs are known are samples that were lost, and are not marked.

    Args:
        time: `(T,)` [s].
        x: `(T, n_x)` states.
        u: `(T, n_u)` inputs in [-1, 1], each held to the next sample, NaN where they began anew.
        signature: Names and units.
        title: of the figure.
        segment: `(T,)` number of the unbroken stretch of each sample; lines break between them.
    """
    seconds, values, moving = style.array(time), style.array(x), style.array(u)
    seen, title = _seen(values, signature, title)
    names = (*(signature.state_names[i] for i in seen), *signature.input_names)
    units = (*(signature.state_units[i] for i in seen), *("-",) * signature.n_u)
    figure, axes = style.time_panels(names, units, title)
    times, shown, held = (_broken(rows, segment) for rows in (seconds, values, moving))
    for axis, i in zip(axes, seen, strict=False):
        axis.plot(times, shown[:, i], color=style.BLUE)
    for i, axis in enumerate(axes[len(seen) : len(names)]):
        style.draw_input(axis, times, held, signature, i, color=style.BLUE)
    restarts = seconds[np.isnan(moving).any(-1)]  # not all, which is true of a row without inputs
    _mark(axes, restarts, color=style.RED, linestyle="--", linewidth=1.0, label="ended early, began anew")
    _finish(figure, seconds, segment)
    return figure


@style.styled
def prediction(
    time: ArrayLike,
    real: ArrayLike,
    predicted: ArrayLike,
    signature: Signature = SIGNATURE,
    title: str = "Model prediction against the plant",
    segment: ArrayLike | None = None,
    truth: str = "real",
    u: ArrayLike | None = None,
) -> Figure:
    """Draw free-running prediction of measured states against the plant, each panel with its error, and the inputs.

    The error is told in percent of the range, the largest minus the smallest value, of the plant's own curve in that
    panel, and how wide that is.

    Args:
        time: `(T,)` [s].
        real: `(T, n_x)` states of the plant, or as a log has them; NaN of a state without a sensor.
        predicted: `(T, n_x)` states of the model under the same input; what is not finite is left out.
        signature: Names and units of the states.
        title: of the figure.
        segment: `(T,)` number of the unbroken stretch of each sample; lines break between them.
        truth: What the model is compared with: "real" states, the "plant", or a "log".
        u: `(T, n_u)` inputs in [-1, 1], each held up to the time of its row, below the states; none if omitted.
    """
    seconds, truths, model = style.array(time), style.array(real), style.array(predicted)
    x = _broken(seconds, segment)
    whose = "the real range" if truth == "real" else f"the {truth}'s range"
    seen, title = _seen(truths, signature, title)
    names, units = ([kind[i] for i in seen] for kind in (signature.state_names, signature.state_units))
    inputs = () if u is None else signature.input_names
    figure, axes = style.time_panels([*names, *inputs], [*units, *("-" for _ in inputs)], title)
    for axis, unit, course, ended in zip(axes[: len(seen)], units, truths[:, seen].T, model[:, seen].T, strict=True):
        known = course[~np.isnan(course)]
        wide = float(np.ptp(known))
        whole = (f"{wide:.0f}" if wide >= 100 else f"{wide:.3g}") + unit_suffix(unit)
        axis.set_title(_fit(course, ended, f"{whole}, {whose}"), fontsize=8.5, loc="right")
        with np.errstate(invalid="ignore"):  # what follows a loss would only streak the panel
            lost = (np.abs(ended - course) > LOST * wide) & (wide > 0)
        ended = np.where(np.logical_or.accumulate(lost | ~np.isfinite(ended)), np.nan, ended)
        axis.plot(x, _broken(course, segment), color=style.BLACK, linewidth=1.2, label=truth)
        axis.plot(x, _broken(ended, segment), color=style.RED, linestyle=":", linewidth=1.8, label="predicted")
        if wide > 0:
            # A model that runs away must not flatten the plant's own curve.
            both, room = np.concatenate([known, ended[np.isfinite(ended)]]), (BEYOND - MARGIN) * wide
            low, high = max(both.min(), known.min() - room), min(both.max(), known.max() + room)
            axis.set_ylim(float(low - MARGIN * wide), float(high + MARGIN * wide))
    if u is not None:
        begin = x - np.diff(seconds[:2]).sum()
        for i, axis in enumerate(axes[len(seen) :]):
            style.draw_input(axis, begin, _broken(style.array(u), segment), signature, i, color=style.BLUE)
    _finish(figure, seconds, segment)
    return figure


def _seen(states: style.Array, signature: Signature, title: str) -> tuple[list[int], str]:
    """Return which states were measured, and a title that names the others."""
    seen = np.flatnonzero(~np.isnan(states).all(0)).tolist()
    unseen = [name for i, name in enumerate(signature.state_names) if i not in seen]
    return seen, f"{title}; not measured: {', '.join(unseen)}" if unseen else title


def _mark(axes: Sequence[Axes], places: style.Array, **look: Any) -> None:
    for place in places:
        for axis in axes:
            axis.axvline(place, **look)


def _breaks(segment: ArrayLike | None) -> list[int]:
    """Return the first samples of all stretches but the first."""
    return [] if segment is None else (np.flatnonzero(np.diff(style.array(segment))) + 1).tolist()


def _broken(values: style.Array, segment: ArrayLike | None) -> style.Array:
    """Put a row of NaN between segments, at which a line breaks."""
    return np.insert(values, _breaks(segment), np.nan, axis=0)


def _finish(figure: Figure, seconds: style.Array, segment: ArrayLike | None) -> None:
    """Mark where samples are missing or left out, unless that is everywhere, and name what the axes show."""
    breaks = _breaks(segment)
    if len(breaks) <= MOST:
        _mark(figure.axes, seconds[breaks], color=style.GREY, linestyle=":", linewidth=0.9, label=GAP)
    style.legend(figure.axes[0], below=True)
    style.time_axis(figure, style.time_span(seconds), "time without the gaps" if breaks else "time")


def _fit(real: style.Array, predicted: style.Array, whole: str) -> str:
    """Return the error of a prediction in words, in percent of the range of what it predicts, which is `whole`."""
    seen, finite = ~np.isnan(real), bool(np.isfinite(predicted).all())
    real, predicted = real[seen], predicted[seen]
    with np.errstate(over="ignore", invalid="ignore"):
        rmse, wide = float(np.sqrt(np.mean((real - predicted) ** 2))), float(np.ptp(real))
    if not finite or not np.isfinite(rmse):
        return "runs away"
    if not wide > 0:
        return f"RMSE {rmse:.2g}"
    percent = 100 * rmse / wide
    cut = (predicted.max() - real.max() > BEYOND * wide) or (real.min() - predicted.min() > BEYOND * wide)
    digits = ".0f" if 99.5 <= percent < 1e6 else ".2g"
    return f"RMSE {percent:{digits}} % of {whole}" + ", cut off" * bool(cut)
