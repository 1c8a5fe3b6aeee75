"""Identify a model from a source of data, judge it on data it has not seen, and write down what was found."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.data.csv import Column, CsvLog, infer
from dynasindy.data.simulated import disturb, record
from dynasindy.data.table import all_headings, split_unit
from dynasindy.excitation import Excitation, HeldRandom
from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions
from dynasindy.world_models import FitReport, SindyModel
from dynasindy.world_models.prediction import nrmse, one_step_error, open_loop
from dynasindy.world_models.tables import to_csv, to_latex, to_text

ExcitationBuilder = Callable[..., Excitation]
LONGEST = 1e8
"""Steps of a simulated plant, beyond which a recording would take days."""
UNEXPLAINED = 0.05
"""Part of a rate of change, and of a state predicted open loop, that may be missed by a model that predicts."""


@dataclass(frozen=True)
class Source:
    """Hold data to identify from and data to judge on.

    Attributes:
        signature: names, units and ranges of states and inputs.
        training: transitions to fit.
        validation: transitions that the fit does not see.
        notes: sentences on how the data came about.
    """

    signature: Signature
    training: Transitions
    validation: Transitions
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Simulated:
    """Take data from a simulated plant.

    Attributes:
        dt: time between two samples [s]; inputs are held for a control period of 0.05 s.
        noise: standard deviation of white measurement noise, relative to that of each state.
        substeps: Runge-Kutta steps of the plant between two samples.
        validation_seconds: length of the validation, random held inputs [s].
        seed: seed of noise and validation.

    Raises:
        ValueError: a time or the substeps are not positive, or the noise is negative.
    """

    dt: float = 0.01
    noise: float = 0.0
    substeps: int = 10
    validation_seconds: float = 20.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.dt > 0 or not self.validation_seconds > 0 or not self.noise >= 0 or self.substeps < 1:
            raise ValueError(
                f"data=simulated got dt {self.dt} s, validation {self.validation_seconds} s, noise {self.noise}, "
                f"substeps {self.substeps}; allowed are positive times, noise >= 0 and substeps >= 1: correct them"
            )

    def load(self, system: System | None, excitation: ExcitationBuilder) -> Source:
        """Excite the plant for training, and by random held inputs of the same range for validation.

        Raises:
            ValueError: there is no plant.
        """
        if system is None:
            raise ValueError("data=simulated got no plant; it needs one of conf/system: give system=NAME, or data=csv")
        signal = excitation(n_u=system.signature.n_u, seed=self.seed)
        steps = max(signal.duration, self.validation_seconds) / self.dt * self.substeps
        if steps > LONGEST:
            raise ValueError(
                f"excitation.duration={signal.duration:g} s or data.validation_seconds={self.validation_seconds:g} s, "
                f"with data.dt={self.dt:g} s and data.substeps={self.substeps}, is {steps:.3g} steps of the plant; "
                f"allowed are {LONGEST:g}, an arbitrary limit: shorten it"
            )
        unseen = HeldRandom(
            system.signature.n_u,
            self.validation_seconds,
            signal.dt,
            amplitude=(0.7 * signal.amplitude).tolist(),
            offset=signal.offset.tolist(),
            seed=self.seed + 1,
        )
        training = record(system, signal.samples(self.dt), self.dt, self.substeps)
        validation = record(system, unseen.samples(self.dt), self.dt, self.substeps)
        left_out = signal.samples(self.dt).shape[0] - len(training)
        notes = (f"{left_out} samples that touched a stop were left out",) if left_out else ()
        return Source(system.signature, disturb(training, self.noise, self.seed), validation, notes)


@dataclass(frozen=True)
class Logged:
    """Take data from a CSV file; the last part of it is kept for validation.

    Attributes:
        path: the file.
        states: column map of the states, see `CsvLog`; the heading, or heading, unit, scale, derivative_of. Without a
            map the names are those of the plant, or what the headings say where no plant is named.
        inputs: column map of the inputs, likewise.
        time: heading of the time column [s].
        dt: sampling time [s]; the file's own by default.
        missing: `skip` rows with missing values, or `refuse` the file.
        known: equations that are known, by state. A state that is the rate of another one needs no column: one that
            has none is estimated with the model.
        validation_share: part of the transitions that is kept for validation.

    Raises:
        ValueError: there is no path, or the share is not between 0 and 1.
    """

    path: str | None
    states: dict[str, Any] | None = None
    inputs: dict[str, Any] | None = None
    time: str = "time"
    dt: float | None = None
    missing: str = "skip"
    known: dict[str, str] | None = None
    validation_share: float = 0.25

    def __post_init__(self) -> None:
        if not self.path:
            raise ValueError("data=csv got no path; allowed is a CSV file: give data.path=log.csv")
        if not 0 < self.validation_share < 1:
            raise ValueError(f"data=csv got validation_share {self.validation_share}; allowed is between 0 and 1")
        if self.dt is not None and not self.dt > 0:
            raise ValueError(f"data=csv got dt {self.dt} s; allowed is a positive time, or null for the file's own")

    def load(self, system: System | None, excitation: ExcitationBuilder) -> Source:
        """Read the file; of the plant the names are used at most, and nothing of the excitation."""
        states, inputs = self._columns(system)
        log = CsvLog(str(self.path), states, inputs, self.time, self.dt, self.missing)  # type: ignore[arg-type]
        recording = log.read()
        data, place = recording.transitions, torch.arange(len(recording.transitions))
        cut = int(len(data) * (1 - self.validation_share))
        signature = recording.signature
        if system is not None and signature.state_names == system.signature.state_names:
            unseen = data.x.isnan().all(0).tolist()
            ranges = zip(unseen, system.signature.x_scale, signature.x_scale, strict=True)
            signature = replace(signature, x_scale=tuple(plant if blind else own for blind, plant, own in ranges))
        return Source(signature, data.select(place < cut), data.select(place >= cut), recording.notes)

    def _columns(self, system: System | None) -> tuple[dict[str, Any], dict[str, Any]]:
        if self.states and self.inputs:
            return self.states, self.inputs
        if system is None:
            states, inputs = infer(str(self.path), self.time)
            states = {n: c for n, c in states.items() if n not in (self.inputs or {})}
        else:
            plant, rates = system.signature, set((self.known or {}).values())
            headings = {split_unit(heading)[0] for heading in all_headings(Path(str(self.path)))}
            states = {
                n: Column("" if n in rates and n not in headings else n, unit)
                for n, unit in zip(plant.state_names, plant.state_units, strict=True)
            }
            inputs = {n: Column(n) for n in plant.input_names}
        return self.states or dict(states), self.inputs or dict(inputs)


@dataclass(frozen=True)
class Identified:
    """Hold a fitted model and its figures.

    Attributes:
        model: the model.
        report: of the fit.
        predicted: open-loop prediction of the validation data, `(N, n_x)`.
        metrics: error of each state, one step ahead and open loop.
    """

    model: SindyModel
    report: FitReport
    predicted: Tensor
    metrics: dict[str, dict[str, float]]


def identify(model: SindyModel, source: Source) -> Identified:
    """Fit a model and predict the validation data: one step ahead, and open loop over 400 control periods.

    Raises:
        TypeError: The model is not sparse.
        ValueError: It refuses the data.
    """
    if not isinstance(model, SindyModel):
        raise TypeError(
            f"world_model is a {type(model).__name__}, which has no coefficients to identify; choose world_model=sindy "
            "or another that builds a SindyModel"
        )
    report = model.fit(source.training)
    predicted = open_loop(model, source.validation)
    names = source.signature.state_names
    errors = {
        "one_step_error": one_step_error(model, source.validation),
        "open_loop_nrmse": nrmse(predicted, source.validation),
    }
    metrics = {what: dict(zip(names, e.tolist(), strict=True)) for what, e in errors.items()}
    return Identified(model, report, predicted, metrics)


def to_words(found: Identified, source: Source) -> str:
    """Write equations, fit, identifiability, errors and notes for a reader."""
    lines = [*found.model.equations(), "", found.report.to_text(), "", "validation, relative to each state's deviation"]
    for state in source.signature.state_names:
        one, free = (found.metrics[k][state] for k in ("one_step_error", "open_loop_nrmse"))
        lines.append(f"  {state:<10} one step {_percent(one)}, open loop {_percent(free)}")
    return "\n".join([*lines, *(f"note: {n}" for n in source.notes), *_verdict(found)])


def _percent(error: float) -> str:
    return f"{100 * error:.3g} %" if math.isfinite(error) else "runs away"


def _verdict(found: Identified) -> list[str]:
    """Say in a line that a model does not predict, nothing of one that does."""
    free, rates = found.metrics["open_loop_nrmse"], found.report.residual
    # Noise of the samples stays unexplained too: a state that is predicted open loop counts for its rate.
    poor = [s for s, r in rates.items() if r > UNEXPLAINED and not free[s] < UNEXPLAINED]
    reasons = [f"{s}' is {_percent(rates[s])} unexplained" for s in poor]
    if not all(math.isfinite(error) for error in free.values()):
        reasons.insert(0, "open loop it runs away")
    elif lost := [s for s, error in free.items() if error > 1]:
        # Either the model is wrong or the state hardly moves there; both want other data to be told apart.
        reasons.insert(0, f"open loop {', '.join(lost)} is off by more than its own spread in the validation part")
    advice = "name the plant by system=NAME, choose another library, or excite longer"
    return [f"this model does not predict: {', '.join(reasons)}; {advice}"] if reasons else []


def write(found: Identified, source: Source, folder: Path) -> None:
    """Write model.json, metrics.json, report.txt and the coefficients as text, LaTeX and CSV."""
    folder.mkdir(parents=True, exist_ok=True)
    library, coefficients = found.model.library, found.model.coefficients
    found.model.save(folder / "model.json")
    (folder / "metrics.json").write_text(json.dumps(found.metrics, indent=1) + "\n")
    (folder / "report.txt").write_text(to_words(found, source) + "\n")
    (folder / "coefficients.txt").write_text(to_text(library, coefficients) + "\n")
    (folder / "coefficients.tex").write_text(to_latex(library, coefficients))
    (folder / "coefficients.csv").write_text(to_csv(library, coefficients))
