"""What the model was fitted to and how well it predicts: inputs, training data, prediction, coefficients."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.response import INPUTS
from dynasindy.viz.style import (
    BLACK,
    BLUE,
    GREY,
    RED,
    Array,
    array,
    held,
    label,
    legend_beside,
    name_single,
    panels,
    span,
    styled,
    symbol,
)

STATES = SIGNATURE.state_names
UNITS = SIGNATURE.state_units
BEYOND = 0.6
"""A prediction is drawn as far as this part of the plant's own range beyond it."""


@styled
def excitation(time: ArrayLike, u: ArrayLike, input_names: Sequence[str] = INPUTS, title: str = "Excitation") -> Figure:
    """Draw the excitation signal, `(T, n_u)` in [-1, 1], over `time` `(T,)` [s]."""
    seconds, values = array(time), array(u)
    figure, axes = panels(len(input_names), 1, (7.0, 1.5 * len(input_names) + 0.6), title)
    for i, (axis, name) in enumerate(zip(axes, input_names, strict=True)):
        axis.step(*held(seconds, values[:, i]), where="post", color=BLUE)
        axis.set_ylim(-1.08, 1.08)
        axis.set_ylabel(label(name, "-"))
    _finish(axes, 1, seconds)
    return figure


@styled
def training_data(
    time: ArrayLike,
    x: ArrayLike,
    names: Sequence[str] = STATES,
    units: Sequence[str] = UNITS,
    title: str = "Training data",
    segment: ArrayLike | None = None,
) -> Figure:
    """Draw the states `(T, n_x)` that the model was fitted to over `time` `(T,)` [s].

    Args:
        time: `(T,)` [s].
        x: `(T, n_x)` states.
        names: states.
        units: their units.
        title: of the figure.
        segment: `(T,)` number of the unbroken stretch of each sample; lines break between them.
    """
    seconds, values = array(time), array(x)
    figure, axes, columns = _states(names, units, title)
    for i in range(len(names)):
        axes[i].plot(_broken(seconds, segment), _broken(values[:, i], segment), color=BLUE)
    _finish(axes, columns, seconds, segment)
    return figure


@styled
def prediction(
    time: ArrayLike,
    real: ArrayLike,
    predicted: ArrayLike,
    names: Sequence[str] = STATES,
    units: Sequence[str] = UNITS,
    title: str = "Model prediction against the real plant",
    segment: ArrayLike | None = None,
) -> Figure:
    """Draw free-running prediction against the real plant, each panel with its error in percent of the range.

    Args:
        time: `(T,)` [s].
        real: `(T, n_x)` states of the plant.
        predicted: `(T, n_x)` states of the model under the same input; what is not finite is left out.
        names: states.
        units: their units.
        title: of the figure.
        segment: `(T,)` number of the unbroken stretch of each sample; lines break between them.
    """
    seconds, truth, model = array(time), array(real), array(predicted)
    figure, axes, columns = _states(names, units, title)
    for i in range(len(names)):
        wide = truth[:, i].max() - truth[:, i].min()
        x, real, free = (_broken(v, segment) for v in (seconds, truth[:, i], model[:, i]))
        axes[i].plot(x, real, color=BLACK, linewidth=1.2, label="real")
        axes[i].plot(x, free, color=RED, linestyle=":", linewidth=1.8, label="predicted")
        axes[i].set_title(_fit(truth[:, i], model[:, i], wide), fontsize=8.5, loc="right")
        if wide > 0:
            # A model that runs away must not flatten the plant's own curve.
            axes[i].set_ylim(truth[:, i].min() - BEYOND * wide, truth[:, i].max() + BEYOND * wide)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    _finish(axes, columns, seconds, segment)
    return figure


@styled
def model_error(
    episode: ArrayLike,
    error: ArrayLike,
    refits: ArrayLike | None = None,
    what: str = "reward error, |real - model|",
    title: str = "SINDy model learning progress",
    thresholds: Mapping[str, float] | None = None,
) -> Figure:
    """Draw the model's error over real episodes on a log axis, with a tick at each refit.

    Args:
        episode: `(n,)` real episodes.
        error: `(n,)` or `(n, k)` error of the model; several columns are drawn as median and range.
        refits: episodes after which the model was fitted anew.
        what: the error in words, the label of the axis.
        title: of the figure.
        thresholds: levels that the error is compared with, in words; drawn as lines.
    """
    x, y = array(episode), array(error)
    # Zero has no place on a log axis: it is drawn on the floor.
    y = np.maximum(y.reshape(len(y), -1), 1e-12)
    figure, (axis,) = panels(1, 1, (7.0, 3.2), title)
    axis.plot(x, np.median(y, axis=1), color=RED, marker="o", markersize=2.5, linewidth=1.0)
    name_single(axis, x, np.median(y, axis=1), RED)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axis.set_xlim(x.min(initial=1.0) - 0.5, x.max(initial=1.0) + 0.5)
    if y.shape[1] > 1:
        axis.fill_between(x, y.min(1), y.max(1), color=RED, alpha=0.2, linewidth=0)
    for k, at in enumerate([] if refits is None else array(refits)):
        axis.axvline(at, color=GREY, linestyle=":", linewidth=0.8, label="model refitted" if k == 0 else None)
    if refits is not None and len(array(refits)):
        axis.legend(loc="upper right")
    axis.set_yscale("log")
    for (words, level), line in zip((thresholds or {}).items(), cycle((":", "--"))):
        axis.axhline(level, color=BLACK, linestyle=line, linewidth=0.9, label=f"{words} {level:g}")
    if thresholds:
        legend_beside(axis)
    axis.set_xlabel("real episode")
    axis.set_ylabel(f"{what} [-]")
    return figure


@styled
def growing_error(time: ArrayLike, error: ArrayLike, title: str = "Open-loop error along the first episode") -> Figure:
    """Draw the error of a prediction that sees nothing after its start, on a log axis.

    Args:
        time: `(n,)` [s] since the start.
        error: `(n,)` distance of predicted and real states [ranges of the states].
        title: of the figure.
    """
    figure, (axis,) = panels(1, 1, (7.0, 3.2), title)
    axis.plot(array(time), np.maximum(array(error), 1e-12), color=RED, linewidth=1.0)
    axis.set_yscale("log")
    axis.set_xlim(0.0, array(time).max(initial=0.0) or 1.0)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("state error [ranges]")
    return figure


@styled
def coefficient_table(
    coefficients: ArrayLike,
    feature_names: Sequence[str],
    state_names: Sequence[str] = STATES,
    title: str = r"SINDy model $\Xi$",
) -> Figure:
    """Draw the coefficients `(n_features, n_x)` as a table; features that no state uses are left out."""
    values = array(coefficients)
    used = [int(k) for k in np.flatnonzero((values != 0).any(axis=1))]
    rows = [[f"{v:.4g}" if v else "" for v in values[k]] for k in used] or [[""] * len(state_names)]
    figure, (axis,) = panels(1, 1, (1.3 * (len(state_names) + 1.5), 0.28 * (len(rows) + 2) + 0.3), title)
    axis.axis("off")
    table = axis.table(
        cellText=rows,
        rowLabels=[feature_names[k] for k in used] or ["(none)"],
        colLabels=[rf"d{symbol(name)}/dt" for name in state_names],
        cellColours=[["#dcebf5" if text else "white" for text in row] for row in rows],
        loc="center",
        bbox=(0.0, 0.0, 1.0, 1.0),  # type: ignore[arg-type]  # the stubs forget sequences
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8.5)
    for cell in table.get_celld().values():
        cell.set_edgecolor("#bfbfbf")
    return figure


def _states(names: Sequence[str], units: Sequence[str], title: str) -> tuple[Figure, list[Axes], int]:
    columns = 2 if len(names) > 3 else 1
    rows = -(-len(names) // columns)
    figure, axes = panels(rows, columns, (9.0 if columns > 1 else 7.0, 1.9 * rows + 0.5), title)
    for axis, name, unit in zip(axes, names, units, strict=False):
        axis.set_ylabel(label(name, unit))
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    return figure, axes, columns


def _broken(values: Array, segment: ArrayLike | None) -> Array:
    """Put a NaN between segments, at which a line breaks."""
    if segment is None:
        return values
    return np.insert(values, np.flatnonzero(np.diff(array(segment))) + 1, np.nan)


def _finish(axes: Sequence[Axes], columns: int, seconds: Array, segment: ArrayLike | None = None) -> None:
    gaps = segment is not None and bool(np.diff(array(segment)).any())
    for axis in axes[-columns:]:
        axis.set_xlabel("time without the gaps [s]" if gaps else "time [s]")
    axes[0].set_xlim(*span(seconds))


def _fit(real: Array, predicted: Array, wide: float) -> str:
    if not np.isfinite(predicted).all():
        return "runs away"
    rmse = float(np.sqrt(np.mean((real - predicted) ** 2)))
    if not wide > 0:
        return f"RMSE {rmse:.2g}"
    percent = 100 * rmse / wide
    cut = (predicted.max() - real.max() > BEYOND * wide) or (real.min() - predicted.min() > BEYOND * wide)
    words = f"{percent:.0f}" if percent >= 99.5 else f"{percent:.2g}"
    return f"RMSE {words} % of range" + ", cut off" * bool(cut)
