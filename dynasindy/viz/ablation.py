"""The figures of an ablation: return and steady-state error over real episodes, a line per setting."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dynasindy.evaluation.ablation import SHARE, Level, Row, read_ablation
from dynasindy.safe_io import file_name
from dynasindy.viz.controllers import FAMILIES, controller_name
from dynasindy.viz.learning import average_rewards, draw_bands, single_episode
from dynasindy.viz.style import BLACK, Array, legend_beside, panels, save, styled

ValueOf = Callable[[Row], float]
MAIN = "rollouts"
REFERENCE = "rollouts_800"
EQUAL = "horizon"
"""Family that is compared at equal numbers of imagined transitions, which are not those of the reference."""
OTHERS = "other models, and the gate"
MODEL_FREE = "without a model"
WITHOUT_MODEL = ("rollouts_0_tuned", "direct", "sb3_")
"""How the names of settings begin that have no model; `rollouts_0` stands beside the numbers of rollouts."""
CHANGED = "changed on the command line"
OF_RANGE = "% of the target range"
"""Unit of errors where outputs in several units are compared."""


@styled
def steady_state_errors(
    curves: Mapping[str, ArrayLike],
    level: float,
    episode: ArrayLike | None = None,
    title: str = "Steady-state error",
    unit: str = "rad",
) -> Figure:
    """Draw the error of the worse axis over episodes: interquartile mean and 95 % band over seeds; see `draw_bands`.

    Args:
        curves: `(n_seeds, n_episodes)` error after each episode, per setting [`unit`].
        level: The required level [`unit`].
        episode: `(n_episodes,)` numbers of the evaluated episodes, by default 1, 2, ...
        title: of the figure.
        unit: of errors and level.
    """
    figure, (axis,) = panels(1, 1, (8.5, 3.8), title)
    _draw_errors(axis, curves, level, episode, unit)
    return figure


@styled
def draw_controls(
    families: Mapping[str, Mapping[str, ArrayLike]],
    level: float,
    episode: ArrayLike | None = None,
    title: str = "",
    unit: str = "rad",
) -> Figure:
    """Draw the error of the worse axis over episodes, a panel per family of settings, with the same vertical axis.

    Args:
        families: Curves as for `steady_state_errors`, per family.
        level: The required level [`unit`].
        episode: `(n_episodes,)` numbers of the evaluated episodes, by default 1, 2, ...
        title: of the figure.
        unit: of errors and level.
    """
    once = all(map(single_episode, families.values()))  # then each panel has a strip for each of its settings
    figure, axes = panels(len(families), 1, (10.0, 0.6 + 2.6 * len(families)), title, sharex=not once)
    for axis in axes[1:]:
        axis.sharey(axes[0])
    for axis, (family, curves) in zip(axes, families.items()):
        _draw_errors(axis, curves, level, episode, unit)
        axis.set_title(family)
        axis.set_ylabel(f"steady-state error,\nworse axis [{_short(unit)}]")
        if not once:
            axis.label_outer(remove_inner_ticks=False)
    return figure


def draw_ablation(
    results: Path, level: float, formats: tuple[str, ...] = ("png",), share: float = Level.share
) -> list[Path]:
    """Draw returns and errors for every plant and experiment in `ablation_curves.csv`.

    The numbers of rollouts, as in the paper, stand in two figures of their own; the errors of all other settings, the
    controls, in a third, a panel per family.

    Args:
        results: Folder of the tables; the figures go there too.
        level: The required level [rad].
        formats: File formats, e.g. ("png", "svg").
        share: The required level of plants whose outputs are not all in rad, as a share of the target range.

    Returns:
        The files.
    """
    rows = read_ablation(results / "ablation_curves.csv")
    files = []
    for (system, experiment), group in groupby(rows, key=lambda row: (row["system"], row["experiment"])):
        lines, case = _without_common_words(list(group)), file_name(f"{system}_{experiment}", "plant and experiment")
        title = f"plant {system}, experiment {experiment}"
        average = f"Imagined rollouts: average rewards, {title}"
        returns = _curves(lines, lambda row: float(row["evaluated_return"] or 0.0))
        shares = all(row.get(SHARE) is not None for row in lines)
        errors = _curves(lines, _share if shares else _worst)
        judged = (100 * share, OF_RANGE) if shares else (level, "rad")
        episodes = sorted({float(row["episode"] or 0.0) for row in lines})
        chosen = [name for name in errors if _family(name) == MAIN] or list(errors)
        figure = average_rewards(
            {controller_name(name): returns[name] for name in chosen}, episodes, window=1, title=average, log=True
        )
        files += save(figure, results / f"average_rewards_{case}", formats)
        main = {name: errors.pop(name) for name in chosen}
        shown = {controller_name(name): values for name, values in main.items()}
        figure = steady_state_errors(shown, judged[0], episodes, f"Steady-state error, {title}", judged[1])
        files += save(figure, results / f"steady_state_error_{case}", formats)
        if errors:
            panels_of = {
                family: {controller_name(name): values for name, values in members.items()}
                for family, members in control_families(errors, main.get(REFERENCE)).items()
            }
            figure = draw_controls(panels_of, judged[0], episodes, f"Controls: steady-state error, {title}", judged[1])
            files += save(figure, results / f"controls_{case}", formats)
    return files


def _without_common_words(rows: list[Row]) -> list[Row]:
    """Return the rows with settings that lack the words of the command line which all of them share."""
    settings = [str(row["setting"]).split(",") for row in rows]
    common = set.intersection(*(set(words[1:]) for words in settings))
    names = [",".join(word for word in words if word not in common) for words in settings]
    return [{**row, "setting": name} for row, name in zip(rows, names, strict=True)]


def _draw_errors(
    axis: Axes, curves: Mapping[str, ArrayLike], level: float, episode: ArrayLike | None, unit: str
) -> None:
    draw_bands(axis, curves, episode)
    axis.axhline(level, color=BLACK, linestyle="--", linewidth=0.9, label=f"required: at most {level:g} {unit}")
    axis.set_yscale("log")
    when = "of the last 5 s" if unit == "rad" else "at the end"  # a slow plant's end is longer
    axis.set_ylabel(f"mean abs error {when}, worse axis [{_short(unit)}]")
    legend_beside(axis)


def control_families(curves: Mapping[str, Array], reference: Array | None) -> dict[str, dict[str, Array]]:
    """Return the controls by what they vary, each beside the reference but where the amount of data would differ.

    Args:
        curves: `(n_seeds, n_episodes)` per control.
        reference: The same of `rollouts_800`; none if there are no runs of it.
    """
    found: dict[str, dict[str, Array]] = {}
    for name in sorted(curves, key=_by_number):
        family = _family(name)
        first = {} if family == EQUAL or reference is None else {REFERENCE: reference}
        found.setdefault(FAMILIES.get(family, family.replace("_", " ")), first)[name] = curves[name]
    return dict(sorted(found.items()))


def _by_number(setting: str) -> list[tuple[str, int]]:
    """Return a key that sorts `horizon_20` before `horizon_100`."""
    return [(word, 0) if k % 2 == 0 else ("", int(word)) for k, word in enumerate(re.split(r"(\d+)", setting))]


def _family(setting: str) -> str:
    """Return what a setting varies: `real_share` for `real_share_05`; those of a kind of their own stand together."""
    if "," in setting:
        return CHANGED
    if setting.startswith(WITHOUT_MODEL):
        return MODEL_FREE
    stem = re.fullmatch(r"(.+)_\d+", setting)
    return stem[1] if stem else OTHERS


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


def _share(row: Row) -> float:
    return 100 * float(row[SHARE] or 0.0)


def _short(unit: str) -> str:
    return "% of range" if unit == OF_RANGE else unit
