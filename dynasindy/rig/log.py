"""A log of a flight as `identify.py data=csv` reads it, written row by row, so that nothing is lost when it ends."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from types import TracebackType

from dynasindy.rig.base import Array, Wiring


def heading(wiring: Wiring) -> list[str]:
    """Return the headings of a log: time, the states that are measured, and the inputs, each with its unit."""
    signature = wiring.signature
    states = zip(signature.state_names, signature.state_units, wiring.seen, strict=True)
    measured = [f"{name} [{unit}]" for name, unit, known in states if known]
    return ["time [s]", *measured, *(f"{name} [-]" for name in signature.input_names)]


class Log:
    """Write time, measured states and inputs; a state that no sensor sees has no column.

    Args:
        path: File to write; its folder is made if missing.
        wiring: Names, units, and which states are measured.

    Raises:
        ValueError: The file exists already; what it holds would be lost.
        OSError: The file cannot be written.
    """

    def __init__(self, path: Path, wiring: Wiring) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.rows = path, 0
        self._places = [i for i, known in enumerate(wiring.seen) if known]
        try:
            self._file = path.open("x", newline="", encoding="utf-8", buffering=1)  # a line at a time reaches the file
        except FileExistsError as error:
            raise ValueError(f"{path} exists already; give another folder, so that no log is lost") from error
        self._writer = csv.writer(self._file)
        self._writer.writerow(heading(wiring))

    def add(self, t: float, y: Array, u: Array) -> None:
        """Write what was measured at a time and the inputs applied from then on; what is missing stays empty."""
        cells = [float(y[i]) for i in self._places] + [float(value) for value in u]
        self._writer.writerow([f"{t:.6f}", *("" if math.isnan(v) else f"{v:.9g}" for v in cells)])
        self.rows += 1

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Log:
        """Return the log."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Close the file."""
        self.close()
