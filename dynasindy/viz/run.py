"""The figures of a run folder, drawn from the files that the run wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dynasindy.safe_io import read_cells, read_json, reading
from dynasindy.systems import Signature
from dynasindy.viz.gate import gate, growing_error
from dynasindy.viz.identification import prediction, training_data
from dynasindy.viz.learning import learning_curve
from dynasindy.viz.response import tracking
from dynasindy.viz.style import save_figures

Table = dict[str, NDArray[np.float64]]


def read_table(path: Path) -> Table:
    """Read a CSV file with a header into columns, named without their units; empty cells become NaN.

    Raises:
        FileNotFoundError: The file does not exist.
        DamagedFileError: It is no table of numbers.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; give the folder of a finished run")
    header, rows = read_cells(path)
    with reading(path):
        cells = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows]).reshape(-1, len(header))
    return dict(zip((name.partition(" [")[0] for name in header), cells.T, strict=True))


def draw_run(
    folder: Path, signature: Signature, formats: tuple[str, ...] = ("png",), controller: str = "policy"
) -> list[Path]:
    """Draw every figure whose data a run folder holds.

    Args:
        folder: Run folder.
        signature: Names and units of the plant.
        formats: File formats, e.g. ("png", "svg").
        controller: What to call its controller.

    Returns:
        The files, in `folder/figures`.
    """
    return save_figures(_figures(folder, signature, controller), folder / "figures", formats)


def _figures(folder: Path, signature: Signature, controller: str) -> dict[str, Figure]:
    names, figures = signature.state_names, {}
    found = read_json(folder / "metrics.json") if (folder / "metrics.json").is_file() else {}
    excited = read_table(folder / "data" / "excitation.csv")
    time, u = excited["time"], stacked(excited, signature.input_names)
    left_out = folder / "data" / "left_out.json"
    figures["excitation"] = training_data(time, None, u, signature, "Excitation")
    figures["training_data"] = training_data(
        time,
        stacked(excited, names),
        u,
        signature,
        "\n".join(filter(None, ["Training data of the first model", found.get("excitation", "")])),
        left_out=read_json(left_out)["at_a_stop"] if left_out.is_file() else (),
    )
    for when, data in (("first", "the excitation alone"), ("last", "the data before it")):
        path = folder / "data" / f"prediction_{when}_episode.csv"
        if path.is_file():
            table = read_table(path)
            predicted = stacked(table, [f"predicted_{name}" for name in names])
            title = f"Open-loop prediction of the {when} real episode, model of {data}"
            figures[path.stem] = prediction(table["time"], stacked(table, names), predicted, signature, title)
            if when == "first":
                errors = (predicted - stacked(table, names)) / np.array(signature.x_scale)
                figures["model_error"] = growing_error(table["time"], np.sqrt(np.square(errors).mean(-1)))
    if (folder / "progress.csv").is_file():
        progress = read_table(folder / "progress.csv")
        at = np.isfinite(progress["evaluated_return"])
        episodes, returns = progress["episode"][at], progress["evaluated_return"][at]
        if found:  # the untrained policy stands at episode 0
            untrained = found["untrained"]["return"]
            episodes, returns = np.append(0, episodes), np.append(np.nan if untrained is None else untrained, returns)
        if len(progress["episode"]) > 1:  # the returns of a single one stand in the table, and make no curve
            figures["learning_curve"] = learning_curve(progress["episode"], progress["return"], episodes, returns)
    decisions = read_table(folder / "gate.csv") if (folder / "gate.csv").is_file() else {}
    if len(decisions.get("episode", ())) > 1:
        # A reward that was learnt is judged in deviations of what was paid, see `Task.unit`.
        unit = "deviations of the reward" if found.get("reward") else "reward per period"
        figures["gate"] = gate(decisions, unit=unit)
    which = found.get("drawn", {}).get("words", "")
    figures["step_response"] = _response(
        read_table(folder / "data" / "step_response.csv"), signature, which, controller
    )
    return figures


def _response(table: Table, signature: Signature, which: str, controller: str) -> Figure:
    """Draw the episode that the run saved; its title says which of how many it is."""
    tracked = [name.removeprefix("reference_") for name in table if name.startswith("reference_")]
    outputs = tracked or signature.state_names
    time, inputs = periods(table, signature.input_names)
    y, u = {controller: stacked(table, outputs)}, {controller: inputs}
    reference = stacked(table, [f"reference_{name}" for name in outputs]) if tracked else None
    step = reference is not None and bool((reference == reference[0]).all())
    title = "\n".join(filter(None, ["Step response" if step else "Response", which]))
    return tracking(time, reference, y, u, outputs, signature, title)


def periods(table: Table, inputs: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return when each control period of a flight begins, `(T,)` [s], and the inputs held during it, `(T, n_u)`.

    A last row of the table without inputs is the state at the end, and no period; tables of earlier runs have none.
    """
    time, u = table["time"], stacked(table, inputs)
    ended = len(u) > 1 and bool(np.isnan(u[-1]).all())
    return (time[:-1], u[:-1]) if ended else (time, u)


def stacked(table: Table, columns: Sequence[str]) -> NDArray[np.float64]:
    """Return columns of a table side by side, `(n_rows, n_columns)`."""
    return np.stack([table[column] for column in columns], -1)
