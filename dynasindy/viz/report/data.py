"""Sections on the data that the first model is fitted to: the paper's figures 5 to 7."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.identification import excitation, training_data
from dynasindy.viz.report.document import Part, Picture, Section, Statement, Text
from dynasindy.viz.report.model_verdicts import CHIRP, SAMPLED, excitation_agrees, samples_agree
from dynasindy.viz.report.sources import PLANTS, Results, Run, each, told
from dynasindy.viz.run import Table, stacked

STATES, INPUTS = SIGNATURE.state_names, SIGNATURE.input_names


def chirp_input(results: Results) -> Section:
    """Return figure 5, the excitation."""
    words = (
        "The paper drives both inputs with one chirp over 10 s. Its printed formula stays within [0.707, 1] and does "
        "not sweep, so the sweep that is meant is used here, with inputs of different phase, around the hover point."
    )
    return _section("Figure 5: chirp input", words, results, (CHIRP, _chirp))


def training(results: Results) -> Section:
    """Return figures 6 and 7, the training data."""
    words = (
        "The paper plots rotor speeds (figure 6) and angles with their rates (figure 7) during the chirp. All six "
        "states are drawn here in one figure."
    )
    return _section("Figures 6 and 7: training data", words, results, (SAMPLED, _samples))


Judged = tuple[Statement, Callable[[str, Run, Table], list[Part]]]


def _section(title: str, words: str, results: Results, judged: Judged) -> Section:
    """Return words and what is shown of the excitation of each plant, by which a statement is judged."""
    statement, show = judged

    def _of(plant: str, experiment: str) -> list[Part]:
        run = results.compared(plant, experiment, "rollouts_800")
        return show(plant, run, run.table("data/excitation.csv"))

    return Section(title, [Text(words), *each(_of, *((plant, "dyna") for plant in PLANTS), statements=(statement,))])


def _chirp(plant: str, run: Run, table: Table) -> list[Part]:
    u = stacked(table, INPUTS)
    duration = table["time"][-1] + table["time"][1] - table["time"][0]
    ranges = ", ".join(f"`{name}` {u[:, k].min():.2f} to {u[:, k].max():.2f}" for k, name in enumerate(INPUTS))
    reversals = ", ".join(str(int(np.sum(np.diff(np.sign(np.diff(u[:, k]))) != 0))) for k in range(len(INPUTS)))
    return [
        excitation_agrees(told(plant, "dyna"), float(duration), f"{ranges}; turning points: {reversals}"),
        Picture(
            f"excitation_{plant}",
            excitation(table["time"], u, title=f"Excitation of {plant}"),
            f"Inputs that excite `{plant}`, held for a control period of 0.05 s.",
            run.source,
        ),
    ]


def _samples(plant: str, run: Run, table: Table) -> list[Part]:
    x, substeps = stacked(table, STATES), int(run.setting("env.substeps") or 1)
    azimuth, pitch = np.abs(x[:, :2]).max(0)
    samples, step = len(x) * substeps, (table["time"][1] - table["time"][0]) / substeps
    return [
        samples_agree(
            told(plant, "dyna"), samples, float(step), f"azimuth up to {azimuth:.2f} rad, pitch up to {pitch:.2f} rad"
        ),
        Picture(
            f"training_data_{plant}",
            training_data(table["time"], x, stacked(table, INPUTS), SIGNATURE, f"Training data of {plant}"),
            f"What the first model of `{plant}` was fitted to, drawn every 0.05 s.",
            run.source,
        ),
    ]
