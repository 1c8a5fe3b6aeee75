"""What a flight shows: references, what was measured and the inputs, out of its log, and how near the targets."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynasindy.evaluation.symptoms import step_of
from dynasindy.rig.base import Array
from dynasindy.systems import Signature

LAST = 0.5
"""Part at the end of each target over which the error is taken."""


@dataclass(frozen=True)
class Shown:
    """Hold a flight over time.

    Attributes:
        names: Outputs.
        units: Their units.
        time: `(T,)` [s].
        references: Targets, `(T, n_r)`.
        outputs: What was measured, NaN where a sample was lost, `(T, n_r)`; all NaN of an output without a sensor.
        inputs: `(T, n_u)` in [-1, 1], NaN where a sample was lost.
        ends: Rows over which errors are taken: the last part of each target, bool `(T,)`.
        planned: Control periods that the flight was to last.
        fault: What ended it early, in words; empty if nothing did.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    time: Array
    references: Array
    outputs: Array
    inputs: Array
    ends: Array
    planned: int = 0
    fault: str = ""

    @classmethod
    def of(
        cls,
        path: Path,
        signature: Signature,
        outputs: Sequence[str],
        targets: Sequence[Sequence[float]],
        fault: str = "",
    ) -> Shown:
        """Read the log of a flight that held one target after the other, each for as long.

        Args:
            path: Log, with as many rows as were flown.
            signature: Names and units of the plant.
            outputs: Tracked states.
            targets: One number per output each, of every row, `(T, n_r)`.
            fault: What ended it early, in words.
        """
        time, states, inputs = samples(path, signature)
        places = [signature.state_index(name) for name in outputs]
        wanted = np.array([list(target) for target in targets], dtype=np.float64)[: len(time)]
        return cls(
            tuple(outputs),
            tuple(signature.state_units[place] for place in places),
            time,
            wanted,
            states[:, places],
            inputs,
            _ends(wanted),
            len(targets),
            fault,
        )

    def errors(self) -> Array:
        """Return the mean absolute error of each output over the last part of each target, `(n_r,)`; NaN for none."""
        apart = np.abs(self.outputs - self.references)[self.ends]
        known = np.isfinite(apart)
        return np.where(known, apart, 0.0).sum(0) / np.where(known.any(0), known.sum(0), np.nan)

    def words(self) -> str:
        """Return the errors in one line; one below the step of its sensor is no number of the plant."""
        if not len(self.time):
            return "no period was flown, so there is no error to tell"
        told = []
        for k, (name, unit, error) in enumerate(zip(self.names, self.units, self.errors().tolist(), strict=True)):
            step = step_of(self.outputs[:, k])
            if not np.isfinite(error):
                told.append(f"{name} was not measured")
            elif error < step:
                told.append(f"{name} within the sensor's step of {step:.3g} {unit}")
            else:
                told.append(f"{name} to {error:.3g} {unit}")
        # The last target of a flight that was cut short may hardly have been approached.
        short = f", of the {len(self.time)} periods of {self.planned} that were flown"
        flown = short if len(self.time) < self.planned else ""
        return f"mean error over the last half of each target{flown}: {', '.join(told)}"


def samples(path: Path, signature: Signature) -> tuple[Array, Array, Array]:
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


def _ends(targets: Array) -> Array:
    """Return the rows in the last part of each stretch with one target, bool `(T,)`."""
    ends = np.zeros(len(targets), dtype=bool)
    edges = [0, *(np.flatnonzero((np.diff(targets, axis=0) != 0).any(-1)) + 1).tolist(), len(targets)]
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        ends[round(stop - LAST * (stop - start)) : stop] = True
    return ends
