"""Results on disk: an evaluation's figures as JSON, one row of its trajectory as CSV, and any table as CSV."""

import csv
import json
import re
from collections.abc import Sequence
from pathlib import Path

import torch

from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.summary import summarise
from dynasindy.systems import Signature


def save_evaluation(evaluation: Evaluation, folder: Path, row: int = 0) -> list[Path]:
    """Write `<scenario>.json` (the summary) and `<scenario>.csv` (states, inputs and references of one row).

    Args:
        evaluation: What to write.
        folder: Where; made if missing.
        row: Which reference goes into the CSV file.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures, table = (folder / f"{evaluation.scenario}.{suffix}" for suffix in ("json", "csv"))
    record = {"scenario": evaluation.scenario, "rows": len(evaluation.outputs), **summarise(evaluation)}
    figures.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n")
    signature = evaluation.signature
    header = [*signature.state_names, *signature.input_names]
    header += [f"reference_{name}" for name in evaluation.output_names]
    parts = (evaluation.trajectory["state"], evaluation.inputs, evaluation.references)
    values = torch.cat([evaluation.time.unsqueeze(-1), *(part[row] for part in parts)], -1)
    write_csv(table, with_units(["time", *header], signature), values.tolist())
    return [figures, table]


def with_units(names: Sequence[str], signature: Signature) -> list[str]:
    """Return headings of a table over time: `time [s]`, `alpha_a [rad]`, `reference_alpha_a [rad]`, `u_a [-]`."""
    units = {**dict(zip(signature.state_names, signature.state_units, strict=True)), "time": "s"}
    return [f"{name} [{units.get(re.sub('^(reference|predicted)_', '', name), '-')}]" for name in names]


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[float | None]]) -> None:
    """Write a table whole, through a temporary file, so that a reader never meets half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    with temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([["" if v is None else f"{v:.9g}" for v in row] for row in rows])
    temporary.replace(path)
