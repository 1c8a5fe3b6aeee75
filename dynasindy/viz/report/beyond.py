"""Sections beyond the paper: gradient planning, other controllers, trust, identification, logs, margins, speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from dynasindy.evaluation.metrics import UNITS
from dynasindy.evaluation.statistics import FEWEST, interquartile_mean
from dynasindy.evaluation.summary import WORDS
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.controllers import controller_name
from dynasindy.viz.gate import gate
from dynasindy.viz.report.document import Part, Picture, Section, Table, Text
from dynasindy.viz.report.paper import AXES
from dynasindy.viz.report.results import CASES, PLANTS, Results, Row, each
from dynasindy.viz.report.sections import FIRST
from dynasindy.viz.response import step_response, tracking
from dynasindy.viz.run import periods, stacked
from dynasindy.viz.style import BLACK, BLUE, GREY, panels, styled, time_axis

BENCHMARK = "python scripts/benchmark.py {}"
OVER = "Interquartile means over seeds (the value of each where there are fewer than three)"
CHANGE, NIS = "mean_abs_change_per_period_last_5s", "mean_nis"
MEASURED = {
    "mean_abs_error_last_5s": "mean error of the last 5 s",
    "rmse": "RMSE",
    "max_abs_error_5s_after_gust": "largest error from 5 s after the gust",
}
CASE_WORDS = {
    "step": "trained on steps",
    "small": "trained on steps, two layers of 64 units",
    "oracle": "trained on steps, with the true plant as the model",
    "moving": "trained on steps, sines and squares",
    "noise": "noise on all states, behind an observer",
    "bench": "encoders and speed sensors, behind an observer",
    "bench_delay": "encoders and speed sensors, inputs a period late",
    "detuned": "judged with constants off by up to 10 %",
    "friction": "dry friction, learnt in episodes",
    "friction_alone": "dry friction, learnt from the excitation alone",
    "unseen": "trained on steps, judged elsewhere",
    "unseen_moving": "trained on steps, sines and squares, judged elsewhere",
}
SCENARIO_WORDS = {
    "step": "64 steps",
    "detuned_gust": "64 steps in a gust",
    "edges": "16 targets on the edge of those trained on",
    "beyond": "16 targets beyond those trained on",
    "away": "64 steps from random starts",
    "noise_in_flight": "64 steps, noise only when judged",
    "staircase": "eight targets, one after the other",
}
ERRORS = {
    "azimuth": "azimuth [rad]",
    "pitch": "pitch [rad]",
    "azimuth_worst": "worst azimuth [rad]",
    "pitch_worst": "worst pitch [rad]",
    "return": "return",
    "wall_seconds": "wall time [s]",
}
RIGS = {"emps": "the EMPS axis", "tanks": "the cascaded tanks", "qube": "the QUBE pendulum"}
"""Real plants of which logs were measured."""
PUBLISHED = {
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


def gradient(results: Results) -> Section:
    """Return planning by gradient: its table, and a step, sine and square of the main job."""

    def _tables() -> list[Part]:
        make = BENCHMARK.format("gradient")
        rows = results.rows("gradient.csv", make)
        errors = [row for row in rows if row["metric"] not in (CHANGE, NIS)]
        parts: list[Part] = [
            Text(
                f"{OVER} of the errors over references; worst: of the worst reference. "
                f"{results.source('gradient.csv', make, rows)}"
            ),
            _cases(errors, ERRORS, with_metric=True),
        ]
        if changes := [row for row in rows if row["metric"] == CHANGE]:
            words = (
                "How much the inputs change from one control period to the next in the last 5 s, as parts of their "
                "half range:"
            )
            parts += [Text(words), _cases(changes, {"azimuth": "tail input [-]", "pitch": "main input [-]"})]
        if innovations := [row for row in rows if row["metric"] == NIS]:
            words = "The normalised innovation squared of the observer, which is 1 if all noise levels are right:"
            parts += [Text(words), _cases(innovations, {"azimuth": "mean [-]"})]
        return parts

    def _of(plant: str, scenario: str) -> list[Part]:
        run, step, name = results.main_run(plant), scenario == "step", controller_name("gradient")
        columns = run.table("data/step_response.csv" if step else f"evaluation/{scenario}.csv")
        target, y = stacked(columns, [f"reference_{axis}" for axis in AXES]), {name: stacked(columns, tuple(AXES))}
        title = f"{scenario.capitalize()}, planning by gradient: plant {plant}"
        if step:
            time, u = periods(columns, SIGNATURE.input_names)
            figure = step_response(time, target, y, {name: u}, title=title)
        else:
            figure = tracking(columns["time"], target, y, title=title)
        seconds = run.record("metrics.json")["cost"]["plant_seconds"]
        caption = f"{FIRST if step else f'The {scenario}'} on `{plant}` after {seconds:.0f} s of plant time."
        return [Picture(f"gradient_{scenario}_{plant}", figure, caption, run.source)]

    words = (
        "The main job follows the gradient of the reward through the identified model instead of sampling imagined "
        "transitions: the policy is trained on the model, and judged on the plant."
    )
    cases = [(plant, scenario) for plant in PLANTS for scenario in ("step", "sine", "square")]
    return Section("Beyond the paper: planning by gradient", [Text(words), *each(_tables, ()), *each(_of, *cases)])


def baselines(results: Results) -> Section:
    """Return other controllers on the same plants."""

    def _tables() -> list[Part]:
        make = BENCHMARK.format("baselines")
        rows = results.rows("baselines.csv", make)
        parts: list[Part] = [Text(f"{OVER}, azimuth / pitch. {results.source('baselines.csv', make, rows)}")]
        for plant, scenario in dict.fromkeys((row["plant"], row["scenario"]) for row in rows):
            own = [row for row in rows if (row["plant"], row["scenario"]) == (plant, scenario)]
            parts += [Text(f"**Plant `{plant}`, {scenario}**"), _controllers(own)]
        return parts

    return Section("Beyond the paper: other controllers", each(_tables, ()))


def trust(results: Results) -> Section:
    """Return what the gate decided in the runs with 800 rollouts."""

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.ablation_run(plant, experiment, "rollouts_800")
        figure = gate(run.table("gate.csv"), f"Trust in the model: plant {plant}, experiment {experiment}")
        caption = f"Trust in the model of `{plant}`, `{experiment}`."
        return [Picture(f"gate_{plant}_{experiment}", figure, caption, run.source)]

    words = "A model is used for planning only while it predicts the reward of real episodes that it has not seen."
    return Section("Beyond the paper: when the model is trusted", [Text(words), *each(_of, *CASES)])


def identification(results: Results) -> Section:
    """Return what identification reaches, beside PySINDy and the targets that were set."""
    return _whole_table(results, "Beyond the paper: identification", "identification.csv", BENCHMARK.format("identify"))


def speed(results: Results) -> Section:
    """Return the time of a TD3 update beside other libraries."""
    return _whole_table(results, "Beyond the paper: speed of a TD3 update", "td3.csv", BENCHMARK.format("td3"))


def real_logs(results: Results) -> Section:
    """Return a figure or two per real plant: errors of its models on the test log."""
    make = BENCHMARK.format("rigs --data FOLDER")

    def _scores(rig: str) -> list[Part]:
        rows = [row for row in results.rows("rigs.csv", make) if row["rig"] == rig and row["metric"] in SHOWN]
        # The newest of each model; names with a comma are variants of one.
        newest = list({(row["metric"], row["model"]): row for row in rows if "," not in row["model"]}.values())
        if not newest:
            return [Text(f"Not measured: `{results.folder.name}/rigs.csv` has no row of `{rig}`.")]
        caption = f"Errors of models of {RIGS[rig]} on the test log, fitted to the training log."
        figure = _error_bars(newest, PUBLISHED.get(rig, {}))
        return [Picture(f"rig_{rig}", figure, caption, results.source("rigs.csv", make, newest))]

    def _over_time(rig: str) -> list[Part]:
        rows = [row for row in results.rows("rigs_over_time.csv", make) if row["rig"] == rig]
        caption = (
            f"Errors of simulations of {RIGS[rig]} over the test log, from its start: simulated less measured. Each "
            "panel has a range of its own."
        )
        source = results.source("rigs_over_time.csv", make, rows)
        return [Picture(f"rig_{rig}_over_time", _error_courses(rows), caption, source)] if rows else []

    words = (
        "Logs of real plants: models are fitted to the training log, and predict a test log that no fit has seen. "
        "The last score of each is drawn. Variants, whose names go on behind a comma, stand in "
        "`docs/results/README.md`: earlier settings, what was chosen after a look at a score, and single trials."
    )
    parts = [part for rig in RIGS for build in (_scores, _over_time) for part in each(build, (rig,))]
    return Section("Beyond the paper: logs of real plants", [Text(words), *parts])


def margins(results: Results) -> Section:
    """Return the robustness margins of controllers by `check.py`: the least over inputs, targets and seeds."""

    def _table() -> list[Part]:
        make = BENCHMARK.format("margins")
        rows = results.rows("margins.csv", make)
        cells = []
        for plant, planning in dict.fromkeys((row["plant"], row["planning"]) for row in rows):
            own = [row for row in rows if (row["plant"], row["planning"]) == (plant, planning)]
            least = [f"{min(float(row[name]) for row in own):.3g}" for name in MARGINS]
            lost, draws = (sum(int(row[name]) for row in own) for name in ("unstable_draws", "draws"))
            cells.append([plant, planning, str(len(own)), *least, f"{lost} of {draws}"])
        header = ["plant", "planning", "seeds", *MARGINS.values(), "not stable with other coefficients"]
        return [Text(results.source("margins.csv", make, rows)), Table(header, cells)]

    words = (
        "What `check.py` finds on the identified model: the least margins over inputs, targets and seeds, and with how "
        "many plants whose coefficients differ from the model's the loop is not stable."
    )
    return Section("Beyond the paper: margins of the controllers", [Text(words), *each(_table, ())])


@styled
def _error_bars(rows: Sequence[Row], published: Mapping[str, float]) -> Figure:
    """Draw a bar per model, the shortest at the top of each panel, and lines where others are.

    A model whose simulation runs away has words in the place of a bar, as its error is no number.

    Args:
        rows: Rows of a rig with `metric`, `model`, `value` and `unit`.
        published: Errors of others in the same unit, by what they are.
    """
    metrics = list(dict.fromkeys(row["metric"] for row in rows))
    figure, axes = panels(len(metrics), size=(7.0, 1.0 + 1.6 * len(metrics)), sharex=False)
    for axis, metric in zip(axes, metrics, strict=True):
        own = sorted((row for row in rows if row["metric"] == metric), key=lambda row: -float(row["value"]))
        values = [float(row["value"]) for row in own]
        finite = [*filter(math.isfinite, values), *published.values()] or [1.0]
        low, high = 0.5 * min(finite), 2 * max(finite)
        widths = [value if math.isfinite(value) else low for value in values]
        bars = axis.barh([_name(row) for row in own], widths, color=[_colour(row) for row in own])
        clear = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # lines of others may run through a number
        words = [f"{value:g}" if math.isfinite(value) else "runs away" for value in values]
        axis.bar_label(bars, words, padding=3, bbox=clear)
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())  # each bar has its number
        for dashes, (name, value) in zip(("--", ":"), published.items(), strict=False):
            axis.axvline(value, color=BLACK, linestyle=dashes, label=f"{name}, {value:g} {own[0]['unit']}")
        axis.set_xlim(low, high)
        if high / low < 100:  # a single power of ten, or two, give no scale
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_xlabel(f"{metric} [{own[0]['unit']}]")
        if published:
            axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


@styled
def _error_courses(rows: Sequence[Row]) -> Figure:
    """Draw the errors of each model over a log, each in a panel with limits of its own, ours first.

    Args:
        rows: Rows of a rig with `model`, `seconds`, `error` and `unit`.
    """
    models = sorted(dict.fromkeys(row["model"] for row in rows), key=lambda name: not name.startswith("ours"))
    figure, axes = panels(len(models), size=(7.0, 0.6 + 1.1 * len(models)))
    for axis, model in zip(axes, models, strict=True):
        own = [row for row in rows if row["model"] == model]
        axis.plot([float(row["seconds"]) for row in own], [float(row["error"]) for row in own], color=_colour(own[0]))
        axis.axhline(0.0, color=BLACK, linewidth=0.6)
        axis.set_title(_name(own[0]), loc="left")
        axis.set_ylabel(f"error [{own[0]['unit']}]")
    time_axis(axes[-1], [float(row["seconds"]) for row in rows])
    return figure


def _name(row: Row) -> str:
    return "PySINDy" if row["model"] == "pysindy" else row["model"]


def _colour(row: Row) -> str:
    return BLUE if row["model"].startswith("ours") else GREY


def _whole_table(results: Results, title: str, name: str, make: str) -> Section:
    """Return a section of a table as it stands."""

    def _table() -> list[Part]:
        rows = results.rows(name, make)
        header = [column.replace("_", " ") for column in rows[0]] if rows else []
        return [Text(results.source(name, make, rows)), Table(header, [list(row.values()) for row in rows])]

    return Section(title, each(_table, ()))


def _cases(rows: Sequence[Row], columns: Mapping[str, str], with_metric: bool = False) -> Table:
    """Return a row per plant, case and scenario of planning by gradient, each in words."""
    cells = []
    for key, group in _grouped(rows, ("plant", "case", "scenario", "plant_seconds", "metric")).items():
        plant, case, scenario, seconds, metric = key
        bare = scenario.removesuffix("_nis").removesuffix("_inputs")
        stem = bare.removesuffix("_integral")
        judged = SCENARIO_WORDS.get(stem, stem.replace("_", " ")) + ", integral action" * (stem != bare)
        what = [CASE_WORDS.get(case, case.replace("_", " ")), judged, seconds, _seeds(group)]
        what += [MEASURED.get(metric, metric)] if with_metric else []
        cells.append([plant, *what, *(_over([row[name] for row in group]) for name in columns)])
    header = ["plant", "case", "judged on", "plant time [s]", "seeds", *(["error"] if with_metric else [])]
    return Table([*header, *columns.values()], cells)


def _controllers(rows: Sequence[Row]) -> Table:
    """Return a row per controller and a column per metric."""
    metrics = list(dict.fromkeys(row["metric"] for row in rows))
    cells = []
    for key, own in _grouped(rows, ("controller", "model", "real_seconds")).items():
        groups = _grouped(own, ("metric",))
        pairs = [
            " / ".join(_over([row[axis] for row in groups[metric,]]) for axis in AXES.values())
            if (metric,) in groups
            else "-"
            for metric in metrics
        ]
        first = next(iter(groups.values()))
        cells.append([*key, _seeds(first), *pairs, _over([row["ms_per_action"] for row in first])])
    words = [f"{WORDS.get(metric, metric)} [{UNITS.get(metric, '-')}]" for metric in metrics]
    return Table(["controller", "model", "plant time [s]", "seeds", *words, "ms per action"], cells)


def _grouped(rows: Sequence[Row], key: Sequence[str]) -> dict[tuple[str, ...], list[Row]]:
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in key), []).append(row)
    return groups


def _seeds(rows: Sequence[Row]) -> str:
    return str(len({row["seed"] for row in rows}))


def _over(cells: Sequence[str]) -> str:
    """Return the interquartile mean of numbers, the numbers if there are too few, or how many cells have none."""
    if missing := sum(not cell for cell in cells):
        return "-" if missing == len(cells) else f"none in {missing} of {len(cells)}"
    values = torch.as_tensor(np.array([float(cell) for cell in cells]))
    shown = values if len(values) < FEWEST else interquartile_mean(values).unsqueeze(0)
    return ", ".join(f"{value:.3g}" for value in shown.tolist())
