"""What the gate saw and decided, and what became of each refit."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import ArrayLike

from dynasindy.viz.identification import CLOSES, EPISODE, JUDGED, OPENS, TYPICAL
from dynasindy.viz.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    RED,
    Array,
    array,
    draw_named_values,
    legend_beside,
    mark_divergence,
    panels,
    styled,
)

FEW_DECADES = 1000.0
"""Ends of an axis nearer to each other than this factor have few powers of ten between them."""
BESIDE = 0.2
"""Room for the number beside the last dot, as a share of the decades between the first and the last dot."""
CLEAR = 1.1
"""An end of an axis lies beyond every value by this factor at least: what lies on the frame is not seen."""


@styled
def gate(
    decisions: Mapping[str, ArrayLike],
    title: str = "Trust in the model",
    unit: str = "reward per period",
    windows: Mapping[str, ArrayLike] | None = None,
) -> Figure:
    """Draw the reward error with its thresholds, shaded while the gate is closed, and the test of each refit.

    A replay that ran away is marked at the upper edge. Of a single episode each figure has a line of its own, as there
    is no course to draw.

    Args:
        decisions: The columns of `gate.csv`, `(n_episodes,)` each: `episode`; `reward_error` per control period of the
            whole episode, replayed through the model before its refit; `judged_reward_error` of the model that stays,
            on held-out windows, NaN where no planning was due; the thresholds `open_below` and `close_above`; `open`,
            1 or 0; and of the refit `held_out_error_before`, `held_out_error_after` and `refit_kept`, NaN without a
            test.
        title: of the figure.
        unit: of the reward error.
        windows: Of a single episode, `reward_error` and `state_error` of the model that stays, `(n_windows,)` each, on
            every window that was held out.
    """
    columns = {name: array(values) for name, values in decisions.items()}
    if len(columns["episode"]) == 1:
        return _single_episode_gate(
            {name: float(values[0]) for name, values in columns.items()}, title, unit, windows or {}
        )
    x, before, after = (columns[name] for name in ("episode", "held_out_error_before", "held_out_error_after"))
    figure, (upper, lower) = panels(2, 1, (8.5, 5.0), title)
    dots: dict[str, Any] = {"marker": "o", "markersize": 3, "clip_on": False}
    upper.plot(x, columns["reward_error"], color=GREY, label=EPISODE, **dots)
    upper.plot(x, columns["judged_reward_error"], color=BLUE, label=JUDGED, **dots)
    # Half an episode to each side, as the shade of a closed one is as wide.
    wide = np.concatenate([x[:1] - 0.5, x, x[-1:] + 0.5])
    for name, line, words in (("open_below", ":", OPENS), ("close_above", "--", CLOSES)):
        bound = np.pad(columns[name], 1, mode="edge")
        upper.plot(wide, bound, color=BLACK, linestyle=line, linewidth=0.9, label=f"{words} {columns[name][0]:g}")
    for number, closed in enumerate(x[columns["open"] == 0]):
        text = "_" * (number > 0) + "model not trusted"
        upper.axvspan(closed - 0.5, closed + 0.5, color=GREY, alpha=0.25, linewidth=0, label=text)
    upper.set_yscale("log")
    bounds = [columns[name] for name in ("open_below", "close_above")]
    upper.set_ylim(*_around(np.concatenate([columns["reward_error"], columns["judged_reward_error"], *bounds])))
    _ticks(upper.yaxis)
    mark_divergence(upper, x[~np.isfinite(columns["reward_error"])], GREY)
    mark_divergence(upper, x[np.isinf(columns["judged_reward_error"])], BLUE)
    upper.set_ylabel(f"reward error\n[{unit}]")
    legend_beside(upper)
    lower.plot(x, before, color=ORANGE, label="before the refit", **dots)
    lower.plot(x, after, color=BLUE, label="after the refit", **dots)
    back = columns["refit_kept"] == 0
    if back.any():
        ring: dict[str, Any] = {"marker": "o", "markersize": 8, "markerfacecolor": "none"}
        ring |= {"linestyle": "none", "clip_on": False}
        lower.plot(x[back], after[back], color=RED, label="rolled back", **ring)
    if np.isfinite(before).any():
        lower.set_yscale("log")
        lower.set_ylim(*_around(np.concatenate([before, after])))
        _ticks(lower.yaxis)
    lower.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    lower.set_xlim(wide[0], wide[-1])
    lower.set_xlabel("real episode")
    lower.set_ylabel(f"held-out state error\n[{TYPICAL}]")
    legend_beside(lower)
    return figure


def _single_episode_gate(
    columns: Mapping[str, float], title: str, unit: str, windows: Mapping[str, ArrayLike]
) -> Figure:
    """Draw what the gate saw in the only episode: errors along the axis, one below the other, and those of windows."""
    figure, (upper, lower) = panels(2, 1, (8.5, 3.2), title, sharex=False)
    closed = "" if columns["open"] else ", closes the gate"
    kept = {1.0: "", 0.0: ", rolled back"}.get(columns["refit_kept"], ", not tested")
    errors = {
        EPISODE: ("reward_error", GREY),
        f"{JUDGED}{closed}": ("judged_reward_error", BLUE),
    }
    judged = array(windows.get("reward_error", ()))
    _rows(upper, columns, errors, f"reward error [{unit}]", (judged, 1, BLUE))
    for name, line, words in (("open_below", ":", OPENS), ("close_above", "--", CLOSES)):
        if np.isfinite(columns[name]):
            text = f"{words} {columns[name]:g}"
            upper.axvline(columns[name], color=BLACK, linestyle=line, linewidth=0.9, label=text)
            left, right = upper.get_xlim()
            upper.set_xlim(left, max(right, 2 * columns[name]))
    if upper.get_legend_handles_labels()[0]:
        legend_beside(upper)
    tests = {
        "before the refit": ("held_out_error_before", ORANGE),
        f"after the refit{kept}": ("held_out_error_after", RED if columns["refit_kept"] == 0 else BLUE),
    }
    back = columns["refit_kept"] == 0  # the model that stays is the one from before
    stays = (array(windows.get("state_error", ())), 0 if back else 1, ORANGE if back else BLUE)
    _rows(lower, columns, tests, f"held-out state error [{TYPICAL}]", stays)
    if lower.get_legend_handles_labels()[0]:
        legend_beside(lower)
    for axis in (upper, lower):
        if axis.get_xscale() == "log":
            _ticks(axis.xaxis)
    return figure


def _rows(
    axis: Axes,
    columns: Mapping[str, float],
    rows: Mapping[str, tuple[str, str]],
    what: str,
    windows: tuple[Array, int, str],
) -> None:
    """Draw figures along a logarithmic axis, each with its name in front and its value beside it.

    Beneath one of them, given by its height and its colour, stand the errors on single windows that it sums up.
    """
    single, height, color = windows
    single = single[np.isfinite(single) & (single > 0)]
    if len(single):
        look: dict[str, Any] = {"color": color, "marker": "|", "markersize": 9, "linestyle": "none"}
        axis.plot(single, np.full(len(single), height + 0.3), label=f"each of {len(single)} windows", **look)
    draw_named_values(axis, {words: (columns[name], color) for words, (name, color) in rows.items()}, what)
    values = np.concatenate([[columns[name] for name, _ in rows.values()], single])
    seen = values[np.isfinite(values) & (values > 0)]
    if len(seen):
        axis.set_xscale("log")
        room = max(2.0, (seen.max() / seen.min()) ** BESIDE)  # for the figures beside the dots
        axis.set_xlim(*_around(np.append(seen, room * seen.max())))


def _around(values: Array) -> tuple[float, float]:
    """Return the next of 1, 2, 5, 10, 20, ... clearly below and above positive values, at least a factor of 5 apart."""
    seen = values[np.isfinite(values) & (values > 0)]
    if not len(seen):
        return 1.0, 10.0
    powers = 10.0 ** np.arange(np.floor(np.log10(seen.min())) - 1, np.ceil(np.log10(seen.max())) + 2)
    steps = np.outer(powers, (1.0, 2.0, 5.0)).ravel()
    # The factors of the powers of ten are not exact in the last digits.
    low = float(steps[steps <= seen.min() / CLEAR * (1 + 1e-9)][-1])
    return low, float(max(steps[steps >= seen.max() * CLEAR * (1 - 1e-9)][0], 5 * low))


def _ticks(axis: Axis) -> None:
    """Put ticks at 1, 2 and 5 times the powers of ten where the limits hold few decades, at the powers elsewhere."""
    low, high = axis.get_view_interval()
    if high / low < FEW_DECADES:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    axis.set_minor_formatter(NullFormatter())
