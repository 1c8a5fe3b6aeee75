"""Sections on the model: the paper's figures 8 to 10 and its two tables."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from dynasindy.systems.transitions import Transitions
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.identification import BEYOND, CLOSES, OPENS, model_error, prediction
from dynasindy.viz.report.document import Listing, Part, Picture, Section, Table, Text
from dynasindy.viz.report.model_verdicts import (
    AGAIN,
    BEAM,
    CLOSELY,
    FALLS,
    ROTORS,
    coefficients_agree,
    coefficients_stated,
    first_model_agrees,
    hyperparameters_agree,
    hyperparameters_stated,
    last_model_agrees,
    learning_agrees,
)
from dynasindy.viz.report.published import HYPERPARAMETERS, XI
from dynasindy.viz.report.sources import CASES, PLANTS, Results, Run, each, told
from dynasindy.viz.report.thresholds import CLOSE
from dynasindy.viz.run import stacked
from dynasindy.viz.style import Array
from dynasindy.world_models import SindyModel
from dynasindy.world_models.models.prediction import open_loop

STATES, INPUTS = SIGNATURE.state_names, SIGNATURE.input_names


def hyperparameters(results: Results) -> Section:
    """Return table 1, beside the settings of the runs."""
    found: dict[str, Run] = {}

    def _look(name: str) -> list[Part]:
        found[name] = _any(results, name)
        return []

    notes = each(_look, ("paper",), ("dyna",))
    rows = [
        [words, symbol, f"{value:g}", f"`{key}`", *(f"{run.setting(key):g}" for run in found.values())]
        for words, symbol, value, key in HYPERPARAMETERS
    ]
    parts: list[Part] = [
        Text(
            "The settings of the saved runs: `experiment=paper` takes the paper's numbers, `experiment=dyna` is ours."
        ),
        Table(["parameter", "symbol", "the paper", "key", *(f"`experiment={name}`" for name in found)], rows),
    ]
    if "paper" in found:
        wrong = [key for _, _, value, key in HYPERPARAMETERS if found["paper"].setting(key) != value]
        plant = found["paper"].folder.name.partition("_")[0]
        parts.append(hyperparameters_agree(told(plant, "paper"), len(HYPERPARAMETERS), wrong))
    else:
        parts.append(hyperparameters_stated(len(HYPERPARAMETERS)).unmeasured(told(PLANTS[0], "paper")))
    parts += [Text(run.source) for run in found.values()]
    return Section("Table 1: agent training hyperparameters", parts + notes)


def learning_progress(results: Results) -> Section:
    """Return figure 8, the model's error over real episodes."""

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.compared(plant, experiment, "rollouts_800")
        table = run.table("gate.csv")
        episode, error, windows = (table[name] for name in ("episode", "reward_error", "judged_reward_error"))
        opened, below, above = episode[table["open"] == 1], run.setting("gate.open_below"), table["close_above"][-1]
        return [
            learning_agrees(told(plant, experiment), episode, error, opened, float(below)),
            Picture(
                f"model_learning_{plant}_{experiment}",
                model_error(
                    episode,
                    error,
                    what="reward error per period",
                    title=f"SINDy model learning progress: plant {plant}, experiment {experiment}",
                    thresholds={OPENS: float(below), CLOSES: float(above)},
                    judged=windows,
                ),
                "Mean difference of the reward per control period between the plant and the model. One curve is of the "
                "whole episode, replayed through the model that had not seen it. The other is of held-out windows and "
                "of the model that stays: this is the error that the gate compares with its levels, the straight lines."
                + " A mark at the upper edge stands where the replay ran away."
                * (not np.isfinite(error).all()),
                run.source,
            ),
        ]

    words = (
        "The paper plots the difference between the rewards of model and plant over training episodes: high while the "
        "model is untrained, then falling as it is refitted to real episodes."
    )
    found = each(_of, *CASES, statements=(FALLS,))
    return Section("Figure 8: SINDy model learning progress", [Text(words), *found])


def states(results: Results, when: str) -> Section:
    """Return figure 9 (`when` is "first") or 10 ("last"): predicted against real states."""
    before = when == "first"
    word = "before" if before else "after"

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.compared(plant, experiment, "rollouts_800")
        table = run.table(f"data/prediction_{when}_episode.csv")
        real, model = stacked(table, STATES), stacked(table, [f"predicted_{name}" for name in STATES])
        parts: list[Part] = [
            *(_before if before else _after)(told(plant, experiment), _errors(real, model)),
            _picture(f"states_{word}_{plant}_{experiment}", table["time"], real, model, run),
        ]
        if not before:
            parts += _chirp_again(run, plant, experiment)
        return parts

    words = (
        "The paper's model, fitted to 10 s of chirp alone, predicts the rotor speeds with small errors and has "
        "difficulty with angles and their rates."
        if before
        else "After training the paper applies the chirp again: the model's states lie almost on those of the plant."
    )
    words += (
        f" Here the {when} real episode is predicted open loop, from its start and its inputs alone, before the model "
        f"is fitted to it. A state is predicted well when its RMSE is under {CLOSE.value:g} % of its range. The axes "
        f"end at most {BEYOND:g} ranges beyond those of the plant; one that leaves them is called cut off."
    )
    number = 9 if before else 10
    title = f"Figure {number}: predicted and real states {word} reinforcement learning"
    statements = (ROTORS, BEAM) if before else (CLOSELY, AGAIN)
    return Section(title, [Text(words), *each(_of, *CASES, statements=statements)])


def coefficients(results: Results) -> Section:
    """Return table 2, the identified coefficients."""

    def _published(plant: str, experiment: str) -> list[Part]:
        run = results.compared(plant, experiment, "rollouts_800")
        model: dict[str, dict[str, float]] = run.record("model.json")["coefficients"]
        return [
            Text(f"**Plant `xi`, `experiment={experiment}`**: identified, with the published coefficient in brackets."),
            coefficients_agree(told(plant, experiment), model, XI),
            _xi_table(model, XI),
            Text(run.source),
        ]

    def _written(plant: str, experiment: str) -> list[Part]:
        run = results.compared(plant, experiment, "rollouts_800")
        model: dict[str, Any] = run.record("model.json")
        terms = sum(map(len, model["coefficients"].values()))
        return [
            Text(
                f"**Plant `{plant}`, `experiment={experiment}`**: another plant, of which the published numbers say "
                f"nothing; {terms} terms."
            ),
            Listing(
                [
                    line
                    for equation in model["equations"]
                    for line in textwrap.wrap(equation, 100, subsequent_indent="    ")
                ]
            ),
            Text(run.source),
        ]

    parts: list[Part] = [
        Text(
            "The paper prints the coefficients of its model. As the plant `xi` they are the truth, and identification "
            "has to find them: all of them, and no others."
        )
    ]
    parts += each(_published, ("xi", "dyna"), ("xi", "paper"), statements=(coefficients_stated(XI),))
    parts += each(_written, ("tras", "dyna"), ("tras", "paper"))
    return Section("Table 2: SINDy model Xi matrix", parts)


def _any(results: Results, experiment: str) -> Run:
    """Return a saved run of an experiment on either plant."""
    name = next((plant for plant in PLANTS if f"{plant}_{experiment}_rollouts_800" in results.settings), PLANTS[0])
    return results.compared(name, experiment, "rollouts_800")


def _errors(real: Array, model: Array) -> dict[str, float]:
    """Return the RMSE of each state in percent of its range, infinite where the model ran away."""
    span = np.ptp(real, axis=0)
    error = 100 * np.sqrt(np.mean((model - real) ** 2, axis=0)) / np.where(span > 0, span, 1.0)
    return dict(zip(STATES, np.nan_to_num(error, nan=np.inf).tolist(), strict=True))


def _before(case: str, errors: Mapping[str, float]) -> list[Part]:
    return [*first_model_agrees(case, errors)]


def _after(case: str, errors: Mapping[str, float]) -> list[Part]:
    return [last_model_agrees(case, CLOSELY, errors)]


def _picture(name: str, time: Array, real: Array, model: Array, run: Run) -> Picture:
    _, word, plant, experiment = name.split("_")
    title = f"Predicted and real states {word} learning: plant {plant}, experiment {experiment}"
    figure = prediction(time, real, model, SIGNATURE, title)
    return Picture(name, figure, f"Open-loop prediction of an episode on `{plant}`, `{experiment}`.", run.source)


def _chirp_again(run: Run, plant: str, experiment: str) -> list[Part]:
    """Apply the excitation to the final model, as the paper does."""
    table = run.table("data/excitation.csv")
    run.record("model.json")  # the model reads its file itself; this says what makes it where it is missing
    x = torch.as_tensor(stacked(table, STATES))
    u = torch.as_tensor(stacked(table, INPUTS))
    dt = float(table["time"][1] - table["time"][0])
    segment = torch.zeros(len(x) - 1, dtype=torch.int64)
    model = SindyModel.load(run.folder / "model.json")
    predicted = open_loop(model, Transitions(x[:-1], u[:-1], x[1:], dt, segment), int(run.setting("env.substeps") or 1))
    errors = _errors(x[1:].numpy(), predicted.numpy())
    return [last_model_agrees(told(plant, experiment), AGAIN, errors)]


def _xi_table(model: Mapping[str, Mapping[str, float]], truth: Mapping[str, Mapping[str, float]]) -> Table:
    names = list(dict.fromkeys(name for row in (*truth.values(), *model.values()) for name in row))

    def _cell(state: str, name: str) -> str:
        ours, true = model.get(state, {}).get(name), truth.get(state, {}).get(name)
        if ours is None and true is None:
            return ""
        return ("0" if ours is None else f"{ours:.5g}") + ("" if true is None else f" ({true:.5g})")

    rows = [[f"`{name}`", *(_cell(state, name) for state in STATES)] for name in names]
    return Table(["function", *(f"d `{state}`/dt" for state in STATES)], rows)
