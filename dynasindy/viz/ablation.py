"""The figures of an ablation: return and steady-state error over real episodes, a line per setting."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dynasindy.evaluation.ablation import Row, read_rows
from dynasindy.viz.learning import average_rewards, band
from dynasindy.viz.style import BLACK, CYCLE, Array, array, panels, save, styled

ValueOf = Callable[[Row], float]


@styled
def steady_state_errors(
    curves: Mapping[str, ArrayLike],
    level: float,
    episode: ArrayLike | None = None,
    title: str = "Steady-state error",
) -> Figure:
    """Draw the error of the worse axis over episodes: interquartile mean and 95 % bootstrap band over seeds.

    Args:
        curves: `(n_seeds, n_episodes)` error after each episode, per setting [rad].
        level: The required level [rad].
        episode: `(n_episodes,)` numbers of the evaluated episodes, by default 1, 2, ...
        title: of the figure.
    """
    figure, (axis,) = panels(1, 1, (7.0, 3.8), title)
    for k, (name, values) in enumerate(curves.items()):
        errors = np.atleast_2d(array(values))
        x = np.arange(1, errors.shape[1] + 1) if episode is None else array(episode)[: errors.shape[1]]
        middle, low, high = band(errors, seed=0)
        color = CYCLE[k % len(CYCLE)]
        axis.plot(x, middle, color=color, label=f"{name} ({len(errors)} seeds)")
        axis.fill_between(x, low, high, color=color, alpha=0.2, linewidth=0)
    axis.axhline(level, color=BLACK, linestyle="--", linewidth=0.9, label=f"required: {level:g} rad")
    axis.set_yscale("log")
    axis.set_xlabel("real episode")
    axis.set_ylabel("mean abs error of the last 5 s, worse axis [rad]")
    axis.legend(loc="best")
    return figure


def draw_ablation(results: Path, level: float, formats: tuple[str, ...] = ("png",)) -> list[Path]:
    """Draw both figures for every plant and experiment in `ablation_curves.csv`.

    Args:
        results: Folder of the tables; the figures go there too.
        level: The required level [rad].
        formats: File formats, e.g. ("png", "svg").

    Returns:
        The files.
    """
    rows = read_rows(results / "ablation_curves.csv")
    files = []
    for (system, experiment), group in groupby(rows, key=lambda row: (row["system"], row["experiment"])):
        lines = list(group)
        title = f"plant {system}, experiment {experiment}"
        average = f"Dyna-style vs. direct TD3: average rewards, {title}"
        returns = _curves(lines, lambda row: float(row["evaluated_return"] or 0.0))
        episodes = sorted({float(row["episode"] or 0.0) for row in lines})
        figure = average_rewards(returns, episodes, window=1, title=average, log=True)
        files += save(figure, results / f"average_rewards_{system}_{experiment}", formats)
        figure = steady_state_errors(_curves(lines, _worst), level, episodes, f"Steady-state error, {title}")
        files += save(figure, results / f"steady_state_error_{system}_{experiment}", formats)
    return files


def _curves(rows: list[Row], value: ValueOf) -> dict[str, Array]:
    """Return `(n_seeds, n_episodes)` per setting, over the episodes that all its seeds have."""
    curves = {}
    for setting, group in groupby(rows, key=lambda row: str(row["setting"])):
        seeds = [[value(row) for row in lines] for _, lines in groupby(group, key=lambda row: row["seed"])]
        shortest = min(map(len, seeds))
        curves[setting] = np.array([seed[:shortest] for seed in seeds])
    return curves


def _worst(row: Row) -> float:
    return max(float(v) for k, v in row.items() if k.startswith("evaluated_steady_state_error/") and v is not None)
