"""The log of a flight, as `identify.py data=csv` reads it: written row by row, and read for the errors at targets."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynasindy.rig.base import Array, Wiring
from dynasindy.systems import Signature
from dynasindy.text import unit_suffix


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
        self._writer.writerow(wiring.headings)

    def add(self, t: float, y: Array, u: Array) -> None:
        """Write what was measured at a time and the inputs applied from then on; what is missing stays empty."""
        cells = [float(y[i]) for i in self._places] + [float(value) for value in u]
        self._writer.writerow([f"{t:.6f}", *("" if math.isnan(v) else f"{v:.9g}" for v in cells)])
        self.rows += 1

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @staticmethod
    def read(path: Path, signature: Signature) -> tuple[Array, Array, Array]:
        """Return the times `(T,)` [s], states `(T, n_x)` and inputs `(T, n_u)` of the log of a flight.

        What was lost is NaN, and so is a state that is not measured. A row that was not written to its end is left out.
        """
        with path.open(newline="", encoding="utf-8") as file:
            headings, *rows = list(csv.reader(file))
        names = [heading.partition(" [")[0] for heading in headings]
        whole = [[float(cell) if cell else np.nan for cell in row] for row in rows if len(row) == len(names)]
        columns = np.array(whole).reshape(-1, len(names))
        table, missing = dict(zip(names, columns.T, strict=True)), np.full(len(columns), np.nan)
        states = np.stack([table.get(name, missing) for name in signature.state_names], -1)
        return table["time"], states, np.stack([table[name] for name in signature.input_names], -1)


LAST = 0.5
"""Part at the end of each target over which the error is taken."""


@dataclass(frozen=True)
class FlightRecord:
    """A flight over time, as its log has it.

    Attributes:
        signature: Names and units of the plant.
        names: Outputs.
        time: `(T,)` [s].
        references: Targets, `(T, n_r)`.
        outputs: What was measured, NaN where a sample was lost, `(T, n_r)`; all NaN of an output without a sensor.
        inputs: `(T, n_u)` in [-1, 1], NaN where a sample was lost.
        planned: Control periods that the flight was to last.
        fault: What ended it early, in words; empty if nothing did.
    """

    signature: Signature
    names: Sequence[str]
    time: Array
    references: Array
    outputs: Array
    inputs: Array
    planned: int
    fault: str = ""

    @classmethod
    def of(
        cls, path: Path, signature: Signature, names: Sequence[str], targets: Sequence[Sequence[float]], fault: str = ""
    ) -> FlightRecord:
        """Read the log of a flight, with as many rows as were flown, whose targets are given for all of its rows."""
        time, states, inputs = Log.read(path, signature)
        wanted = np.array([list(target) for target in targets], dtype=np.float64)[: len(time)]
        y = states[:, [signature.state_index(name) for name in names]]
        return cls(signature, names, time, wanted, y, inputs, len(targets), fault)

    @property
    def ends(self) -> NDArray[np.bool_]:
        """Rows over which errors are taken: the last part of each target, bool `(T,)`."""
        ends = np.zeros(len(self.time), dtype=bool)
        jumps = (np.diff(self.references, axis=0) != 0).any(-1)
        for start, stop in pairwise([0, *(np.flatnonzero(jumps) + 1).tolist(), len(ends)]):
            ends[round(stop - LAST * (stop - start)) : stop] = True
        return ends

    def errors(self) -> Array:
        """Return the mean absolute error of each output over the last part of each target, `(n_r,)`; NaN for none."""
        apart = np.abs(self.outputs - self.references)[self.ends]
        known = np.isfinite(apart)
        return np.where(known, apart, 0.0).sum(0) / np.where(known.any(0), known.sum(0), np.nan)

    def summary(self) -> str:
        """Return the errors in one line."""
        if not len(self.time):
            return "no period was flown, so there is no error to tell"
        told = []
        for name, error in zip(self.names, self.errors().tolist(), strict=True):
            unit = unit_suffix(self.signature.state_units[self.signature.state_index(name)])
            told.append(f"{name} to {error:.3g}{unit}" if np.isfinite(error) else f"{name} was not measured")
        return f"mean error over the last half of each target in {len(self.time)} periods: {', '.join(told)}"
