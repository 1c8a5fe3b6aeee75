"""Sections of the paper's figures and tables, each beside ours."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import torch

from dynasindy.evaluation.metrics import MIN_STEP
from dynasindy.evaluation.statistics import over_seeds
from dynasindy.safe_io import read_rows
from dynasindy.sindy import SindyModel
from dynasindy.sindy.world_model import open_loop
from dynasindy.systems.transitions import Transitions
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.controllers import controller_name
from dynasindy.viz.framework import framework
from dynasindy.viz.identification import BEYOND, CLOSES, OPENS, excitation, model_error, prediction, training_data
from dynasindy.viz.learning import average_rewards
from dynasindy.viz.report import paper
from dynasindy.viz.report.document import Finding, Listing, Part, Picture, Section, Statement, Table, Text
from dynasindy.viz.report.paper import AXES
from dynasindy.viz.report.results import (
    ABLATION,
    CASES,
    MANY,
    NONE,
    PLANTS,
    SETTINGS,
    MissingResult,
    Results,
    Row,
    Run,
    case_name,
    each,
    listed,
)
from dynasindy.viz.report.verdicts import (
    Coefficients,
    judge_coefficients,
    judge_first_model,
    judge_last_model,
    judge_learning,
    judge_rewards,
    judge_sine,
    judge_square,
    judge_steps,
    verdict,
)
from dynasindy.viz.response import step_response, tracking
from dynasindy.viz.run import periods, stacked
from dynasindy.viz.style import Array

STATES, INPUTS = SIGNATURE.state_names, SIGNATURE.input_names
OURS = [(plant, "dyna") for plant in PLANTS]
MODEL_FREE = ("rollouts_0_tuned", "sb3_sac", "sb3_sac_5", "sb3_td3", "sb3_td3_5")
"""Other settings of the ablation that have no model, which planning is compared with too."""
FIRST = "The first of the 64 targets, the one nearest to three quarters of the upper ends,"
"""Which target a saved step response is of, see `step_references`."""
LONGER, LONGER_COMMAND = "paper_in_full.csv", "python scripts/train.py system={} experiment=paper"


def drawings() -> Section:
    """Return figures 1 to 4, which hold no data."""
    words = (
        "Drawings without data: the framework, the control loop, the rig and its schematic. The framework and the loop "
        "as they are here are drawn below; Algorithm 1 stands line by line beside the code in `docs/algorithm.md`, and "
        "the rig moves in `docs/figures/tras_sine.gif`."
    )
    caption = "What acts on the plant, what is learnt from it, and where experience goes."
    picture = Picture("framework", framework(), caption, "Drawn by `dynasindy.viz.framework`, of no run.")
    return Section("Figures 1 to 4: framework, control loop, rig, schematic", [Text(words), picture])


def chirp(results: Results) -> Section:
    """Return figure 5, the excitation."""

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.ablation_run(plant, experiment, "rollouts_800")
        table = run.table("data/excitation.csv")
        time, u = table["time"], stacked(table, INPUTS)
        duration = float(time[-1] + time[1] - time[0])
        ranges = ", ".join(f"`{name}` {u[:, k].min():.2f} to {u[:, k].max():.2f}" for k, name in enumerate(INPUTS))
        turns = ", ".join(str(int(np.sum(np.diff(np.sign(np.diff(column))) != 0))) for column in u.T)
        ours = f"{duration:.4g} s, {ranges}; turning points: {turns}"
        return [
            Finding(paper.CHIRP, case_name(plant, experiment), ours, verdict(abs(duration - 10) < paper.LASTS.value)),
            Picture(
                f"excitation_{plant}",
                excitation(time, u, title=f"Excitation of {plant}"),
                f"Inputs that excite `{plant}`, held for a control period of 0.05 s.",
                run.source,
            ),
        ]

    words = (
        "The paper drives both inputs with one chirp over 10 s. Its printed formula stays within [0.707, 1] and does "
        "not sweep, so the sweep that is meant is used here, with inputs of different phase, around the hover point."
    )
    return Section("Figure 5: chirp input", [Text(words), *each(_of, *OURS, statements=[paper.CHIRP])])


def training(results: Results) -> Section:
    """Return figures 6 and 7, the training data."""

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.ablation_run(plant, experiment, "rollouts_800")
        table = run.table("data/excitation.csv")
        x, substeps = stacked(table, STATES), int(run.setting("env.substeps") or 1)
        azimuth, pitch = np.abs(x[:, :2]).max(0)
        samples, step = len(x) * substeps, (table["time"][1] - table["time"][0]) / substeps
        ours = f"{samples} samples, {step:.3g} s apart; azimuth up to {azimuth:.2f} rad, pitch up to {pitch:.2f} rad"
        as_many = verdict(samples == paper.SAMPLES.value)
        return [
            Finding(paper.SAMPLED, case_name(plant, experiment), ours, as_many),
            Picture(
                f"training_data_{plant}",
                training_data(table["time"], x, stacked(table, INPUTS), SIGNATURE, f"Training data of {plant}"),
                f"What the first model of `{plant}` was fitted to, drawn every 0.05 s.",
                run.source,
            ),
        ]

    words = (
        "The paper plots rotor speeds (figure 6) and angles with their rates (figure 7) during the chirp. All six "
        "states are drawn here in one figure."
    )
    return Section("Figures 6 and 7: training data", [Text(words), *each(_of, *OURS, statements=[paper.SAMPLED])])


def hyperparameters(results: Results) -> Section:
    """Return table 1, beside the settings of the runs."""
    runs: dict[str, Run] = {}

    def _find(experiment: str) -> list[Part]:
        saved = (plant for plant in PLANTS if f"{plant}_{experiment}_rollouts_800" in results.settings)
        runs[experiment] = results.ablation_run(next(saved, PLANTS[0]), experiment, "rollouts_800")
        return [Text(runs[experiment].source)]

    sources = each(_find, ("paper",), ("dyna",))
    words = "The settings of the saved runs: `experiment=paper` takes the paper's numbers, `experiment=dyna` is ours."
    rows = [
        [name, symbol, f"{value:g}", f"`{key}`", *(f"{run.setting(key):g}" for run in runs.values())]
        for name, symbol, value, key in paper.HYPERPARAMETERS
    ]
    header = ["parameter", "symbol", "the paper", "key", *(f"`experiment={name}`" for name in runs)]
    finding = Finding(paper.TABLE_1, case_name(PLANTS[0], "paper"))
    if run := runs.get("paper"):
        wrong = [key for _, _, value, key in paper.HYPERPARAMETERS if run.setting(key) != value]
        ours = f"{len(rows) - len(wrong)} of them in `experiment=paper`" + "".join(f", not `{key}`" for key in wrong)
        case = case_name(run.folder.name.partition("_")[0], "paper")
        finding = Finding(paper.TABLE_1, case, ours, verdict(not wrong))
    return Section("Table 1: agent training hyperparameters", [Text(words), Table(header, rows), finding, *sources])


def learning_progress(results: Results) -> Section:
    """Return figure 8, the model's error over real episodes."""

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.ablation_run(plant, experiment, "rollouts_800")
        table = run.table("gate.csv")
        episode, error, windows = (table[name] for name in ("episode", "reward_error", "judged_reward_error"))
        opened, below, above = episode[table["open"] == 1], float(run.setting("gate.open_below")), table["close_above"]
        figure = model_error(
            episode,
            error,
            what="reward error per period",
            title=f"SINDy model learning progress: plant {plant}, experiment {experiment}",
            thresholds={OPENS: below, CLOSES: float(above[-1])},
            judged=windows,
        )
        caption = (
            "Mean difference of the reward per control period between the plant and the model. One curve is of the "
            "whole episode, replayed through the model that had not seen it. The other is of held-out windows and of "
            "the model that stays: this is the error that the gate compares with its levels, the straight lines."
        )
        caption += "" if np.isfinite(error).all() else " A mark at the upper edge stands where the replay ran away."
        return [
            judge_learning(case_name(plant, experiment), episode, error, opened, below),
            Picture(f"model_learning_{plant}_{experiment}", figure, caption, run.source),
        ]

    words = (
        "The paper plots the difference between the rewards of model and plant over training episodes: high while the "
        "model is untrained, then falling as it is refitted to real episodes."
    )
    parts = each(_of, *CASES, statements=[paper.FALLS])
    return Section("Figure 8: SINDy model learning progress", [Text(words), *parts])


def states(results: Results, when: str) -> Section:
    """Return figure 9 (`when` is "first") or 10 ("last"): predicted against real states."""
    before = when == "first"
    word = "before" if before else "after"

    def _of(plant: str, experiment: str) -> list[Part]:
        run, case = results.ablation_run(plant, experiment, "rollouts_800"), case_name(plant, experiment)
        table = run.table(f"data/prediction_{when}_episode.csv")
        real, model = stacked(table, STATES), stacked(table, [f"predicted_{name}" for name in STATES])
        errors = _state_errors(real, model)
        title = f"Predicted and real states {word} learning: plant {plant}, experiment {experiment}"
        picture = Picture(
            f"states_{word}_{plant}_{experiment}",
            prediction(table["time"], real, model, SIGNATURE, title),
            f"Open-loop prediction of an episode on `{plant}`, `{experiment}`.",
            run.source,
        )
        if before:
            return [*judge_first_model(case, errors), picture]
        again = judge_last_model(case, paper.AGAIN, _chirp_errors(run))
        return [judge_last_model(case, paper.CLOSELY, errors), picture, again]

    words = (
        "The paper's model, fitted to 10 s of chirp alone, predicts the rotor speeds with small errors and has "
        "difficulty with angles and their rates."
        if before
        else "After training the paper applies the chirp again: the model's states lie almost on those of the plant."
    )
    words += (
        f" Here the {when} real episode is predicted open loop, from its start and its inputs alone, before the model "
        f"is fitted to it. A state is predicted well when its RMSE is under {paper.CLOSE.value:g} % of its range. The "
        f"axes end at most {BEYOND:g} ranges beyond those of the plant; one that leaves them is called cut off."
    )
    title = f"Figure {9 if before else 10}: predicted and real states {word} reinforcement learning"
    statements = (paper.ROTORS, paper.BEAM) if before else (paper.CLOSELY, paper.AGAIN)
    return Section(title, [Text(words), *each(_of, *CASES, statements=statements)])


def coefficients(results: Results) -> Section:
    """Return table 2, the identified coefficients."""

    def _published(plant: str, experiment: str) -> list[Part]:
        run = results.ablation_run(plant, experiment, "rollouts_800")
        model: Coefficients = run.record("model.json")["coefficients"]
        return [
            Text(f"**Plant `xi`, `experiment={experiment}`**: identified, with the published coefficient in brackets."),
            judge_coefficients(case_name(plant, experiment), model, paper.XI),
            _coefficient_table(model),
            Text(run.source),
        ]

    def _equations(plant: str, experiment: str) -> list[Part]:
        run = results.ablation_run(plant, experiment, "rollouts_800")
        model = run.record("model.json")
        terms = sum(map(len, model["coefficients"].values()))
        words = f"another plant, of which the published numbers say nothing; {terms} terms."
        lines = [line for one in model["equations"] for line in textwrap.wrap(one, 100, subsequent_indent="    ")]
        return [Text(f"**Plant `{plant}`, `experiment={experiment}`**: {words}"), Listing(lines), Text(run.source)]

    words = (
        "The paper prints the coefficients of its model. As the plant `xi` they are the truth, and identification has "
        "to find them: all of them, and no others."
    )
    parts = each(_published, *CASES[:2], statements=[paper.TABLE_2])
    return Section("Table 2: SINDy model Xi matrix", [Text(words), *parts, *each(_equations, *CASES[2:])])


def rewards(results: Results) -> Section:
    """Return figure 11, the average rewards of 0, 400 and 800 rollouts."""

    def _of(plant: str, experiment: str) -> list[Part]:
        make = ABLATION.format(plant, experiment)
        rows, runs = (
            [row for row in results.rows(name, make) if (row["system"], row["experiment"]) == (plant, experiment)]
            for name in ("ablation_curves.csv", "ablation.csv")
        )
        if not rows or not runs:
            raise MissingResult(f"Not measured: average rewards of `{experiment}` on {plant}; `{make}` makes them.")
        seeds = {name: found for name in SETTINGS if (found := _by_seed(rows, name))}
        # What not every seed of every setting was evaluated after is not comparable.
        episodes = sorted(set.intersection(*(set(seed) for found in seeds.values() for seed in found)))
        curves, errors = (
            {
                SETTINGS[name]: np.array([[value(seed[k]) for k in episodes] for seed in found])
                for name, found in seeds.items()
            }
            for value in (lambda row: float(row["evaluated_return"]), _worst_error)
        )
        to_level: dict[str, list[float]] = {}
        for name in (*seeds, *MODEL_FREE):
            own = [row for row in runs if row["setting"] == name]
            lengths = " or ".join(dict.fromkeys(f"{float(row['episodes']):g}" for row in own))
            words = SETTINGS.get(name) or f"{controller_name(name)} ({lengths} episodes)"
            if own or name in seeds:
                to_level[words] = [float(row["episodes_to_level"] or np.inf) for row in own]
        last = max(episodes)
        longer = _longer(results, plant, last) if experiment == "paper" else {}
        caption = (
            f"Return of the policy without noise over 64 fixed steps after real episodes, up to {last:g} of them: "
            "interquartile mean and 95 % bootstrap interval over seeds, or a line for each seed where there are fewer "
            "than three."
        )
        caption += f" Thin lines are other runs, which went beyond episode {last:g}." if longer else ""
        drawn = [row for row in runs if row["setting"] in seeds]
        figure = average_rewards(
            curves,
            episodes,
            window=1,
            title=f"Dyna-style vs. direct TD3, average rewards: plant {plant}, experiment {experiment}",
            log=True,
            longer={name: [(run["episode"], run["return"]) for run in own] for name, own in longer.items()},
        )
        return [
            *judge_rewards(
                case_name(plant, experiment),
                curves,
                to_level,
                {words: values[:, -1].tolist() for words, values in errors.items()},
            ),
            Picture(
                f"average_rewards_{plant}_{experiment}",
                figure,
                caption,
                results.source("ablation_curves.csv", make, drawn),
            ),
            *_longer_table(results, plant, longer, last),
        ]

    words = (
        "The paper plots the average reward over training episodes without planning, with 400 and with 800 rollouts: "
        "very low at first, higher and rising sooner with planning, soonest with 800 (about 180 episodes), all three "
        "nearly the same at the end. In `experiment=dyna` the runs without planning make as many gradient updates as "
        "the others; in `experiment=paper` they are direct TD3. Where the level is compared, other agents without a "
        "model stand beside them, as far as the ablation has them."
    )
    parts = each(_of, *CASES, statements=paper.REWARDS)
    return Section("Figure 11: Dyna-Style vs. Direct TD3 average rewards", [Text(words), *parts])


def steps(results: Results) -> Section:
    """Return figures 12 and 13, step tracking of both axes in the three settings."""

    def _of(plant: str, experiment: str) -> list[Part]:
        runs = {words: results.ablation_run(plant, experiment, name) for name, words in SETTINGS.items()}
        tables = {words: run.table("data/step_response.csv") for words, run in runs.items()}
        scores = {words: run.record("metrics.json")["evaluation"] for words, run in runs.items()}
        first = next(iter(tables.values()))
        figure = step_response(
            periods(first, INPUTS)[0],
            stacked(first, [f"reference_{name}" for name in AXES]),
            {words: stacked(table, tuple(AXES)) for words, table in tables.items()},
            {words: periods(table, INPUTS)[1] for words, table in tables.items()},
            tuple(AXES),
            SIGNATURE,
            f"Step tracking: plant {plant}, experiment {experiment}",
        )
        metrics = {"steady_state_error": "steady-state error [rad]", "overshoot": "overshoot [%]"}
        keys = [f"{metric}/{name}" for metric in metrics for name in AXES]
        rows = [
            [words, *("-" if score[key] is None else f"{score[key]:.3g}" for key in keys)]
            for words, score in scores.items()
        ]
        header = ["setting", *(f"{axis}, {words}" for words in metrics.values() for axis in AXES.values())]
        about = (
            f"**Plant `{plant}`, `experiment={experiment}`**: means over 64 targets, first seed; overshoot: median "
            f"over those that move the axis by {100 * MIN_STEP:g} % of the range of its targets."
        )
        caption = f"{FIRST} on `{plant}`, of the first seed after {_episodes(results, plant, experiment, runs)}"
        source = " ".join(run.source for run in runs.values())
        return [
            *judge_steps(case_name(plant, experiment), scores),
            Text(about),
            Table(header, rows),
            Picture(f"step_{plant}_{experiment}", figure, caption, source),
        ]

    words = (
        "Figure 12 of the paper tracks an azimuth step, figure 13 a pitch step: without planning both axes settle away "
        "from the reference (azimuth about 0.08 rad), 400 rollouts come closer with more overshoot, 800 rollouts have "
        "the smallest steady-state error and, on pitch, little overshoot."
    )
    title = "Figures 12 and 13: azimuth and pitch step trajectory tracking"
    return Section(title, [Text(words), *each(_of, *CASES, statements=_both(paper.STEPS))])


def wave(results: Results, shape: str) -> Section:
    """Return figure 14 (`shape` is "sine") or 15 ("square"), with and without the model."""

    def _of(plant: str, experiment: str) -> list[Part]:
        chosen = ("rollouts_800", "rollouts_0")
        runs = {SETTINGS[name]: results.ablation_run(plant, experiment, name) for name in chosen}
        tables = {words: run.table(f"evaluation/{shape}.csv") for words, run in runs.items()}
        time, target = tables[MANY]["time"], stacked(tables[MANY], [f"reference_{name}" for name in AXES])
        outputs = {words: stacked(table, tuple(AXES)) for words, table in tables.items()}
        title = f"{shape.capitalize()} wave: plant {plant}, experiment {experiment}"
        judge = judge_sine if shape == "sine" else judge_square
        return [
            *judge(case_name(plant, experiment), time, target, outputs[MANY], outputs[NONE]),
            Picture(
                f"{shape}_{plant}_{experiment}",
                tracking(time, target, outputs, None, tuple(AXES), title=title),
                f"The {shape} wave on `{plant}`, after {_episodes(results, plant, experiment, runs)}",
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
    number, words, statements = (14, sine, paper.SINE) if shape == "sine" else (15, square, paper.SQUARE)
    title = f"Figure {number}: {shape} wave tracking, with and without the model"
    return Section(title, [Text(words), *each(_of, *CASES, statements=_both(statements))])


def _state_errors(real: Array, model: Array) -> dict[str, float]:
    """Return the RMSE of each state in percent of its range, infinite where the model ran away."""
    span = np.ptp(real, axis=0)
    error = 100 * np.sqrt(np.mean((model - real) ** 2, axis=0)) / np.where(span > 0, span, 1.0)
    return dict(zip(STATES, np.nan_to_num(error, nan=np.inf).tolist(), strict=True))


def _chirp_errors(run: Run) -> dict[str, float]:
    """Apply the excitation to the final model, as the paper does."""
    table = run.table("data/excitation.csv")
    run.record("model.json")  # the model reads its file itself; this says what makes it where it is missing
    x, u = (torch.as_tensor(stacked(table, names)) for names in (STATES, INPUTS))
    dt = float(table["time"][1] - table["time"][0])
    data = Transitions(x[:-1], u[:-1], x[1:], dt, torch.zeros(len(x) - 1, dtype=torch.int64))
    predicted = open_loop(SindyModel.load(run.folder / "model.json"), data, int(run.setting("env.substeps") or 1))
    return _state_errors(x[1:].numpy(), predicted.numpy())


def _coefficient_table(model: Coefficients) -> Table:
    def _cell(state: str, name: str) -> str:
        ours, true = model.get(state, {}).get(name), paper.XI.get(state, {}).get(name)
        if ours is None and true is None:
            return ""
        return ("0" if ours is None else f"{ours:.5g}") + ("" if true is None else f" ({true:.5g})")

    names = dict.fromkeys(name for row in (*paper.XI.values(), *model.values()) for name in row)
    rows = [[f"`{name}`", *(_cell(state, name) for state in STATES)] for name in names]
    return Table(["function", *(f"d `{state}`/dt" for state in STATES)], rows)


def _by_seed(rows: Iterable[Row], setting: str) -> list[dict[float, Row]]:
    """Return the evaluated rows of each seed of a setting, by episode."""
    seeds: dict[str, dict[float, Row]] = {}
    for row in rows:
        if row["setting"] == setting and row["evaluated_return"]:
            seeds.setdefault(row["seed"], {})[float(row["episode"])] = row
    return list(seeds.values())


def _worst_error(row: Row) -> float:
    """Return the steady-state error of the worse axis [rad], NaN where the row has none."""
    cells = [cell for name, cell in row.items() if name.startswith("evaluated_steady_state_error/")]
    return max(map(float, cells)) if cells and all(cells) else np.nan


def _longer(results: Results, plant: str, beyond: float) -> dict[str, list[dict[str, Array]]]:
    """Return the paper's experiment where it went on after an episode: a list of runs by setting, columns each."""
    file = results.folder / LONGER
    rows = [row for row in read_rows(file) if row["system"] == plant] if file.is_file() else []
    found: dict[str, list[dict[str, Array]]] = {}
    for setting, seed in dict.fromkeys((row["setting"], row["seed"]) for row in rows if row["setting"] in SETTINGS):
        own = [row for row in rows if (row["setting"], row["seed"]) == (setting, seed)]
        own.sort(key=lambda row: float(row["episode"]))
        episode, returns = (np.array([float(row[key]) for row in own]) for key in ("episode", "evaluated_return"))
        error = np.array([max(float(row[axis]) for axis in AXES.values()) for row in own])
        if episode[-1] > beyond:
            found.setdefault(SETTINGS[setting], []).append({"episode": episode, "return": returns, "error": error})
    return {name: found[name] for name in SETTINGS.values() if name in found}


def _longer_table(
    results: Results, plant: str, longer: Mapping[str, Sequence[Mapping[str, Array]]], beyond: float
) -> list[Part]:
    """Return how the runs that went on stood where the others ended, and at their own end."""
    rows = []
    for name, runs in longer.items():
        at = {after: [_at(run, after) for run in runs] for after in (beyond, np.inf, paper.SOON.value)}
        first = [float(min(run["episode"][run["error"] <= paper.LEVEL.value], default=np.inf)) for run in runs]
        returns = [over_seeds([float(run["return"].mean()) for run in runs], 4)]
        returns += [over_seeds([run["return"][k] for run, k in zip(runs, at[np.inf])], 4)]
        errors = [over_seeds([run["error"][k] for run, k in zip(runs, at[end])]) for end in (beyond, np.inf)]
        reached = sum(run["error"][k] <= paper.LEVEL.value for run, k in zip(runs, at[paper.SOON.value]))
        last = ", ".join(dict.fromkeys(f"{run['episode'][-1]:g}" for run in runs))
        level = [f"{reached} of {len(runs)}", over_seeds(first, infinite="never")]
        rows.append([name, str(len(runs)), last, *returns, *errors, *level])
    header = ["setting", "seeds", "episodes", "mean return of the whole curve", "return at the end"]
    header += [f"error after {beyond:g} [rad]", "error at the end [rad]", f"at the level after {paper.SOON.value:g}"]
    header += ["first episode at the level"]
    words = (
        f"**{case_name(plant, 'paper')}, the whole curve**: the statements are judged up to episode {beyond:g}, which "
        "every seed of every setting has reached; other runs went on. Interquartile means over seeds and 95 % "
        "bootstrap intervals, or each seed where there are fewer than three; the level is "
        f"{paper.LEVEL.value:g} rad on the worse axis. {results.source(LONGER, LONGER_COMMAND.format(plant))} The "
        "README beside it has all settings."
    )
    return [Text(words), Table(header, rows)] if rows else []


def _at(run: Mapping[str, Array], episode: float) -> int:
    """Return the place of an episode in a run, or of the last one before it that was evaluated."""
    return max(0, int(np.searchsorted(run["episode"], episode, side="right")) - 1)


def _episodes(results: Results, plant: str, experiment: str, runs: Mapping[str, Run]) -> str:
    """Return the real episodes of runs in words, and those of figure 11 where they differ."""
    counts = {words: run.episodes for words, run in runs.items()}
    words = listed(f"{count} ({name})" for name, count in counts.items())
    if len(set(counts.values())) == 1:
        words = str(next(iter(counts.values())))
    lengths = results.lengths(plant, experiment)
    if not lengths or set(lengths) == set(counts.values()):
        return f"{words} real episodes."
    other = f"Figure 11 is of other runs, of {listed(lengths)} episodes, whose policies are not saved."
    return f"{words} real episodes. {other}"


def _both(statements: Mapping[str, Sequence[Statement]]) -> list[Statement]:
    return [one for of_axis in statements.values() for one in of_axis]
