"""The figures of a run folder, drawn from the files that the run wrote, the trust in its model among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dynasindy.evaluation.ablation import read_ablation
from dynasindy.safe_io import read_json
from dynasindy.systems import Signature
from dynasindy.viz import style
from dynasindy.viz.identification import prediction, training_data
from dynasindy.viz.response import tracking

TYPICAL = "typical ranges"
"""Unit of an error of all states together, each of which counts by its typical range, `Signature.x_scale`."""
DOTS: Mapping[str, Any] = {"marker": "o", "markersize": 3, "clip_on": False}
WINDOW = 10
"""Episodes in the moving mean of a run's returns."""


def read_table(path: Path) -> pd.DataFrame:
    """Read a CSV file of numbers with a header, whose columns are named without their units; empty cells become NaN.

    Raises:
        FileNotFoundError: The file does not exist.
        DamagedFileError: It is no table of numbers.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; give the folder of a finished run")
    return read_ablation(path, ()).rename(columns=lambda name: name.partition(" [")[0])


def draw_run(folder: Path, signature: Signature, formats: tuple[str, ...] = ("png",)) -> list[Path]:
    """Draw every figure whose data a run folder holds.

    Args:
        folder: Run folder.
        signature: Names and units of the plant.
        formats: File formats, e.g. ("png", "svg").

    Returns:
        The files, in `folder/figures`.
    """
    names, inputs, figures = list(signature.state_names), list(signature.input_names), dict[str, Figure]()
    found = read_json(folder / "metrics.json") if (folder / "metrics.json").is_file() else {}
    excited = read_table(folder / "data" / "excitation.csv")
    title = f"Training data of the first model\n{found.get('excitation', '')}".strip()
    figures["training_data"] = training_data(excited["time"], excited[names], excited[inputs], signature, title)
    for when, data in (("first", "the excitation alone"), ("last", "the data before it")):
        path = folder / "data" / f"prediction_{when}_episode.csv"
        if path.is_file():
            table = read_table(path)
            real, predicted = style.array(table[names]), style.array(table[[f"predicted_{name}" for name in names]])
            title = f"Open-loop prediction of the {when} real episode, model of {data}"
            figures[path.stem] = prediction(table["time"], real, predicted, signature, title)
    if (folder / "progress.csv").is_file():
        progress = read_table(folder / "progress.csv")
        if len(progress) > 1:  # the return of a single one stands in the table, and makes no curve
            # The untrained policy stands at episode 0.
            untrained = found.get("untrained", {"return": None})["return"]
            figures["learning_curve"] = _learning_curve(progress, np.nan if untrained is None else untrained)
    decisions = read_table(folder / "gate.csv") if (folder / "gate.csv").is_file() else ()
    if len(decisions) > 1:
        # A reward that was learnt is judged in deviations of what was paid, see `Task.unit`.
        unit = "deviations of the reward" if found.get("reward") else "reward per period"
        figures["gate"] = gate(decisions, unit=unit)
    response, which = read_table(folder / "data" / "step_response.csv"), found.get("drawn", {}).get("words", "")
    tracked = [name.removeprefix("reference_") for name in response if name.startswith("reference_")]
    outputs, held = [*tracked, *(name for name in names if name not in tracked)], periods(response, inputs)
    reference = response[[f"reference_{name}" for name in tracked]] if tracked else None
    title = f"Response\n{which}".strip()  # which episode of how many it is
    y, u = {"policy": response[outputs]}, {"policy": held[inputs]}
    figures["step_response"] = tracking(held["time"], reference, y, u, outputs, signature, title)
    return style.save_figures(figures, folder / "figures", formats)


def periods(table: pd.DataFrame, inputs: Sequence[str]) -> pd.DataFrame:
    """Return the rows of a flight at which control periods begin.

    A last row of the table without inputs is the state at the end, and no period; tables of earlier runs have none.
    """
    ended = len(table) > 1 and bool(table[list(inputs)].iloc[-1].isna().all())
    return table[:-1] if ended else table


@style.styled
def _learning_curve(progress: pd.DataFrame, untrained: float) -> Figure:
    x, y = style.array(progress["episode"]), style.array(progress["return"])
    evaluated = progress.dropna(subset="evaluated_return")
    figure, (axis,) = style.panels(1, 1, (7.0, 3.6), "Learning curve")
    axis.plot(x, y, color=style.BLUE, alpha=0.3, linewidth=0.9, marker=".", label="real episode, exploring")
    if len(y) > WINDOW:
        axis.plot(x, progress["return"].rolling(WINDOW, 1).mean(), color=style.BLUE, label=f"mean of {WINDOW} episodes")
    episodes, returns = np.append(0, evaluated["episode"]), np.append(untrained, evaluated["evaluated_return"])
    axis.plot(episodes, returns, color=style.RED, marker="o", markersize=3.5, label="evaluated policy")
    axis.set_xlim(min(0.0, x.min(initial=0.0)) - 0.5, x.max(initial=1.0) + 0.5)
    axis.set_xlabel("real episode")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axis.set_ylabel("return [-]")
    style.legend(axis, below=True)
    return figure


@style.styled
def gate(decisions: pd.DataFrame, title: str = "Trust in the model", unit: str = "reward per period") -> Figure:
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
    columns = {name: style.array(values) for name, values in decisions.items()}
    x, whole, judged = (columns[name] for name in ("episode", "reward_error", "judged_reward_error"))
    before, after, back = columns["held_out_error_before"], columns["held_out_error_after"], columns["refit_kept"] == 0
    figure, (upper, lower) = style.panels(2, 1, (8.5, 5.0), title)
    upper.plot(x, whole, color=style.GREY, label="whole episode, before the refit", **DOTS)
    upper.plot(x, judged, color=style.BLUE, label="held-out windows, judged", **DOTS)
    # Half an episode to each side, as the shade of a closed one is as wide.
    wide = np.concatenate([x[:1] - 0.5, x, x[-1:] + 0.5])
    for name, line, words in (("open_below", ":", "trusted below"), ("close_above", "--", "no longer trusted above")):
        bound = np.pad(columns[name], 1, mode="edge")
        upper.plot(wide, bound, color=style.BLACK, linestyle=line, linewidth=0.9, label=f"{words} {columns[name][0]:g}")
    for closed in x[columns["open"] == 0]:
        upper.axvspan(closed - 0.5, closed + 0.5, color=style.GREY, alpha=0.25, linewidth=0, label="model not trusted")
    lower.plot(x, before, color=style.ORANGE, label="before the refit", **DOTS)
    lower.plot(x, after, color=style.BLUE, label="after the refit", **DOTS)
    ring: dict[str, Any] = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "linestyle": "none"}
    if back.any():
        lower.plot(x[back], after[back], color=style.RED, label="rolled back", clip_on=False, **ring)
    upper.set_yscale("log")
    if bool(((before > 0) | (after > 0)).any()):
        lower.set_yscale("log")
    _mark_divergence(upper, x[~np.isfinite(whole)], style.GREY)
    _mark_divergence(upper, x[np.isinf(judged)], style.BLUE)
    lower.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    lower.set_xlim(wide[0], wide[-1])
    lower.set_xlabel("real episode")
    upper.set_ylabel(f"reward error\n[{unit}]")
    lower.set_ylabel(f"held-out state error\n[{TYPICAL}]")
    for axis in (upper, lower):
        style.legend(axis)
    return figure


def _mark_divergence(axis: Axes, x: style.Array, color: str) -> None:
    """Mark at the upper edge of an axis, whose limits end with this, where an error was not finite."""
    _, top = axis.set_ylim(axis.get_ylim())
    if len(x):
        look: dict[str, Any] = {"marker": "^", "markersize": 6, "linestyle": "none", "clip_on": False, "zorder": 3}
        axis.plot(x, np.full(len(x), top), color=color, label="ran away, above the axis", **look)
