"""Tables of words and numbers that a benchmark carries on: CSV files, cell by cell as they stand."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dynasindy.evaluation.given import read_cells

Row = dict[str, Any]


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a file, each cell as text; none if there is no file.

    Raises:
        DamagedFileError: It is no table.
    """
    if not path.exists():
        return []
    header, rows = read_cells(path)
    return [dict(zip(header, row)) for row in rows]


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a table whole, through a temporary file, so that an interruption loses no row."""
    temporary = path.with_suffix(".tmp")
    temporary.unlink(missing_ok=True)
    append_rows(temporary, columns, rows)
    temporary.replace(path)


def append_rows(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Append rows to a file, after a line of headings if it is new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerows(rows)
