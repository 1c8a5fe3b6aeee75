"""How wrong the model is over real episodes, and what the gate decides by it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from dynasindy.viz.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    RED,
    Array,
    array,
    label_decades,
    legend_beside,
    panels,
    styled,
    time_axis,
)

CLEAR = 1.1
"""An end of an axis lies beyond every value by this factor at least: what lies on the frame is not seen."""
TYPICAL = "typical ranges"
"""Unit of an error of all states together, each of which counts by its typical range, `Signature.x_scale`."""
DOTS: Mapping[str, Any] = {"marker": "o", "markersize": 3, "clip_on": False}


@styled
def gate(
    decisions: Mapping[str, ArrayLike],
    title: str = "Trust in the model",
    unit: str = "reward per period",
) -> Figure:
    """Draw the reward error with its thresholds, shaded while the gate is closed, and the test of each refit.

    A replay that ran away is marked at the upper edge.

    Args:
        decisions: The columns of `gate.csv`, `(n_episodes,)` each: `episode`; `reward_error` per control period of the
            whole episode, replayed through the model before its refit; `judged_reward_error` of the model that stays,
            on held-out windows, NaN where no planning was due; the thresholds `open_below` and `close_above`; `open`,
            1 or 0; and of the refit `held_out_error_before`, `held_out_error_after` and `refit_kept`, NaN without a
            test.
        title: of the figure.
        unit: of the reward error.
    """
    columns = {name: array(values) for name, values in decisions.items()}
    x, whole, judged = (columns[name] for name in ("episode", "reward_error", "judged_reward_error"))
    before, after, back = columns["held_out_error_before"], columns["held_out_error_after"], columns["refit_kept"] == 0
    figure, (upper, lower) = panels(2, 1, (8.5, 5.0), title)
    upper.plot(x, whole, color=GREY, label="whole episode, before the refit", **DOTS)
    upper.plot(x, judged, color=BLUE, label="held-out windows, judged", **DOTS)
    # Half an episode to each side, as the shade of a closed one is as wide.
    wide = np.concatenate([x[:1] - 0.5, x, x[-1:] + 0.5])
    for name, line, words in (("open_below", ":", "trusted below"), ("close_above", "--", "no longer trusted above")):
        bound = np.pad(columns[name], 1, mode="edge")
        upper.plot(wide, bound, color=BLACK, linestyle=line, linewidth=0.9, label=f"{words} {columns[name][0]:g}")
    for closed in x[columns["open"] == 0]:
        upper.axvspan(closed - 0.5, closed + 0.5, color=GREY, alpha=0.25, linewidth=0, label="model not trusted")
    lower.plot(x, before, color=ORANGE, label="before the refit", **DOTS)
    lower.plot(x, after, color=BLUE, label="after the refit", **DOTS)
    ring: dict[str, Any] = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "linestyle": "none"}
    if back.any():
        lower.plot(x[back], after[back], color=RED, label="rolled back", clip_on=False, **ring)
    _limit(upper, np.concatenate([whole, judged, columns["open_below"], columns["close_above"]]))
    _limit(lower, np.concatenate([before, after]))
    _mark_divergence(upper, x[~np.isfinite(whole)], GREY)
    _mark_divergence(upper, x[np.isinf(judged)], BLUE)
    lower.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    lower.set_xlim(wide[0], wide[-1])
    lower.set_xlabel("real episode")
    upper.set_ylabel(f"reward error\n[{unit}]")
    lower.set_ylabel(f"held-out state error\n[{TYPICAL}]")
    for axis in (upper, lower):
        legend_beside(axis)
    return figure


@styled
def growing_error(time: ArrayLike, error: ArrayLike) -> Figure:
    """Draw the error of a prediction that sees nothing after its start, on a log axis.

    Args:
        time: `(n,)` [s] since the start.
        error: `(n,)` distance of predicted and real states [typical ranges of the states].
    """
    figure, (axis,) = panels(1, 1, (7.0, 3.2), "Open-loop error along the first episode")
    _draw_positive(axis, array(time), array(error))
    legend_beside(axis)
    axis.set_xlim(0.0, array(time).max(initial=0.0) or 1.0)
    time_axis(axis, time)
    axis.set_ylabel(f"RMS error of the states\n[{TYPICAL}]")
    return figure


def _draw_positive(axis: Axes, x: Array, y: Array, **look: Any) -> None:
    """Draw a curve on a logarithmic axis: a zero is a mark below it, and has no line."""
    zero, seen = y == 0, y[(y > 0) & np.isfinite(y)]
    axis.plot(x, np.where(zero, np.nan, y), color=RED, linewidth=1.0, **look)
    if zero.any():
        below = np.full(zero.sum(), 0.5 * float(seen.min()) if len(seen) else 1.0)
        axis.plot(
            x[zero], below, color=RED, marker="v", markersize=4, linestyle="none", label="exactly 0, below the axis"
        )
    axis.set_yscale("log")


def _mark_divergence(axis: Axes, x: Array, color: str) -> None:
    """Mark at the upper edge of an axis, whose limits end with this, where an error was not finite."""
    low, top = axis.get_ylim()
    axis.set_ylim(low, top)
    if len(x):
        look: dict[str, Any] = {"marker": "^", "markersize": 6, "linestyle": "none", "clip_on": False, "zorder": 3}
        axis.plot(x, np.full(len(x), top), color=color, label="ran away, above the axis", **look)


def _limit(axis: Axes, values: Array) -> None:
    """End a logarithmic axis at the next of 1, 2, 5, 10, 20, ... clearly below and above positive values."""
    seen = values[np.isfinite(values) & (values > 0)]
    if len(seen):
        powers = 10.0 ** np.arange(np.floor(np.log10(seen.min())) - 1, np.ceil(np.log10(seen.max())) + 2)
        steps = np.outer(powers, (1.0, 2.0, 5.0)).ravel()
        # The factors of the powers of ten are not exact in the last digits.
        low = float(steps[steps <= seen.min() / CLEAR * (1 + 1e-9)][-1])
        axis.set_yscale("log")
        axis.set_ylim(low, float(max(steps[steps >= seen.max() * CLEAR * (1 - 1e-9)][0], 5 * low)))
        label_decades(axis.yaxis)
