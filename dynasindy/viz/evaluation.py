"""The figures of an evaluation: one episode over time and, over many references, the error."""

from collections.abc import Sequence
from pathlib import Path

import torch
from matplotlib.figure import Figure
from torch import Tensor

from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.tracking_criteria import representative_episode
from dynasindy.viz.response import error_fan, step_response, tracking
from dynasindy.viz.style import ORANGE, legend_above, save_all, spell_names, styled


def draw_evaluation(
    evaluation: Evaluation,
    folder: Path,
    label: str = "policy",
    formats: Sequence[str] = ("png",),
    place: str = "",
) -> list[Path]:
    """Draw an evaluation into a folder, in files that begin with the scenario's name.

    Args:
        evaluation: What to draw.
        folder: Where; made if missing.
        label: Name of the controller in the legend.
        formats: File formats, e.g. ("png", "svg").
        place: Where it was flown, unless on the plant, such as "on a model".

    Returns:
        The files.
    """
    return save_all(evaluation_figures(evaluation, label, place=place), folder, formats)


def evaluation_figures(evaluation: Evaluation, label: str = "policy", place: str = "") -> dict[str, Figure]:
    """Return the figures by name of file: one episode over time and, of several ones, the spread of the error.

    Titles say which episode is shown, what disturbed it, and where it was flown, unless on the plant.
    """
    where = f" {place}" if place else ""
    shown = representative_episode(evaluation)
    row, name = shown.row, evaluation.scenario
    disturbed = (words.removeprefix(f"{name}: ") for words in evaluation.disturbances)  # which the name says already
    scenario = "; ".join([f"Scenario '{name}'{where}", *map(spell_names, disturbed)])
    title = "\n".join(filter(None, [scenario, shown.words]))
    if not evaluation.columns:
        return {name: _untracked(evaluation, label, row, title)}
    reference = evaluation.references[row]
    to_the_end = torch.cat([reference, reference[-1:]])  # of the state after the last period
    names = [f"{output} [{unit}]" for output, unit in evaluation.units.items()]
    # A constant reference is a step; what moves has no settling band.
    draw = step_response if bool((reference == reference[0]).all()) else tracking
    found = {
        name: draw(
            evaluation.time,
            to_the_end,
            {label: _states(evaluation, row)[:, list(evaluation.columns)]},
            {label: evaluation.inputs[row]},
            names,
            evaluation.signature,
            title=title,
        )
    }
    _shade(found[name], evaluation)
    if len(evaluation.outputs) > 1:
        found[f"{name}_errors"] = error_fan(
            evaluation.time,
            evaluation.outputs,
            evaluation.references,
            names,
            f"{scenario}: error over all references",
            [0.01 * box for box in evaluation.boxes] or [0.01],
        )
        _shade(found[f"{name}_errors"], evaluation)
    return found


def _untracked(evaluation: Evaluation, label: str, row: int, title: str) -> Figure:
    """Return all states of a row over time, where the task has no references."""
    signature = evaluation.signature
    names = [f"{name} [{unit}]" for name, unit in zip(signature.state_names, signature.state_units, strict=True)]
    x, u = {label: _states(evaluation, row)}, {label: evaluation.inputs[row]}
    figure = tracking(evaluation.time, None, x, u, names, signature, title)
    _shade(figure, evaluation)
    return figure


def _states(evaluation: Evaluation, row: int) -> Tensor:
    """Return the states of a row at the start of each control period, and at the end of the last, `(T + 1, n_x)`."""
    states, following = evaluation.trajectory["state"], evaluation.trajectory["next", "state"]
    return torch.cat([states[row], following[row, -1:]])


@styled
def _shade(figure: Figure, evaluation: Evaluation) -> None:
    """Shade when the plant was disturbed."""
    for start, end in evaluation.windows:
        for axis in figure.axes:
            axis.axvspan(start, end, color=ORANGE, alpha=0.2, lw=0, label="disturbed")
    if evaluation.windows:
        legend_above(figure.axes[0])
