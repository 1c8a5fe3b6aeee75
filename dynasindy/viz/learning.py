"""How learning went: the return over episodes of one run, and of several settings over seeds."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, SymmetricalLogLocator
from numpy.typing import ArrayLike

from dynasindy.evaluation.statistics import FEWEST, bootstrap_interval, interquartile_mean
from dynasindy.viz.controllers import line_styles
from dynasindy.viz.style import BLUE, GREY, RED, Array, array, label_single_point, legend_beside, panels, styled

LINEAR = 10.0
"""Returns within this of zero are drawn on a linear part of a logarithmic axis."""
FEWEST_TICKS = 3
"""Ticks that an axis needs to be read."""
WIDE = 30.0
"""Returns that differ by more than this factor are drawn on a logarithmic axis, if one is asked for."""
APART = 0.12
"""Distance of the seeds of a setting after a single episode, of the width of its strip."""
MOST_NAMED, STRIP = 6, 80
"""Strips that have their names below them at most, and the letters of one line of all these names."""


@styled
def learning_curve(
    episode: ArrayLike,
    train_return: ArrayLike,
    eval_episode: ArrayLike | None = None,
    eval_return: ArrayLike | None = None,
    window: int = 10,
    title: str = "Learning curve",
) -> Figure:
    """Draw the return of the exploring policy per real episode and that of the policy in evaluation.

    Args:
        episode: `(n,)` number of each real episode.
        train_return: `(n,)` its return, with exploration noise.
        eval_episode: `(m,)` episodes after which the policy was evaluated.
        eval_return: `(m,)` mean evaluated return, without noise.
        window: episodes in the moving mean.
        title: of the figure.
    """
    x, y = array(episode), array(train_return)
    figure, (axis,) = panels(1, 1, (7.0, 3.6), title)
    axis.plot(x, y, color=BLUE, alpha=0.3, linewidth=0.9, marker=".", label="real episode, exploring")
    if len(y) > window:
        axis.plot(x, moving_mean(y, window), color=BLUE, label=f"mean of {window} episodes")
    if eval_episode is None or eval_return is None:
        label_single_point(axis, x, y, BLUE)
    else:
        at, mean = array(eval_episode), array(eval_return)
        axis.plot(at, mean, color=RED, marker="o", markersize=3.5, label="evaluated policy")
    axis.set_xlim(min(0.0, x.min(initial=0.0)) - 0.5, x.max(initial=1.0) + 0.5)
    axis.set_xlabel("real episode")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axis.set_ylabel("return [-]")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return figure


@styled
def average_rewards(
    curves: Mapping[str, ArrayLike],
    episode: ArrayLike | None = None,
    window: int = 10,
    seed: int = 0,
    title: str = "Average rewards",
    log: bool = False,
    longer: Mapping[str, Sequence[tuple[ArrayLike, ArrayLike]]] | None = None,
) -> Figure:
    """Draw interquartile mean and 95 % bootstrap band over seeds, one line per setting; see `draw_bands`.

    Args:
        curves: `(n_seeds, n_episodes)` return of each episode, per setting.
        episode: `(n_episodes,)` numbers of the episodes, by default 1, 2, ...
        window: episodes in the moving mean taken of each seed before the statistics.
        seed: of the bootstrap.
        title: of the figure.
        log: logarithmic returns, linear within 10 of zero, if they differ by more than a factor of `WIDE`.
        longer: single runs that went on after the last episode of the curves, drawn faintly: `(n,)` episodes and `(n,)`
            returns of each, per setting.
    """
    figure, (axis,) = panels(1, 1, (8.5, 3.8), title)
    smooth = {
        name: np.stack([moving_mean(row, window) for row in np.atleast_2d(array(values))])
        for name, values in curves.items()
    }
    words = f"return, mean of {window} episodes" if window > 1 else "return"
    if log and _wide(smooth):
        axis.set_yscale("symlog", linthresh=LINEAR)
        words += f", logarithmic beyond {LINEAR:g}"
    draw_bands(axis, smooth, episode, seed)
    _draw_longer(axis, longer or {}, list(curves))
    _enough_ticks(axis)
    legend_beside(axis)
    axis.set_ylabel(f"{words} [-]")
    return figure


def draw_bands(axis: Axes, curves: Mapping[str, ArrayLike], episode: ArrayLike | None = None, seed: int = 0) -> None:
    """Draw interquartile mean and 95 % bootstrap band over seeds into an axis, one line per setting.

    Where there are fewer than three seeds, each is a line of its own, and nothing is a band. After a single episode
    there is no course: settings stand side by side, and so do the seeds of each.

    Args:
        axis: Where to draw.
        curves: `(n_seeds, n_episodes)` values after each episode, per setting.
        episode: `(n_episodes,)` numbers of the episodes, by default 1, 2, ...
        seed: Seed of the bootstrap.
    """
    banded, once = False, single_episode(curves)
    for place, ((name, values), line) in enumerate(zip(curves.items(), line_styles(curves).values())):
        rows = np.atleast_2d(array(values))
        x = np.arange(1, rows.shape[1] + 1) if episode is None else array(episode)[: rows.shape[1]]
        x = np.array([float(place)]) if once else x
        words = name.replace("$", r"\$")  # names of settings are no mathematics
        label = f"{words} ({len(rows)} seed{'s' * (len(rows) > 1)})"
        # A line through a single episode would not be seen.
        look: dict[str, Any] = {**line, "marker": "o" if len(x) == 1 else None, "clip_on": len(x) > 1}
        if len(rows) < FEWEST:
            for number, row in enumerate(rows):
                beside = APART * (number - (len(rows) - 1) / 2) if once else 0.0
                axis.plot(x + beside, row, label="_" * (number > 0) + label, **look)
        else:
            middle, low, high = _bootstrap_band(rows, seed)
            axis.plot(x, middle, label=label, **look)
            axis.fill_between(x, low, high, color=line["color"], alpha=0.2, linewidth=0, label=f"_{label}")
            if len(x) == 1:
                axis.vlines(x, low, high, color=line["color"], alpha=0.3, linewidth=7)
            banded = True
    if banded:
        few = any(len(np.atleast_2d(array(values))) < FEWEST for values in curves.values())
        words = f"; each seed where there are fewer than {FEWEST}" if few else ""
        axis.plot([], [], color=GREY, label=f"line: interquartile mean over seeds{words}")
        axis.plot([], [], color=GREY, alpha=0.3, linewidth=7, label="band: its 95 % bootstrap interval")
    if not curves:
        return
    if once:
        _name_strips(axis, list(curves), 1.0 if episode is None else float(array(episode)[0]))
        return
    last = max(np.atleast_2d(array(values)).shape[1] for values in curves.values())
    x = np.arange(1, last + 1) if episode is None else array(episode)[:last]
    room = 0.02 * (x[-1] - x[0]) + 1e-3
    axis.set_xlim(x[0] - room, x[-1] + room)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axis.set_xlabel("real episode")


def single_episode(curves: Mapping[str, ArrayLike]) -> bool:
    """Return whether no curve, `(n_seeds, n_episodes)` each, has more than one episode."""
    return bool(curves) and all(np.atleast_2d(array(values)).shape[1] == 1 for values in curves.values())


def _name_strips(axis: Axes, names: Sequence[str], episode: float) -> None:
    """Write the names of settings under their strips, which stand at 0, 1, ..., unless these are too many to read."""
    few = len(names) <= MOST_NAMED
    words = [textwrap.fill(name, STRIP // len(names)).replace("$", r"\$") for name in names] if few else []
    axis.set_xticks(range(len(words)), words)
    axis.set_xlim(-0.5, len(names) - 0.5)
    axis.grid(visible=False, axis="x")
    axis.set_xlabel(f"setting, after real episode {episode:g}")


def _draw_longer(axis: Axes, longer: Mapping[str, Sequence[tuple[ArrayLike, ArrayLike]]], known: Sequence[str]) -> None:
    """Draw single runs as thin lines in the colours of their settings, and widen the axis to their ends."""
    of = line_styles(dict.fromkeys([*known, *longer]))
    for name, runs in longer.items():
        words = name.replace("$", r"\$")
        label = f"{words}, longer ({len(runs)} seed{'s' * (len(runs) > 1)})"
        for number, (x, y) in enumerate(runs):
            text = "_" * (number > 0) + label
            axis.plot(array(x), array(y), linewidth=0.8, alpha=0.55, zorder=1.5, label=text, **of[name])
    ends = [float(array(x).max()) for runs in longer.values() for x, _ in runs]
    if ends:
        left, right = axis.get_xlim()
        axis.set_xlim(left, max(right, max(ends) + 0.02 * (max(ends) - left)))


def _enough_ticks(axis: Axes) -> None:
    """Add ticks at 2 and 5 times powers of ten to a logarithmic axis that shows few of these alone."""
    low, high = sorted(axis.get_ylim())
    shown = [tick for tick in axis.get_yticks() if low <= tick <= high]
    if axis.get_yscale() == "symlog" and len(shown) < FEWEST_TICKS:
        axis.yaxis.set_major_locator(SymmetricalLogLocator(base=10.0, linthresh=LINEAR, subs=[1.0, 2.0, 5.0]))
        axis.yaxis.set_major_formatter("{x:g}")


def _wide(curves: Mapping[str, Array]) -> bool:
    """Return whether the magnitudes of all values, those within `LINEAR` of zero aside, differ by more than `WIDE`."""
    size = np.abs(np.concatenate([values.ravel() for values in curves.values()])) if curves else np.ones(1)
    size = np.maximum(size[np.isfinite(size)], LINEAR)
    return len(size) > 0 and bool(size.max() > WIDE * size.min())


def moving_mean(values: Array, window: int) -> Array:
    """Return the mean of the last `window` values at each place, of fewer at the beginning."""
    total = np.cumsum(np.insert(values, 0, 0.0))
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - window, 0)
    return (total[end] - total[start]) / (end - start)


def _bootstrap_band(returns: Array, seed: int) -> tuple[Array, Array, Array]:
    """Return interquartile mean and interval over seeds at each episode of `(n_seeds, n_episodes)`."""
    by_episode = torch.as_tensor(returns.T)
    low, high = bootstrap_interval(by_episode.unsqueeze(-1), resamples=1000, seed=seed)
    return interquartile_mean(by_episode).numpy(), low.numpy(), high.numpy()
