"""Sections beyond the paper: the gate, planning by gradient, other controllers, identification, speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from dynasindy.evaluation.metrics import UNITS
from dynasindy.evaluation.statistics import interquartile_mean
from dynasindy.evaluation.summary import WORDS
from dynasindy.evaluation.table import FEWEST
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.controllers import named
from dynasindy.viz.gate import gate
from dynasindy.viz.report.control import FIRST
from dynasindy.viz.report.document import Part, Picture, Section, Table, Text
from dynasindy.viz.report.sources import CASES, PLANTS, Results, each
from dynasindy.viz.response import step_response, tracking
from dynasindy.viz.run import periods, stacked

AXES = SIGNATURE.state_names[:2]
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
    "detuned": "flown with constants off by up to 10 %",
    "friction": "dry friction, learnt in episodes",
    "friction_alone": "dry friction, learnt from the excitation alone",
    "unseen": "trained on steps, flown elsewhere",
    "unseen_moving": "trained on steps, sines and squares, flown elsewhere",
}
"""What the cases of the benchmark are, in words."""
FLIGHT_WORDS = {
    "step": "64 steps",
    "detuned_gust": "64 steps in a gust",
    "edges": "16 targets on the edge of those trained on",
    "beyond": "16 targets beyond those trained on",
    "away": "64 steps from random starts",
    "noise_in_flight": "64 steps, noise in flight alone",
    "staircase": "eight targets, one after the other",
}
"""What is flown in them, in words."""
GRADIENT = (
    "Interquartile means over seeds (the value of each where there are fewer than three) of the errors over "
    "references; worst: of the worst reference. "
)
ERRORS = ("azimuth", "pitch", "azimuth_worst", "pitch_worst", "return", "wall_seconds")
ERROR_HEADER = (
    *("error", "azimuth [rad]", "pitch [rad]", "worst azimuth [rad]", "worst pitch [rad]"),
    *("return", "wall time [s]"),
)
BESIDES = (
    (
        CHANGE,
        "How much the inputs change from one control period to the next in the last 5 s, as parts of their half range:",
        ("azimuth", "pitch"),
        ("tail input [-]", "main input [-]"),
    ),
    (
        NIS,
        "The normalised innovation squared of the observer, which is 1 on average if all noise levels are right:",
        ("azimuth",),
        ("mean [-]",),
    ),
)
"""What the benchmark measures beside errors: its name, words, columns and their heading."""


def trust(results: Results) -> Section:
    """Return what the gate saw and decided in the runs with 800 rollouts."""

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.compared(plant, experiment, "rollouts_800")
        figure = gate(run.table("gate.csv"), f"Trust in the model: plant {plant}, experiment {experiment}")
        return [
            Picture(
                f"gate_{plant}_{experiment}",
                figure,
                f"Trust in the model of `{plant}`, `{experiment}`.",
                run.source,
            )
        ]

    words = "A model is used for planning only while it predicts the reward of real episodes that it has not seen."
    return Section("Beyond the paper: when the model is trusted", [Text(words), *each(_of, *CASES)])


def gradient(results: Results) -> Section:
    """Return planning by gradient: its table, and a step, sine and square of the main job."""

    def _tables() -> list[Part]:
        rows = results.rows("gradient.csv", "python scripts/benchmark.py gradient")
        errors = [row for row in rows if row["metric"] not in (CHANGE, NIS)]
        parts: list[Part] = [Text(GRADIENT + results.source("gradient.csv")), _flights(errors, ERRORS, ERROR_HEADER)]
        for metric, words, numbers, header in BESIDES:
            if found := [row for row in rows if row["metric"] == metric]:
                parts += [Text(words), _flights(found, numbers, header)]
        return parts

    def _of(plant: str, scenario: str) -> list[Part]:
        run = results.trained(plant)
        step = scenario == "step"
        columns = run.table("data/step_response.csv" if step else f"evaluation/{scenario}.csv")
        target = stacked(columns, [f"reference_{name}" for name in AXES])
        name = named("gradient")
        y = {name: stacked(columns, AXES)}
        time, inputs = periods(columns, SIGNATURE.input_names) if step else (columns["time"], None)
        u = None if inputs is None else {name: inputs}
        title = f"{scenario.capitalize()}, planning by gradient: plant {plant}"
        figure = (step_response if step else tracking)(time, target, y, u, title=title)
        cost = run.record("metrics.json")["cost"]
        what = FIRST if step else f"The {scenario}"
        caption = f"{what} on `{plant}` after {cost['plant_seconds']:.0f} s of plant time."
        return [Picture(f"gradient_{scenario}_{plant}", figure, caption, run.source)]

    words = (
        "The main job follows the gradient of the reward through the identified model instead of sampling imagined "
        "transitions: the policy is trained on the model, and judged on the plant."
    )
    cases = [(plant, scenario) for plant in PLANTS for scenario in ("step", "sine", "square")]
    return Section("Beyond the paper: planning by gradient", [Text(words), *each(_tables, ()), *each(_of, *cases)])


def baselines(results: Results) -> Section:
    """Return other controllers on the same plants."""

    def _table() -> list[Part]:
        rows = results.rows("baselines.csv", "python scripts/benchmark.py baselines")
        words = (
            "Interquartile means over seeds (the value of each where there are fewer than three), azimuth / pitch. "
            f"{results.source('baselines.csv')}"
        )
        parts: list[Part] = [Text(words)]
        for plant, scenario in dict.fromkeys((row["plant"], row["scenario"]) for row in rows):
            here = [row for row in rows if (row["plant"], row["scenario"]) == (plant, scenario)]
            parts += [Text(f"**Plant `{plant}`, {scenario}**"), _controllers(here)]
        return parts

    return Section("Beyond the paper: other controllers", each(_table, ()))


def identification(results: Results) -> Section:
    """Return what identification reaches, beside PySINDy."""

    def _table() -> list[Part]:
        rows = results.rows("identification.csv", "python scripts/benchmark.py identify")
        header = list(rows[0]) if rows else []
        return [Text(results.source("identification.csv")), Table(header, [list(row.values()) for row in rows])]

    return Section("Beyond the paper: identification", each(_table, ()))


def speed(results: Results) -> Section:
    """Return the time of a TD3 update beside other libraries."""

    def _table() -> list[Part]:
        rows = results.rows("td3.csv", "python scripts/benchmark.py td3")
        header = [name.replace("_", " ") for name in rows[0]] if rows else []
        return [Text(results.source("td3.csv")), Table(header, [list(row.values()) for row in rows])]

    return Section("Beyond the paper: speed of a TD3 update", each(_table, ()))


def _flights(rows: Sequence[Mapping[str, str]], numbers: Sequence[str], header: Sequence[str]) -> Table:
    """Return a row per plant, case and flight of planning by gradient, each in words."""
    key = ("plant", "case", "scenario", "plant_seconds", "metric")
    cells = []
    for plant, case, flight, seconds, metric, seeds, *values in _grouped(rows, key, numbers):
        what = CASE_WORDS.get(case, case.replace("_", " "))
        told = [MEASURED.get(metric, metric)] if "error" in header else []
        cells.append([plant, what, _flown(flight), seconds, seeds, *told, *values])
    return Table(["plant", "case", "flight", "plant time [s]", "seeds", *header], cells)


def _flown(flight: str) -> str:
    """Return what is flown in words: `step_integral_nis` is `64 steps, integral action`."""
    bare = flight.removesuffix("_nis").removesuffix("_inputs")
    stem = bare.removesuffix("_integral")
    return FLIGHT_WORDS.get(stem, stem.replace("_", " ")) + ", integral action" * (stem != bare)


def _controllers(rows: Sequence[Mapping[str, str]]) -> Table:
    """Return a row per controller and a column per metric."""
    key, numbers = ("controller", "model", "real_seconds"), ("azimuth", "pitch", "ms_per_action")
    found: dict[str, dict[tuple[str, ...], list[str]]] = {}
    for metric in dict.fromkeys(row["metric"] for row in rows):
        groups = _grouped([row for row in rows if row["metric"] == metric], key, numbers)
        found[metric] = {tuple(group[:3]): group for group in groups}
    cells = []
    for name in dict.fromkeys(name for groups in found.values() for name in groups):
        known = next(groups[name] for groups in found.values() if name in groups)
        pairs = [" / ".join(groups[name][4:6]) if name in groups else "-" for groups in found.values()]
        cells.append([*known[:4], *pairs, known[6]])
    header = ("controller", "model", "plant time [s]", "seeds", *(_heading(name) for name in found), "ms per action")
    return Table(header, cells)


def _heading(metric: str) -> str:
    return f"{WORDS.get(metric, metric)} [{UNITS.get(metric, '-')}]"


def _grouped(rows: Sequence[Mapping[str, str]], key: Sequence[str], numbers: Sequence[str]) -> list[list[str]]:
    """Return a row per group: its key, its number of seeds, and numbers over them."""
    groups: dict[tuple[str, ...], list[Mapping[str, str]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in key), []).append(row)
    return [
        [*names, str(len({row["seed"] for row in group})), *(_over([row[name] for row in group]) for name in numbers)]
        for names, group in groups.items()
    ]


def _over(cells: Sequence[str]) -> str:
    """Return the interquartile mean of numbers, the numbers if there are too few, or how many cells have none."""
    if missing := sum(not cell for cell in cells):
        return "-" if missing == len(cells) else f"none in {missing} of {len(cells)}"
    values = torch.as_tensor(np.array([float(cell) for cell in cells]))
    shown = values if len(values) < FEWEST else interquartile_mean(values).unsqueeze(0)
    return ", ".join(f"{value:.3g}" for value in shown.tolist())
