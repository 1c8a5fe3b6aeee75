"""How learning went: the return over episodes of one run, and return and error of several settings over seeds."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dynasindy.evaluation import ablation
from dynasindy.safe_io import file_name
from dynasindy.viz import style

Curves = Mapping[str, pd.DataFrame]
"""Values by seed, in rows, and episode, in columns, per setting."""
LINEAR = 10.0
"""Returns within this of zero are drawn on a linear part of a logarithmic axis."""
WIDE = 30.0
"""Returns that differ by more than this factor are drawn on a logarithmic axis."""
MOST_NAMED = 6
"""Settings of a figure, beyond which it shows the numbers of rollouts alone, where there are any."""
OF_RANGE = "% of the target range"
"""Unit of errors where outputs in several units are compared."""


@style.styled
def average_rewards(curves: Curves, title: str = "Average rewards") -> Figure:
    """Draw interquartile mean and 95 % bootstrap band over seeds of the return, one line per setting.

    The axis is logarithmic, and linear within 10 of zero, if returns differ by more than a factor of `WIDE`.

    Args:
        curves: Returns by seed and episode, per setting.
        title: of the figure.
    """
    figure, (axis,) = style.panels(1, 1, (8.5, 3.8), title)
    size = np.abs(np.concatenate([values.to_numpy().ravel() for values in curves.values()]))
    size = np.maximum(size[np.isfinite(size)], LINEAR)
    logarithmic = bool(size.max(initial=0.0) > WIDE * size.min(initial=np.inf))
    if logarithmic:
        axis.set_yscale("symlog", linthresh=LINEAR)
    _draw_bands(axis, curves)
    style.legend(axis)
    axis.set_ylabel(f"return, logarithmic beyond {LINEAR:g} [-]" if logarithmic else "return [-]")
    return figure


def draw_ablation(results: Path, level: ablation.Level) -> list[Path]:
    """Draw returns and errors for every plant and experiment in `ablation_curves.csv`.

    Where there are more settings than can be told apart, the figures have the numbers of rollouts, as the paper's.

    Args:
        results: Folder of the tables; the figures go there too.
        level: The required level.

    Returns:
        The files.
    """
    rows = ablation.read_ablation(results / ablation.CURVES)
    files = []
    for (system, experiment), group in rows.groupby(["system", "experiment"], sort=False):
        case = file_name(f"{system}_{experiment}", "plant and experiment")
        title = f"plant {system}, experiment {experiment}"
        words = group["setting"].str.split(",")  # of the command line; those that all share say nothing
        common = set.intersection(*(set(each[1:]) for each in words))
        lines = group.assign(setting=[",".join(word for word in each if word not in common) for each in words])
        shares = ablation.SHARE in lines and bool(lines[ablation.SHARE].notna().all())
        errors = curves_of(lines, 100 * lines[ablation.SHARE] if shares else ablation.worst_errors(lines))
        few = [name for name in errors if re.fullmatch(r"rollouts_\d+", name)] if len(errors) > MOST_NAMED else []
        chosen = {name: style.controller_name(name) for name in few or errors}
        returns, errors = (
            {words: curves[name] for name, words in chosen.items()}
            for curves in (curves_of(lines, lines["evaluated_return"]), errors)
        )
        judged = (100 * level.share, OF_RANGE) if shares else (level.error, "rad")
        figures = {
            "average_rewards": average_rewards(returns, f"Imagined rollouts: average rewards, {title}"),
            "steady_state_error": _draw_errors(errors, *judged, f"Steady-state error, {title}"),
        }
        files += style.save_figures({f"{name}_{case}": figure for name, figure in figures.items()}, results)
    return files


@style.styled
def _draw_errors(curves: Curves, level: float, unit: str, title: str) -> Figure:
    figure, (axis,) = style.panels(1, 1, (8.5, 3.8), title)
    _draw_bands(axis, curves)
    axis.axhline(level, color=style.BLACK, linestyle="--", linewidth=0.9, label=f"required: at most {level:g} {unit}")
    axis.set_yscale("log")
    style.legend(axis)
    short = "% of range" if unit == OF_RANGE else unit
    when = "of the last 5 s" if unit == "rad" else "at the end"  # a slow plant's end is longer
    axis.set_ylabel(f"mean abs error {when}, worse axis [{short}]")
    return figure


def _draw_bands(axis: Axes, curves: Curves) -> None:
    """Draw interquartile mean and 95 % bootstrap band over seeds per setting, or each of fewer than three seeds."""
    for (name, values), line in zip(curves.items(), style.line_styles(curves).values(), strict=True):
        x, rows = style.array(values.columns), values.to_numpy(copy=True)
        words = name.replace("$", r"\$")  # names of settings are no mathematics
        label = f"{words} ({len(rows)} seed{'s' * (len(rows) > 1)}{', no common episode' * (not len(x))})"
        # A line through a single episode would not be seen.
        look: dict[str, Any] = {**line, "marker": "o" if len(x) == 1 else None, "clip_on": len(x) > 1}
        if len(rows) < ablation.FEWEST or not len(x):
            for number, row in enumerate(rows):
                axis.plot(x, row, label="_" * (number > 0) + label, **look)
            continue
        by_episode = torch.as_tensor(rows.T)
        low, high = ablation.bootstrap_interval(by_episode, resamples=1000)
        axis.plot(x, ablation.interquartile_mean(by_episode).numpy(), label=label, **look)
        axis.fill_between(x, low.numpy(), high.numpy(), color=line["color"], alpha=0.2, linewidth=0, label=f"_{label}")
        if len(x) == 1:
            axis.vlines(x, low.numpy(), high.numpy(), color=line["color"], alpha=0.3, linewidth=7)
    counts = [len(rows) for rows in curves.values()]
    if max(counts, default=0) >= ablation.FEWEST:
        words = f"; each seed where there are fewer than {ablation.FEWEST}" if min(counts) < ablation.FEWEST else ""
        axis.plot([], [], color=style.GREY, label=f"line: interquartile mean over seeds{words}")
        axis.plot([], [], color=style.GREY, alpha=0.3, linewidth=7, label="band: its 95 % bootstrap interval")
    episodes = [*itertools.chain(*curves.values())] or [0]
    room = 0.02 * (max(episodes) - min(episodes)) + 1e-3
    axis.set_xlim(min(episodes) - room, max(episodes) + room)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axis.set_xlabel("real episode")


def curves_of(rows: pd.DataFrame, values: pd.Series[float]) -> dict[str, pd.DataFrame]:
    """Return values by seed and episode per setting, of the episodes that all its seeds have."""
    groups = rows.assign(value=values).groupby("setting", sort=False)
    return {
        str(name): group.pivot(index="seed", columns="episode", values="value").dropna(axis=1) for name, group in groups
    }
