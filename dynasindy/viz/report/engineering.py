"""Sections for the engineer: models of real plants on logs that they have not seen, and what controllers bear."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from dynasindy.viz.report.document import Part, Picture, Section, Table, Text
from dynasindy.viz.report.sources import Results, commits, each
from dynasindy.viz.style import BLACK, BLUE, GREY, panels, styled, time_axis

RIGS_COMMAND = "python scripts/benchmark.py rigs --data FOLDER"
RIGS = {"emps": "the EMPS axis", "tanks": "the cascaded tanks", "qube": "the QUBE pendulum"}
"""Real plants of which logs were measured."""
SIMULATED = ("emps", "tanks")
"""Those that are simulated through the whole test log."""
OURS = "ours"
"""How the names of our models begin."""
ELSEWHERE = {
    "emps": {"best published": 2.64, "best baseline": 5.17},
    "tanks": {"best published": 0.191, "best baseline": 0.396},
}
"""Errors on the test logs that others reached (arXiv 2405.10779), in the unit of the rows."""
SHOWN = ("test simulated, RMSE", "both angles 0.2 s ahead, RMSE", "both angles 0.5 s ahead, RMSE")
"""Errors that are drawn, each in a panel of its own."""
MARGINS = {
    "gain": "gain margin",
    "phase_deg": "phase margin [deg]",
    "delay_s": "delay margin [s]",
    "disk": "disk margin",
}
"""What controllers bear: columns of the table, and their words."""


def real_logs(results: Results) -> Section:
    """Return a figure per real plant: errors of its models on the test log."""

    def _of(rig: str) -> list[Part]:
        rows = results.rows("rigs.csv", RIGS_COMMAND)
        found = scored([row for row in rows if row["rig"] == rig])
        if not found:
            return [Text(f"Not measured: `{results.folder.name}/rigs.csv` has no row of `{rig}`.")]
        caption = f"Errors of models of {RIGS[rig]} on the test log, fitted to the training log."
        table = results.source("rigs.csv").rstrip(".")
        source = f"{table}, made by `{RIGS_COMMAND}` at commit {commits(found)}."
        scores = Picture(f"rig_{rig}", errors(found, ELSEWHERE.get(rig, {})), caption, source)
        return [scores, *each(_over_time, (rig,))] if rig in SIMULATED else [scores]

    def _over_time(rig: str) -> list[Part]:
        rows = [row for row in results.rows("rigs_over_time.csv", RIGS_COMMAND) if row["rig"] == rig]
        caption = (
            f"Errors of simulations of {RIGS[rig]} over the test log, from its start: simulated less measured. Each "
            "panel has a range of its own."
        )
        source = (
            f"{results.source('rigs_over_time.csv').rstrip('.')}, made by `{RIGS_COMMAND}` at commit {commits(rows)}."
        )
        return [Picture(f"rig_{rig}_over_time", over_time(rows), caption, source)] if rows else []

    words = (
        "Logs of real plants: models are fitted to the training log, and predict a test log that no fit has seen. "
        "The last score of each is drawn. Variants, whose names go on behind a comma, stand in "
        "`docs/results/README.md`: earlier settings, what was chosen after a look at a score, and single trials."
    )
    return Section("Beyond the paper: logs of real plants", [Text(words), *each(_of, *((rig,) for rig in RIGS))])


def scored(rows: Sequence[Mapping[str, str]]) -> list[Mapping[str, str]]:
    """Return the rows of errors on a test log, the newest of each model; names with a comma are variants of one."""
    kept = (row for row in rows if row["metric"] in SHOWN and "," not in row["model"])
    return list({(row["metric"], row["model"]): row for row in kept}.values())


@styled
def errors(rows: Sequence[Mapping[str, str]], elsewhere: Mapping[str, float]) -> Figure:
    """Draw a bar per model, the shortest at the top of each panel, and lines where others are.

    A model whose simulation runs away has words in the place of a bar, as its error is no number.

    Args:
        rows: Rows of a rig with `metric`, `model`, `value` and `unit`.
        elsewhere: Errors of others in the same unit, by what they are.
    """
    metrics = list(dict.fromkeys(row["metric"] for row in rows))
    figure, axes = panels(len(metrics), size=(7.0, 1.0 + 1.6 * len(metrics)), sharex=False)
    for axis, metric in zip(axes, metrics, strict=True):
        here = sorted((row for row in rows if row["metric"] == metric), key=lambda row: -float(row["value"]))
        values = [float(row["value"]) for row in here]
        known = [*filter(math.isfinite, values), *elsewhere.values()] or [1.0]
        low, high = 0.5 * min(known), 2 * max(known)
        widths = [value if math.isfinite(value) else low for value in values]
        bars = axis.barh([_name(row["model"]) for row in here], widths, color=[_colour(row["model"]) for row in here])
        clear = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # lines of others may run through a number
        told = [f"{value:g}" if math.isfinite(value) else "runs away" for value in values]
        axis.bar_label(bars, told, padding=3, bbox=clear)
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())  # each bar has its number
        for dashes, (words, value) in zip(("--", ":"), elsewhere.items(), strict=False):
            axis.axvline(value, color=BLACK, linestyle=dashes, label=f"{words}, {value:g} {here[0]['unit']}")
        axis.set_xlim(low, high)
        if high / low < 100:  # a single power of ten, or two, tell no scale
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_xlabel(f"{metric} [{here[0]['unit']}]")
        if elsewhere:
            axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


@styled
def over_time(rows: Sequence[Mapping[str, str]]) -> Figure:
    """Draw the errors of each model over a log, each in a panel with limits of its own, ours first.

    Args:
        rows: Rows of a rig with `model`, `seconds`, `error` and `unit`.
    """
    models = sorted(dict.fromkeys(row["model"] for row in rows), key=lambda name: not name.startswith(OURS))
    figure, axes = panels(len(models), size=(7.0, 0.6 + 1.1 * len(models)))
    for axis, model in zip(axes, models, strict=True):
        here = [row for row in rows if row["model"] == model]
        seconds = [float(row["seconds"]) for row in here]
        axis.plot(seconds, [float(row["error"]) for row in here], color=_colour(model))
        axis.axhline(0.0, color=BLACK, linewidth=0.6)
        axis.set_title(_name(model), loc="left")
        axis.set_ylabel(f"error [{here[0]['unit']}]")
    time_axis(axes[-1], [float(row["seconds"]) for row in rows])
    return figure


def _name(model: str) -> str:
    """Return the name of a model as a reader knows it."""
    return "PySINDy" if model == "pysindy" else model


def _colour(model: str) -> str:
    return BLUE if model.startswith(OURS) else GREY


def margins(results: Results) -> Section:
    """Return what controllers bear by the checks of `check.py`: the least margins over inputs, targets and seeds."""

    def _table() -> list[Part]:
        rows = results.rows("margins.csv", "python scripts/benchmark.py margins")
        cells = []
        for plant, planning in dict.fromkeys((row["plant"], row["planning"]) for row in rows):
            here = [row for row in rows if (row["plant"], row["planning"]) == (plant, planning)]
            least = [f"{min(float(row[name]) for row in here):.3g}" for name in MARGINS]
            lost, drawn = (sum(int(row[name]) for row in here) for name in ("unstable_draws", "draws"))
            cells.append([plant, planning, str(len(here)), *least, f"{lost} of {drawn}"])
        header = ["plant", "planning", "seeds", *MARGINS.values(), "not stable with other coefficients"]
        return [Text(results.source("margins.csv")), Table(header, cells)]

    words = (
        "What `check.py` finds on the identified model: the least margins over inputs, targets and seeds, and with how "
        "many plants whose coefficients differ from the model's the loop is not stable."
    )
    return Section("Beyond the paper: margins of the controllers", [Text(words), *each(_table, ())])
