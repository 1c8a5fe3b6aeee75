"""Results on disk: an evaluation's figures as JSON, one row of its trajectory as CSV, and any table as CSV."""

import csv
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from dynasindy.evaluation.drawn import drawn
from dynasindy.evaluation.given import read_record
from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.summary import summarise
from dynasindy.systems import Signature


def save_evaluation(evaluation: Evaluation, folder: Path, row: int | None = None) -> list[Path]:
    """Write `<scenario>.json` (the summary) and `<scenario>.csv` (states, inputs and references of one row).

    Args:
        evaluation: What to write.
        folder: Where; made if missing.
        row: Which episode goes into the CSV file; the one that is drawn, if omitted.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures, table = (folder / f"{evaluation.scenario}.{suffix}" for suffix in ("json", "csv"))
    row = drawn(evaluation).row if row is None else row
    record = {"scenario": evaluation.scenario, "rows": len(evaluation.outputs), **summarise(evaluation)}
    write_json(figures, record)
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
    """Write a table whole; empty cells stand for None."""
    with whole(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([["" if v is None else f"{v:.9g}" for v in row] for row in rows])


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    with whole(path) as temporary:
        temporary.write_text(text)


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record whole, as JSON.

    Raises:
        ValueError: A number is not finite.
    """
    write_text(path, json.dumps(record, indent=2, allow_nan=False) + "\n")


def add_to_record(path: Path, key: str, value: Any) -> None:
    """Put a key into a record that is there, and leave all else of it, and the time at which it was written.

    Others tell by that time what was made after it, as evaluations of the run that it ended.

    Raises:
        DamagedFileError: It is no record.
        ValueError: A number is not finite.
    """
    record, written = read_record(path), path.stat()
    write_json(path, {**record, key: value})
    os.utime(path, ns=(written.st_atime_ns, written.st_mtime_ns))


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, and at the end put what was written in the place of `path`, all at once.

    A reader never meets half of a file. A full disk, a kill or a power cut leaves the earlier file as it was.

    Args:
        path: The file; its folder is made if missing.

    Raises:
        OSError: The file cannot be written; the earlier one stays.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        yield temporary
        # What is not on the disk when it is renamed may be an empty file after a power cut.
        _flush(temporary)
        temporary.replace(path)
        _flush(path.parent)
    except OSError as error:
        error.filename = error.filename or str(path)  # a full disk does not say whose file found no room
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Have a file or folder written to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
