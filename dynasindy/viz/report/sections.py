"""Sections of the paper's figures and tables, each beside ours, and which of the paper's statements hold by `paper`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
import torch
from matplotlib.figure import Figure

from dynasindy.evaluation.statistics import interquartile_mean
from dynasindy.sindy import SindyModel
from dynasindy.sindy.world_model import open_loop
from dynasindy.systems.transitions import Transitions
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.controllers import controller_name
from dynasindy.viz.gate import gate
from dynasindy.viz.identification import BEYOND, prediction, training_data
from dynasindy.viz.learning import average_rewards
from dynasindy.viz.report import paper
from dynasindy.viz.report.document import Finding, Part, Picture, TextTable, Verdict
from dynasindy.viz.report.paper import AXES
from dynasindy.viz.report.results import (
    ABLATION,
    CASES,
    MANY,
    NONE,
    PLANTS,
    SETTINGS,
    SOME,
    Entry,
    MissingResult,
    Results,
    Row,
    Run,
)
from dynasindy.viz.response import tracking
from dynasindy.viz.run import Table as Columns
from dynasindy.viz.run import periods, stacked
from dynasindy.viz.style import Array

Coefficients = Mapping[str, Mapping[str, float]]
Score = Mapping[str, float | None]
STATES, INPUTS = SIGNATURE.state_names, SIGNATURE.input_names
TRACKED, REFERENCES = tuple(AXES), tuple(f"reference_{name}" for name in AXES)
OURS = [(plant, "dyna") for plant in PLANTS]
MODEL_FREE = ("rollouts_0_tuned", "sb3_sac", "sb3_sac_5", "sb3_td3", "sb3_td3_5")
"""Other settings of the ablation that have no model, which planning is compared with too."""
FIRST = "The first of the 64 targets, the one nearest to three quarters of the upper ends"
"""Which target a saved step response is of, see `step_references`."""
Made = Iterator[Part | Finding]


def _training(results: Results, plant: str, experiment: str) -> Made:
    run = results.run(plant, experiment)
    table = run.table("data/excitation.csv")
    x, substeps = stacked(table, STATES), int(run.setting("env.substeps") or 1)
    samples, step = len(x) * substeps, (table["time"][1] - table["time"][0]) / substeps
    figure = training_data(table["time"], x, stacked(table, INPUTS), SIGNATURE, f"Training data of {plant}")
    caption = f"What the first model of `{plant}` was fitted to: {samples} samples, {step:.3g} s apart, and the inputs."
    yield Picture(f"training_data_{plant}", figure, caption, run.source)


def _hyperparameters(results: Results, plant: str) -> Made:
    names = [name for name in ("paper", "dyna") if f"{plant}_{name}_rollouts_800" in results.settings]
    runs = {name: results.run(plant, name) for name in names or ["paper"]}
    rows = [
        [name, symbol, f"{value:g}", f"`{key}`", *(f"{run.setting(key):g}" for run in runs.values())]
        for name, symbol, value, key in paper.HYPERPARAMETERS
    ]
    header = ["parameter", "symbol", "the paper", "key", *(f"`experiment={name}`" for name in runs)]
    yield TextTable(header, rows, "\n".join(run.source for run in runs.values()))


def _model_learning(results: Results, plant: str, experiment: str) -> Made:
    run = results.run(plant, experiment)
    table = run.table("gate.csv")
    opened = table["episode"][table["open"] == 1]
    yield from _judge_learning(table["episode"], table["reward_error"], opened, float(run.setting("gate.open_below")))
    figure = gate(table, f"SINDy model learning progress: plant {plant}, experiment {experiment}")
    caption = f"Error of the model over the episodes on `{plant}`, `{experiment}`."
    yield Picture(f"model_learning_{plant}_{experiment}", figure, caption, run.source)


def _first_states(results: Results, plant: str, experiment: str) -> Made:
    errors, picture = _states(results, plant, experiment, "first", "before")
    yield _judge_model({name: error for name, error in errors.items() if name.startswith("omega_")})
    yield picture


def _last_states(results: Results, plant: str, experiment: str) -> Made:
    errors, picture = _states(results, plant, experiment, "last", "after")
    yield _judge_model(errors)
    yield picture
    # The excitation applied to the final model, as the paper does.
    run = results.run(plant, experiment)
    table = run.table("data/excitation.csv")
    run.record("model.json")  # the model reads its file itself; this says what makes it where it is missing
    x, u = (torch.as_tensor(stacked(table, names)) for names in (STATES, INPUTS))
    dt = float(table["time"][1] - table["time"][0])
    data = Transitions(x[:-1], u[:-1], x[1:], dt, torch.zeros(len(x) - 1, dtype=torch.int64))
    predicted = open_loop(SindyModel.load(run.folder / "model.json"), data, int(run.setting("env.substeps") or 1))
    yield _judge_model(_state_errors(x[1:].numpy(), predicted.numpy()))


def _states(results: Results, plant: str, experiment: str, episode: str, when: str) -> tuple[dict[str, float], Picture]:
    """Return the errors of an episode's open-loop prediction [% of each state's range], and its figure."""
    run = results.run(plant, experiment)
    table = run.table(f"data/prediction_{episode}_episode.csv")
    real, model = stacked(table, STATES), stacked(table, [f"predicted_{name}" for name in STATES])
    title = f"Predicted and real states {when} learning: plant {plant}, experiment {experiment}"
    figure = prediction(table["time"], real, model, SIGNATURE, title)
    caption = f"Open-loop prediction of an episode on `{plant}`, `{experiment}`."
    return _state_errors(real, model), Picture(f"states_{when}_{plant}_{experiment}", figure, caption, run.source)


def _state_errors(real: Array, model: Array) -> dict[str, float]:
    """Return the RMSE of each state in percent of its range, infinite where the model ran away."""
    span = np.ptp(real, axis=0)
    error = 100 * np.sqrt(np.mean((model - real) ** 2, axis=0)) / np.where(span > 0, span, 1.0)
    return dict(zip(STATES, np.nan_to_num(error, nan=np.inf).tolist(), strict=True))


def _coefficients(results: Results, plant: str, experiment: str, true: Coefficients = paper.XI) -> Made:
    run = results.run(plant, experiment)
    model: Coefficients = run.record("model.json")["coefficients"]
    yield from _judge_coefficients(model, true)
    yield f"**Plant `{plant}`, `experiment={experiment}`**: as identified, the published coefficient in brackets."
    names = dict.fromkeys(name for row in (*true.values(), *model.values()) for name in row)
    rows = [
        [f"`{name}`", *(_cell(model.get(one, {}).get(name), true.get(one, {}).get(name)) for one in STATES)]
        for name in names
    ]
    yield TextTable(["function", *(f"d `{state}`/dt" for state in STATES)], rows, run.source)


def _cell(ours: float | None, true: float | None) -> str:
    if ours is None and true is None:
        return ""
    return ("0" if ours is None else f"{ours:.5g}") + ("" if true is None else f" ({true:.5g})")


def _rewards(results: Results, plant: str, experiment: str) -> Made:
    make = ABLATION.format(plant, experiment)
    rows, runs = (
        [row for row in results.rows(name, make) if (row["system"], row["experiment"]) == (plant, experiment)]
        for name in ("ablation_curves.csv", "ablation.csv")
    )
    if not rows or not runs:
        raise MissingResult(f"Not measured: average rewards of `{experiment}` on {plant}; `{make}` makes them.")
    seeds: dict[str, dict[str, dict[float, Row]]] = {name: {} for name in SETTINGS}
    for row in rows:
        if row["setting"] in SETTINGS and row["evaluated_return"]:
            seeds[row["setting"]].setdefault(row["seed"], {})[float(row["episode"])] = row
    seeds = {name: of for name, of in seeds.items() if of}
    # What not every seed of every setting was evaluated after is not comparable.
    episodes = sorted(set.intersection(*(set(seed) for of in seeds.values() for seed in of.values())))
    curves = {
        SETTINGS[name]: np.array([[float(seed[k]["evaluated_return"]) for k in episodes] for seed in of.values()])
        for name, of in seeds.items()
    }
    to_level: dict[str, list[float]] = {}
    for name in (*seeds, *MODEL_FREE):
        own = [row for row in runs if row["setting"] == name]
        lengths = " or ".join(dict.fromkeys(f"{float(row['episodes']):g}" for row in own))
        words = SETTINGS.get(name) or f"{controller_name(name)} ({lengths} episodes)"
        if own or name in seeds:
            to_level[words] = [float(row["episodes_to_level"] or np.inf) for row in own]
    yield from _judge_rewards(curves, to_level)
    caption = f"Returns on `{plant}`, `{experiment}`, up to {episodes[-1]:g} real episodes."
    title = f"Dyna-style vs. direct TD3, average rewards: plant {plant}, experiment {experiment}"
    figure = average_rewards(curves, episodes, title)
    source = results.source("ablation_curves.csv", make, [row for row in runs if row["setting"] in seeds])
    yield Picture(f"average_rewards_{plant}_{experiment}", figure, caption, source)


def _steps(results: Results, plant: str, experiment: str) -> Made:
    runs = {words: results.run(plant, experiment, name) for name, words in SETTINGS.items()}
    _, figure = _draw_tracking(runs, "step", f"Step tracking: plant {plant}, experiment {experiment}")
    scores = {words: run.record("metrics.json")["evaluation"] for words, run in runs.items()}
    yield from _judge_steps(scores)
    caption = f"A step on `{plant}`, after {results.episodes(plant, experiment, SETTINGS)}."
    yield Picture(f"step_{plant}_{experiment}", figure, caption, "\n".join(run.source for run in runs.values()))


def _wave(results: Results, plant: str, experiment: str, shape: str) -> Made:
    settings = ("rollouts_800", "rollouts_0")
    runs = {SETTINGS[name]: results.run(plant, experiment, name) for name in settings}
    tables, figure = _draw_tracking(runs, shape, f"{shape.capitalize()} wave: plant {plant}, experiment {experiment}")
    output = stacked(tables[MANY], TRACKED)
    yield from (_judge_sine if shape == "sine" else _judge_square)(
        tables[MANY]["time"], stacked(tables[MANY], REFERENCES), output
    )
    caption = f"The {shape} wave on `{plant}`, after {results.episodes(plant, experiment, settings)}."
    yield Picture(f"{shape}_{plant}_{experiment}", figure, caption, "\n".join(run.source for run in runs.values()))


def _draw_tracking(runs: Mapping[str, Run], scenario: str, title: str) -> tuple[dict[str, Columns], Figure]:
    """Return the trajectories that runs saved of a scenario, and their figure."""
    file = "data/step_response.csv" if scenario == "step" else f"evaluation/{scenario}.csv"
    tables = {words: run.table(file) for words, run in runs.items()}
    first, names = next(iter(tables.values())), tuple(AXES)
    target, outputs = stacked(first, REFERENCES), {words: stacked(table, names) for words, table in tables.items()}
    time, inputs = first["time"], None
    if scenario == "step":
        time, inputs = periods(first, INPUTS)[0], {words: periods(table, INPUTS)[1] for words, table in tables.items()}
    return tables, tracking(time, target, outputs, inputs, title=title)


def _gradient_run(results: Results, plant: str, scenario: str) -> Made:
    run = results.run(plant, "gradient")
    title = f"{scenario.capitalize()}, policy of the main job: plant {plant}"
    _, figure = _draw_tracking({controller_name("gradient"): run}, scenario, title)
    seconds = run.record("metrics.json")["cost"]["plant_seconds"]
    caption = f"The {scenario} on `{plant}` after {seconds:.0f} s of plant time."
    yield Picture(f"gradient_{scenario}_{plant}", figure, caption, run.source)


def _judge_statement(ours: str, holds: bool | None, same: bool = False) -> Finding:
    """Return the judgement on a statement."""
    if holds is None:
        return Finding(ours)
    return Finding(ours, Verdict.HOLDS if holds else Verdict.SAME if same else Verdict.SHORT)


def _judge_learning(episode: Array, error: Array, opened: Array, below: float) -> list[Finding]:
    """Judge the reward error per period of each episode, `(n,)`, not finite where the replay ran away."""
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    first, last, most = (f"{error[k]:.2g} in episode {episode[k]:.0f}" for k in (0, -1, worst))
    trusted = f"trusted from episode {opened[0]:.0f}" if len(opened) else "never trusted"
    ours = f"per period {first}, {last}, at worst {most}; {trusted}, below {below:g} on held-out windows"
    fallen = bool(error[-1] < paper.FALL.value * error[0] and error[-1] < below)
    return [_judge_statement(ours, fallen or bool((error < below).all()))]


def _judge_model(errors: Mapping[str, float]) -> Finding:
    """Judge a model by the RMSE of each state [% of its range]."""
    words = ", ".join(f"`{name}` {error:.2g}" for name, error in errors.items())
    return _judge_statement(f"RMSE in % of range: {words}", max(errors.values()) < paper.CLOSE.value)


def _judge_coefficients(model: Coefficients, truth: Coefficients) -> list[Finding]:
    """Judge identified coefficients, by equation and function, against published ones."""
    true, ours = (
        {(state, name): value for state, row in one.items() for name, value in row.items()} for one in (truth, model)
    )
    hit, false = [key for key in true if key in ours], [key for key in ours if key not in true]
    worst = 100 * max((abs(ours[key] / true[key] - 1) for key in hit), default=np.inf)
    small = max((abs(model[s][name]) / max(map(abs, model[s].values())) for s, name in false), default=0.0)
    words = f"{len(hit)} of them found, the worst {worst:.2g} % off; {len(false)} functions besides"
    words += f", the largest {small:.1g} of the largest in its equation" if false else ""
    return [_judge_statement(words, len(hit) == len(true) and not false and worst < paper.COEFFICIENT.value)]


def _judge_rewards(curves: Mapping[str, Array], to_level: Mapping[str, Sequence[float]]) -> list[Finding]:
    """Judge returns per setting, `(n_seeds, n_evaluations)`, and real episodes to the level per setting and seed.

    Settings without returns are other agents without a model, all of which planning has to be ahead of.
    """
    mean = {name: _middle(returns.T) for name, returns in curves.items()}
    early = {
        name: float(values[: max(1, int(paper.EARLY.value * len(values)))].mean()) for name, values in mean.items()
    }
    level = {name: float(_middle(values)) for name, values in to_level.items()}
    planned = [name for name in (SOME, MANY) if name in mean]
    greater = sooner = converges = None
    soon = max((level[name] for name in planned), default=np.inf) <= paper.SOON.value
    if NONE in mean and planned:
        greater = all(early[name] > early[NONE] for name in planned)
        sooner = max(level[name] for name in planned) < min(level[name] for name in level if name not in planned)
    if len(planned) == 2:
        converges = level[MANY] < level[SOME]
    both = _levels_listed({name: level[name] for name in planned})
    return [
        _judge_statement(f"mean of the first {100 * paper.EARLY.value:g} %: {_levels_listed(early)}", greater),
        _judge_statement(f"real episodes to the level: {_levels_listed(level)}", sooner),
        _judge_statement(f"real episodes to the level: {both}", converges, soon),
    ]


def _judge_steps(scores: Mapping[str, Score]) -> list[Finding]:
    """Judge step tracking of the three settings by their `steady_state_error/<axis>` [rad]."""
    judgements, level = [], paper.LEVEL.value
    for name in paper.AXES:
        finals = {setting: score[f"steady_state_error/{name}"] for setting, score in scores.items()}
        error = {setting: np.inf if final is None else final for setting, final in finals.items()}
        planned = max(error[SOME], error[MANY])
        words = f"steady-state error [rad]: {_levels_listed(error, 'not finite')}"
        smallest = level >= error[MANY] < min(error[NONE], error[SOME])
        judgements += [
            _judge_statement(words, level >= planned < error[NONE]),
            _judge_statement(words, smallest, planned <= paper.FINE.value),
        ]
    return judgements


def _judge_sine(time: Array, target: Array, output: Array) -> list[Finding]:
    """Judge a sine, `(T, 2)` each: the reference, and the outputs with the model [rad]."""
    late = time >= paper.TRANSIENT.value
    rmse = np.sqrt(np.mean((output - target)[late] ** 2, axis=0))
    return _judge_waves(f"RMSE after {paper.TRANSIENT.value:g} s: {{:.3g}} rad of {{:.3g}} rad", rmse, target)


def _judge_square(time: Array, target: Array, output: Array) -> list[Finding]:
    """Judge a square wave, `(T, 2)` each: the reference, and the outputs with the model [rad]."""
    errors = [_at_levels(time, *axis) for axis in zip(target.T, output.T, strict=True)]
    words = f"{{:.3g}} rad over the last {paper.SETTLED.value:g} s of each level of {{:.3g}} rad"
    return _judge_waves(words, errors, target)


def _judge_waves(words: str, errors: Iterable[float], target: Array) -> list[Finding]:
    pairs = zip(errors, np.abs(target).max(0), strict=True)
    return [_judge_statement(words.format(*pair), bool(pair[0] < paper.FOLLOWS.value * pair[1])) for pair in pairs]


def _at_levels(time: Array, target: Array, y: Array) -> float:
    """Return the mean error at the end of each level."""
    errors = []
    for first, end in pairwise([0, *(np.flatnonzero(np.diff(target)) + 1).tolist(), len(target)]):
        late = np.arange(first, end)[time[first:end] > time[end - 1] - paper.SETTLED.value]
        errors.append(np.abs(y[late] - target[first]).mean())
    return float(np.mean(errors))


def _middle(values: Iterable[float] | Array) -> Array:
    """Return the interquartile mean of the last dimension."""
    return interquartile_mean(torch.as_tensor(np.asarray(values, dtype=np.float64))).numpy()


def _levels_listed(values: Mapping[str, float], infinite: str = "never") -> str:
    return ", ".join(f"{name} {infinite if np.isinf(value) else f'{value:.4g}'}" for name, value in values.items())


OPEN_LOOP = (
    " Here the {} real episode is predicted open loop, from its start and its inputs alone, before the model is fitted "
    f"to it. A state is predicted well when its RMSE is under {paper.CLOSE.value:g} % of its range. The axes end at "
    f"most {BEYOND:g} ranges beyond those of the plant; one that leaves them is called cut off."
)
SECTIONS: Sequence[Entry] = (
    Entry(
        "Figures 1 to 4: framework, control loop, rig, schematic",
        "Drawings without data: the framework, the control loop, the rig and its schematic. The framework as it is "
        "here is drawn in `docs/idea.md`; Algorithm 1 stands line by line beside the code in `docs/algorithm.md`, and "
        "the rig moves in `docs/figures/tras_sine.gif`.",
    ),
    Entry(
        "Figures 5 to 7: chirp input and training data",
        "The paper drives both inputs with one chirp over 10 s (figure 5). Its printed formula stays within [0.707, 1] "
        "and does not sweep, so the sweep that is meant is used here, with inputs of different phase, around the hover "
        "point. It plots rotor speeds (figure 6) and angles with their rates (figure 7) during the chirp: 1000 samples "
        "0.01 s apart. Inputs and all six states are drawn here in one figure.",
        [(_training, OURS)],
    ),
    Entry(
        "Table 1: agent training hyperparameters",
        "The settings of the saved runs: `experiment=paper` takes the paper's numbers, `experiment=dyna` is ours.",
        [(_hyperparameters, [("xi",)])],
    ),
    Entry(
        "Figure 8: SINDy model learning progress",
        "The paper plots the difference between the rewards of model and plant over training episodes: high while the "
        "model is untrained, then falling as it is refitted to real episodes. The upper panel has this difference per "
        "control period, of whole episodes replayed through a model that had not seen them, and of held-out windows, "
        "by which the gate decides whether the model is used for planning. The lower panel has the error of the states "
        "before and after each refit.",
        [(_model_learning, CASES)],
        paper.FALLS,
    ),
    Entry(
        "Figure 9: predicted and real states before reinforcement learning",
        "The paper's model, fitted to 10 s of chirp alone, predicts the rotor speeds with small errors and has "
        "difficulty with angles and their rates." + OPEN_LOOP.format("first"),
        [(_first_states, CASES)],
        paper.BEFORE,
    ),
    Entry(
        "Figure 10: predicted and real states after reinforcement learning",
        "After training the paper applies the chirp again: the model's states lie almost on those of the plant."
        + OPEN_LOOP.format("last"),
        [(_last_states, CASES)],
        paper.AFTER,
    ),
    Entry(
        "Table 2: SINDy model Xi matrix",
        "The paper prints the coefficients of its model. As the plant `xi` they are the truth, and identification has "
        "to find them: all of them, and no others.",
        [(_coefficients, CASES[:2])],
        paper.TABLE_2,
    ),
    Entry(
        "Figure 11: Dyna-Style vs. Direct TD3 average rewards",
        "The paper plots the average reward over training episodes without planning, with 400 and with 800 rollouts: "
        "very low at first, higher and rising sooner with planning, soonest with 800 (about 180 episodes), all three "
        "nearly the same at the end. In `experiment=dyna` the runs without planning make as many gradient updates as "
        "the others; in `experiment=paper` they are direct TD3. Where the level is compared, other agents without a "
        "model stand beside them, as far as the ablation has them. A return is that of the policy without noise "
        "over 64 fixed steps: interquartile mean and 95 % bootstrap interval over seeds, or a line for each seed "
        "where there are fewer than three.",
        [(_rewards, CASES)],
        paper.REWARDS,
    ),
    Entry(
        "Figures 12 and 13: azimuth and pitch step trajectory tracking",
        "Figure 12 of the paper tracks an azimuth step, figure 13 a pitch step: without planning both axes settle away "
        "from the reference (azimuth about 0.08 rad), 400 rollouts come closer with more overshoot, 800 rollouts have "
        "the smallest steady-state error and, on pitch, little overshoot. Errors are means over 64 targets, of the "
        f"first seed. {FIRST}, is drawn.",
        [(_steps, CASES)],
        paper.STEPS,
    ),
    Entry(
        "Figure 14: sine wave tracking, with and without the model",
        "The paper tracks a sine (azimuth 0.35 rad, pitch 0.25 rad, 0.015 Hz) after 2500 episodes with the model and "
        "about 4500 without. With it both axes follow after a transient, pitch with small deviations at first; "
        "without it they follow too, with more oscillation.",
        [(partial(_wave, shape="sine"), CASES)],
        paper.SINE,
    ),
    Entry(
        "Figure 15: square wave tracking, with and without the model",
        "The paper tracks a square wave (azimuth 0.4 rad, pitch -0.5 rad, 0.01 Hz). With the model both axes reach "
        "each level with little steady-state error and spikes at the jumps; without it the steady-state error is "
        "larger and the spikes are smaller.",
        [(partial(_wave, shape="square"), CASES)],
        paper.SQUARE,
    ),
    Entry(
        "Beyond the paper: planning by gradient",
        "The main job follows the gradient of the reward through the identified model instead of sampling imagined "
        "transitions: the policy is trained on the model, and judged on the plant. `docs/results/README.md` has its "
        "errors over seeds and cases and those of other controllers, `docs/identification.md` what identification "
        "reaches beside PySINDy.",
        [(_gradient_run, [(plant, scenario) for plant in PLANTS for scenario in ("step", "sine", "square")])],
    ),
)
"""The paper from its first figure to its last, and what is beyond it."""
