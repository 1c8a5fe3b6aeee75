"""Identify a model from a source of data, and judge it on data it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch import Tensor

from dynasindy.data.actuator_scaling import acting_as, with_actuator_ranges
from dynasindy.data.columns import Column, columns_of, infer, row_counter
from dynasindy.data.csv import CsvLog, Recording
from dynasindy.data.headings import named_by, split_unit
from dynasindy.data.rates import Mismatch, require_consistent_rates, unit_of_rate
from dynasindy.data.table import read_columns
from dynasindy.data.units import as_map, with_units
from dynasindy.findings import Finding, LogError, weak
from dynasindy.identification import verdict
from dynasindy.identification.equations import missing_nonlinearity
from dynasindy.identification.forecast_errors import (
    ForecastErrors,
    forecast_errors,
    relevant_horizons,
    with_start_states,
)
from dynasindy.identification.log_fit import LogFit, fit_log
from dynasindy.identification.signal_resolution import low_signal_findings, low_signal_states, resolved_errors
from dynasindy.identification.source import VALIDATION_SHARE, Source
from dynasindy.progress import report_progress
from dynasindy.sentences import setting
from dynasindy.sindy import FitReport, SindyModel
from dynasindy.sindy.delay import delay_and_trim, delay_inputs
from dynasindy.sindy.input_nonlinearity import InputNonlinearity, find_missing_nonlinearity
from dynasindy.sindy.reconstruction import find_missing_rates, rate_states
from dynasindy.sindy.world_model import nrmse, one_step_error, open_loop
from dynasindy.systems.base import Signature, System

if TYPE_CHECKING:
    from dynasindy.excitation import Excitation


@dataclass(frozen=True)
class LoggedData:
    """Take data from a CSV file; the last part of it is kept for validation.

    Attributes:
        path: the file, or a list of files with the same columns.
        states: column map of the states, see `CsvLog`; the heading, or heading, unit, scale, derivative_of. A list
            names columns as they are. Without either the names are those of the plant, or what the headings say where
            no plant is named.
        inputs: column map of the inputs, likewise.
        time: heading of the time column [s].
        dt: sampling time [s]; the file's own by default.
        missing: `skip` missing values, and rows without a time or an input, or `refuse` the file.
        known: equations that are known, by state. A state that is the rate of another one needs no column: one that
            has none is estimated with the model. Where no plant is named, it need not be named as a state either.
        validation_share: part of the transitions that is kept for validation.

    Raises:
        ValueError: there is no path, or the share is not between 0 and 1.
    """

    path: str | list[str] | None
    states: dict[str, Any] | list[str] | None = None
    inputs: dict[str, Any] | list[str] | None = None
    time: str = "time"
    dt: float | None = None
    missing: str = "skip"
    known: dict[str, str] | None = None
    validation_share: float = VALIDATION_SHARE

    def __post_init__(self) -> None:
        if not self.path:
            raise ValueError(
                f"there is no {setting('data.path')}; allowed is a file, or a list of some: give "
                f"{setting('data.path')}=log.csv"
            )
        if not isinstance(self.path, str) and len(set(self.path)) < len(self.path):
            raise ValueError(f"{setting('data.path')} names a file twice: {', '.join(self.path)}; give each file once")
        if not 0 < self.validation_share < 1:
            raise ValueError(
                f"{setting('data.validation_share')} is {self.validation_share}; allowed is between 0 and 1"
            )
        if self.dt is not None and not self.dt > 0:
            raise ValueError(f"{setting('data.dt')} is {self.dt} s; allowed is a time > 0, or none for the file's own")

    def load(self, system: System | None, excitation: Callable[..., Excitation]) -> Source:
        """Read the file, and add what it lacks; of the plant names, units and ends are used, nothing of the excitation.

        Rates that are known and that neither the file nor the plant has become states that the model tells.
        """
        source = Source.of(self.recording(None if system is None else system.signature), self.validation_share)
        told = self.known or {}
        names = {n: named_by(n, source.signature.state_names) for n in {*told, *told.values()}}
        known = {next(iter(names[s]), s): next(iter(names[r]), r) for s, r in told.items()}
        return source if system is not None and system.known else source.with_rates(known)

    def recording(self, plant: Signature | None) -> Recording:
        """Read the file, all of it.

        Args:
            plant: Names, units and ends of the plant that it is of; the file itself has to tell them where there is
                none. Of states without a column the ranges are used, too.
        """
        if (timed := self._timed()) != self.time:
            return replace(self, time=timed).recording(plant)
        findings: list[Finding] = []
        states, inputs = self._columns(plant, findings)
        own = plant is None  # a plant that is named has inputs in [-1, 1], or says their ends
        log = CsvLog(self._files, states, inputs, self.time, self.dt, self.missing, into_range=own)  # type: ignore[arg-type]
        recording = log.read()
        self._require_fit(recording, states)
        recording = replace(recording, findings=(*recording.findings, *findings))
        if plant is None:
            return recording
        signature = acting_as(recording.signature, plant)
        if signature.state_names == plant.state_names:
            unseen = recording.transitions.x.isnan().all(0).tolist()
            ranges = zip(unseen, plant.x_scale, signature.x_scale, strict=True)
            signature = replace(signature, x_scale=tuple(theirs if blind else own for blind, theirs, own in ranges))
        return replace(recording, signature=signature)

    def _timed(self) -> str:
        """Return the heading of the time: where the sampling time is given, a counter of rows will do."""
        if self.dt is None:
            return self.time
        given = [each for each in (self.states, self.inputs) if each]
        named = [_heading(n, each[n] if isinstance(each, Mapping) else n) for each in given for n in each]
        return row_counter(Path(self._files[0]), self.time, [split_unit(heading)[0] for heading in named])

    def _columns(self, plant: Signature | None, findings: list[Finding]) -> tuple[dict[str, Any], dict[str, Any]]:
        if plant is None:
            return self._read_off(findings)
        both = self.states, self.inputs
        given = [{name: name for name in each} if isinstance(each, list) else each for each in both]
        headings = read_columns(Path(self._files[0])).headings
        rates = set((self.known or {}).values())
        states = given[0] or {
            n: Column("" if n in rates and not named_by(n, headings) else n, unit)
            for n, unit in zip(plant.state_names, plant.state_units, strict=True)
        }
        return dict(states), with_actuator_ranges(given[1] or {n: n for n in plant.input_names}, headings, plant)

    def _read_off(self, findings: list[Finding]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return what is mapped, what is listed, or else what the headings say."""
        mapped = {"states": self.states, "inputs": self.inputs}
        maps = {key: dict(given) for key, given in mapped.items() if given and isinstance(given, Mapping)}
        if len(maps) == 2:
            return self._in_units(maps["states"]), maps["inputs"]
        inputs = [_heading(name, given) for name, given in maps["inputs"].items()] if "inputs" in maps else self.inputs
        listed = None if "states" in maps else self.states
        states, found = self._inferred(inputs or None, listed or None, findings)
        return self._in_units(maps.get("states", states)), maps.get("inputs", dict(found))

    @property
    def _files(self) -> list[str]:
        """Return the paths of all files."""
        return [self.path] if isinstance(self.path, str) else list(self.path or ())

    def _inferred(
        self, inputs: Collection[str] | None, states: Collection[str] | None, findings: list[Finding]
    ) -> tuple[dict[str, Column], dict[str, Column]]:
        """Return the columns of the file in which most of them move: what stands still in one may move in another."""
        found, refused = [], []
        for file in self._files:
            told: list[Finding] = []
            try:
                found.append((*infer(file, self.time, inputs, states, told, self.dt), told))
            except ValueError as error:
                refused.append(error)
        if not found:
            raise refused[0]
        best = max(found, key=lambda each: len(each[0]) + len(each[1]))
        findings += best[2]
        return best[:2]

    def _in_units(self, states: Mapping[str, Any]) -> dict[str, Any]:
        """Return columns in the units of their headings; known rates of angles in rad are in rad/s."""
        headings = read_columns(Path(self._files[0])).headings
        return dict(with_units(columns_of(states), headings, states=True, known=self.known, rotors=False))

    def _require_fit(self, recording: Recording, states: Mapping[str, Any]) -> None:
        """Refuse rates that are known and cannot be those of their states, with the setting that mends them."""

        def _mend(wrong: Mismatch) -> dict[str, Any]:
            headings, given = read_columns(Path(self._files[0])).headings, columns_of(states)
            explicit = [n for n, c in given.items() if c != with_units({n: Column(c.name)}, headings, states=True)[n]]
            columns = with_units(given, headings, states=True)
            unit = unit_of_rate(recording.signature.state_units[recording.signature.state_index(wrong.state)])
            rate = columns[wrong.rate]
            columns[wrong.rate] = replace(rate, unit=unit, scale=wrong.likely * rate.scale)
            return as_map(columns, {*explicit, wrong.rate})

        try:
            require_consistent_rates(recording.transitions, recording.signature, self.known or {}, _mend)
        except LogError as error:
            raise LogError(error.finding.code, file=", ".join(self._files), **error.finding.values) from None


@dataclass(frozen=True)
class Identified:
    """Hold a fitted model and its figures.

    Attributes:
        fit: the model, its report, and the data as the model has them, with one state more where one follows a signal.
        predicted: open-loop prediction of the validation data, `(N, n_x)`.
        metrics: error of each measured state, open loop and over each horizon.
        forecasts: errors from many start times; None where the validation data are too short for them.
        bend: a dead zone or a saturation of an input that the equations seem to lack; None where there is none.
    """

    fit: LogFit
    predicted: Tensor
    metrics: dict[str, dict[str, float]]
    forecasts: ForecastErrors | None = None
    bend: InputNonlinearity | None = None

    @property
    def model(self) -> SindyModel:
        """The model."""
        return self.fit.model

    @property
    def report(self) -> FitReport:
        """The report of the fit."""
        return self.fit.report

    @property
    def source(self) -> Source:
        """The data as the model has them."""
        return self.fit.source

    @property
    def quiet(self) -> list[Finding]:
        """Which states the data are too quiet to tell of, and what to move."""
        return low_signal_findings(self.source.training, self.source.signature, self._rates())

    def resolved(self) -> ForecastErrors | None:
        """Return the errors of the states that the data tell of; None where they tell of none, or are too short."""
        return resolved_errors(self.forecasts, low_signal_states(self.source.training, self._rates()))

    @property
    def predicts(self) -> bool:
        """Whether the model was seen to predict; not where the validation data are too short, or too quiet, to tell."""
        return self.resolved() is not None and not any(each.severity == "wrong" for each in self.verdict)

    @cached_property
    def content(self) -> list[Finding]:
        """What the equations and the data hold."""
        findings = self.fit.content + verdict.recording_findings(self.source.training, self.source.signature)
        return findings + ([missing_nonlinearity(self.bend, self.model)] if self.bend else [])

    @cached_property
    def verdict(self) -> list[Finding]:
        """Whether the model predicts, and what limits that, the gravest first."""
        if self.forecasts is None:
            return [*self.quiet, weak("model.short_validation")]
        errors = self.resolved()
        return [*(verdict.model_findings(errors, self.model.signature) if errors is not None else []), *self.quiet]

    @property
    def findings(self) -> list[Finding]:
        """All findings: of the data, the fit, the equations, and of what the model predicts."""
        return [*self.source.findings, *self.report.findings, *self.content, *self.verdict]

    def _rates(self) -> set[int]:
        return set(rate_states(self.model.library, self.model.constraints))


def identify_source(model: SindyModel, source: Source, horizons: Sequence[float] | None = None) -> Identified:
    """Fit a model and predict the validation data: open loop, and from many start times.

    Args:
        model: what to fit.
        source: the data.
        horizons: times ahead over which predictions are judged [s]; found from the data if omitted.

    Raises:
        TypeError: The model is not sparse.
        ValueError: It refuses the data.
    """
    if not isinstance(model, SindyModel):
        raise TypeError(
            f"world_model is a {type(model).__name__}, which has no coefficients to identify; choose world_model=sindy "
            "or another that builds a SindyModel"
        )
    fit = fit_log(model, source)
    model, source = fit.model, fit.source
    report_progress("prediction of the validation data")
    validation, names = source.validation, source.signature.state_names
    predicted = open_loop(model, with_start_states(model, validation))
    missing = validation.x_next.isnan().all(0).tolist()
    seen = [(name, i) for i, (name, gaps) in enumerate(zip(names, missing, strict=True)) if not gaps]
    errors = {"open_loop_nrmse": nrmse(predicted, validation)}
    if not bool(validation.x.isnan().any()):
        errors["one_step_error"] = one_step_error(model, delay_inputs(validation, model.delay))
    metrics = {what: {name: float(e[i]) for name, i in seen} for what, e in errors.items()}
    horizons = horizons or relevant_horizons(model, source.training)
    forecasts = forecast_errors(model, source.training, validation, horizons)
    if forecasts is not None:
        metrics |= verdict.errors(forecasts, source.signature)
    lacking = source.logged and forecasts is not None and bool(verdict.unresolved(forecasts, source.signature).any())
    # A bend would stand for a rate that is missing.
    lacking = lacking and not find_missing_rates(model.library, delay_and_trim(source.training, model.delay))
    bend = find_missing_nonlinearity(model, source.training) if lacking else None
    return Identified(fit, predicted, metrics, forecasts, bend)


def _heading(name: str, given: object) -> str:
    """Return the heading of a column that a map names."""
    if isinstance(given, Column):
        return given.name or name
    return str(given.get("name", name) if isinstance(given, Mapping) else given)
