"""Sections on learning and control: the paper's figures 11 to 15."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from dynasindy.evaluation.metrics import MIN_STEP
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.learning import average_rewards
from dynasindy.viz.report.document import Part, Picture, Section, Table, Text
from dynasindy.viz.report.in_full import TABLE, course, courses, how_far, longer
from dynasindy.viz.report.sources import CASES, MODEL_FREE, SETTINGS, MissingResult, Results, Run, each, listed, told
from dynasindy.viz.report.verdicts import (
    MANY,
    NONE,
    REWARDS,
    SINE,
    SQUARE,
    STEPS,
    rewards_agree,
    sine_agrees,
    square_agrees,
    steps_agree,
)
from dynasindy.viz.response import step_response, tracking
from dynasindy.viz.run import periods, stacked

ABLATION = "python scripts/ablation.py system={} experiment={}"
FIRST = "The first of the 64 targets, the one nearest to three quarters of the upper ends,"
"""Which target a saved step response is of, see `step_references`."""
AXES = {"alpha_a": "azimuth", "alpha_p": "pitch"}

Rows = list[dict[str, str]]


def rewards(results: Results) -> Section:
    """Return figure 11, the average rewards of 0, 400 and 800 rollouts."""

    def _of(plant: str, experiment: str) -> list[Part]:
        make = ABLATION.format(plant, experiment)
        rows, runs = (
            _chosen(results.rows(f"{name}.csv", make), plant, experiment, make)
            for name in ("ablation_curves", "ablation")
        )
        found = {name: seeds for name in SETTINGS if (seeds := _seeds(rows, name))}
        episodes = _common(found.values())
        curves, errors = (
            {
                SETTINGS[name]: np.array([[value(seed[k]) for k in episodes] for seed in seeds])
                for name, seeds in found.items()
            }
            for value in (lambda row: float(row["evaluated_return"]), _error)
        )
        ends = {words: values[:, -1].tolist() for words, values in errors.items() if episodes}
        drawn = [row for row in runs if row["setting"] in found]
        to_level = {SETTINGS[name]: _to_level(runs, name) for name in found}
        to_level |= {
            f"{words} ({_lengths(runs, name)} episodes)": reached
            for name, words in MODEL_FREE.items()
            if (reached := _to_level(runs, name))
        }
        title = f"Dyna-style vs. direct TD3, average rewards: plant {plant}, experiment {experiment}"
        last = max(episodes, default=0.0)
        single = longer(results, plant, experiment, last)
        return [
            *rewards_agree(told(plant, experiment), curves, to_level, ends),
            Picture(
                f"average_rewards_{plant}_{experiment}",
                average_rewards(curves, episodes, window=1, title=title, log=True, longer=courses(single)),
                f"Return of the policy without noise over 64 fixed steps after real episodes, up to {last:g} of them: "
                "interquartile mean and 95 % bootstrap interval over seeds, or a line for each seed where there are "
                f"fewer than three.{how_far(single, last)}",
                results.of_runs("ablation_curves.csv", drawn) + f" Thin lines: {results.source(TABLE)}" * bool(single),
            ),
            *course(results, single, told(plant, experiment), last),
        ]

    words = (
        "The paper plots the average reward over training episodes without planning, with 400 and with 800 rollouts: "
        "very low at first, higher and rising sooner with planning, soonest with 800 (about 180 episodes), all three "
        "nearly the same at the end. In `experiment=dyna` the runs without planning make as many gradient updates as "
        "the others; in `experiment=paper` they are direct TD3. Where the level is compared, other agents without a "
        "model stand beside them, as far as the ablation has them."
    )
    found = each(_of, *CASES, statements=REWARDS)
    return Section("Figure 11: Dyna-Style vs. Direct TD3 average rewards", [Text(words), *found])


def steps(results: Results) -> Section:
    """Return figures 12 and 13, step tracking of both axes in the three settings."""

    def _of(plant: str, experiment: str) -> list[Part]:
        runs = {words: results.compared(plant, experiment, name) for name, words in SETTINGS.items()}
        tables = {words: run.table("data/step_response.csv") for words, run in runs.items()}
        first = next(iter(tables.values()))
        outputs = {words: stacked(table, tuple(AXES)) for words, table in tables.items()}
        inputs = {words: periods(table, SIGNATURE.input_names)[1] for words, table in tables.items()}
        figure = step_response(
            periods(first, SIGNATURE.input_names)[0],
            stacked(first, [f"reference_{name}" for name in AXES]),
            outputs,
            inputs,
            tuple(AXES),
            SIGNATURE,
            f"Step tracking: plant {plant}, experiment {experiment}",
        )
        scores = {words: run.record("metrics.json")["evaluation"] for words, run in runs.items()}
        caption = f"{FIRST} on `{plant}`, of the first seed after {_episodes(runs)} real episodes."
        caption += _other(results, plant, experiment, runs)
        return [
            *steps_agree(told(plant, experiment), scores),
            Text(
                f"**Plant `{plant}`, `experiment={experiment}`**: means over 64 targets, first seed; overshoot: median "
                f"over those{_counted(scores)} that move the axis by {100 * MIN_STEP:g} % of the range of its targets."
            ),
            _score_table(scores, {"steady-state error [rad]": "steady_state_error", "overshoot [%]": "overshoot"}),
            Picture(f"step_{plant}_{experiment}", figure, caption, " ".join(run.source for run in runs.values())),
        ]

    words = (
        "Figure 12 of the paper tracks an azimuth step, figure 13 a pitch step: without planning both axes settle away "
        "from the reference (azimuth about 0.08 rad), 400 rollouts come closer with more overshoot, 800 rollouts have "
        "the smallest steady-state error and, on pitch, little overshoot."
    )
    title = "Figures 12 and 13: azimuth and pitch step trajectory tracking"
    statements = [one for stated in STEPS.values() for one in stated]
    return Section(title, [Text(words), *each(_of, *CASES, statements=statements)])


def wave(results: Results, shape: str) -> Section:
    """Return figure 14 (`shape` is "sine") or 15 ("square"), with and without the model."""

    def _of(plant: str, experiment: str) -> list[Part]:
        runs = {SETTINGS[name]: results.compared(plant, experiment, name) for name in ("rollouts_800", "rollouts_0")}
        tables = {words: run.table(f"evaluation/{shape}.csv") for words, run in runs.items()}
        first = tables[MANY]
        target = stacked(first, [f"reference_{name}" for name in AXES])
        outputs = {words: stacked(table, tuple(AXES)) for words, table in tables.items()}
        title = f"{shape.capitalize()} wave: plant {plant}, experiment {experiment}"
        figure = tracking(first["time"], target, outputs, None, tuple(AXES), title=title)
        judge = sine_agrees if shape == "sine" else square_agrees
        return [
            *judge(told(plant, experiment), first["time"], target, outputs[MANY], outputs[NONE]),
            Picture(
                f"{shape}_{plant}_{experiment}",
                figure,
                f"The {shape} wave on `{plant}`, after {_episodes(runs)} real episodes."
                + _other(results, plant, experiment, runs),
                " ".join(run.source for run in runs.values()),
            ),
        ]

    sine = (
        "The paper tracks a sine (azimuth 0.35 rad, pitch 0.25 rad, 0.015 Hz) after 2500 episodes with the model and "
        "about 4500 without. With it both axes follow after a transient, pitch with small deviations at first; "
        "without it they follow too, with more oscillation."
    )
    square = (
        "The paper tracks a square wave (azimuth 0.4 rad, pitch -0.5 rad, 0.01 Hz). With the model both axes reach "
        "each level with little steady-state error and spikes at the jumps; without it the steady-state error is "
        "larger and the spikes are smaller."
    )
    number, words = (14, sine) if shape == "sine" else (15, square)
    statements = [one for stated in (SINE if shape == "sine" else SQUARE).values() for one in stated]
    found = each(_of, *CASES, statements=statements)
    return Section(f"Figure {number}: {shape} wave tracking, with and without the model", [Text(words), *found])


def _chosen(rows: Rows, plant: str, experiment: str, make: str) -> Rows:
    """Return the rows of an experiment on a plant.

    Raises:
        MissingResult: There is none.
    """
    found = [row for row in rows if (row["system"], row["experiment"]) == (plant, experiment)]
    if not found:
        raise MissingResult(f"Not measured: average rewards of `{experiment}` on {plant}; `{make}` makes them.")
    return found


def _seeds(rows: Rows, setting: str) -> list[dict[float, dict[str, str]]]:
    """Return the evaluated rows of each seed of a setting, by episode."""
    seeds: dict[str, dict[float, dict[str, str]]] = {}
    for row in rows:
        if row["setting"] == setting and row["evaluated_return"]:
            seeds.setdefault(row["seed"], {})[float(row["episode"])] = row
    return list(seeds.values())


def _common(settings: Iterable[list[dict[float, dict[str, str]]]]) -> list[float]:
    """Return the episodes after which every seed of every setting was evaluated: nothing else is comparable."""
    found = [set(seed) for seeds in settings for seed in seeds]
    return sorted(set.intersection(*found)) if found else []


def _error(row: Mapping[str, str]) -> float:
    """Return the steady-state error of the worse axis [rad], NaN where the row has none."""
    cells = [cell for name, cell in row.items() if name.startswith("evaluated_steady_state_error/")]
    return max(map(float, cells)) if cells and all(cells) else np.nan


def _to_level(runs: Rows, setting: str) -> list[float]:
    """Return the real episodes to the required level of each seed, infinite where it was never reached."""
    return [float(row["episodes_to_level"] or np.inf) for row in runs if row["setting"] == setting]


def _lengths(runs: Rows, setting: str) -> str:
    """Return after how many episodes the runs of a setting ended, as "never" says little of short ones."""
    return " or ".join(dict.fromkeys(f"{float(row['episodes']):g}" for row in runs if row["setting"] == setting))


def _counted(scores: Mapping[str, Mapping[str, float | None]]) -> str:
    """Say how many targets are steps of each axis, as far as the runs have noted it."""
    found = {tuple(score.get(f"steps/{name}") for name in AXES) for score in scores.values()}
    counts = next(iter(found)) if len(found) == 1 else ()
    told = [f"{count:g} on {axis}" for count, axis in zip(counts, AXES.values(), strict=False) if count is not None]
    return f" ({', '.join(told)})" if told else ""


def _score_table(scores: Mapping[str, Mapping[str, float | None]], metrics: Mapping[str, str]) -> Table:
    header = ["setting", *(f"{axis}, {words}" for words in metrics for axis in AXES.values())]
    rows = []
    for setting, score in scores.items():
        values = [score[f"{metric}/{name}"] for metric in metrics.values() for name in AXES]
        rows.append([setting, *("-" if value is None else f"{value:.3g}" for value in values)])
    return Table(header, rows)


def _other(results: Results, plant: str, experiment: str, runs: Mapping[str, Run]) -> str:
    """Say that figure 11 is of other runs than these, where those are longer or shorter."""
    lengths = results.lengths(plant, experiment)
    if not lengths or lengths == {int(run.setting("train.episodes")) for run in runs.values()}:
        return ""
    return (
        f" Figure 11 is of other runs, of {listed(map(str, sorted(lengths)))} episodes, whose policies are not saved."
    )


def _episodes(runs: Mapping[str, Run]) -> str:
    """Return the real episodes of each run in words."""
    counts = {words: int(run.setting("train.episodes")) for words, run in runs.items()}
    if len(set(counts.values())) == 1:
        return str(next(iter(counts.values())))
    return ", ".join(f"{count} ({words})" for words, count in counts.items())
