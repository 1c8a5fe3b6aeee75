"""Identify a model from a source of data, and judge it on data it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from torch import Tensor

from dynasindy.data.recording import LogReader
from dynasindy.findings import Finding, weak
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
from dynasindy.systems.base import System

if TYPE_CHECKING:
    from dynasindy.excitation import Excitation


@dataclass(frozen=True)
class LoggedData(LogReader):
    """Take data from a log, see `LogReader`; the last part of it is kept for validation.

    Attributes:
        validation_share: part of the transitions that is kept for validation.

    Raises:
        ValueError: a setting is not allowed, or the share is not between 0 and 1.
    """

    validation_share: float = VALIDATION_SHARE

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.validation_share < 1:
            raise ValueError(
                f"{setting('data.validation_share')} is {self.validation_share}; allowed is between 0 and 1"
            )

    def load(self, system: System | None, excitation: Callable[..., Excitation]) -> Source:
        """Read the file, and add what it lacks; of the plant names, units and ends are used, nothing of the excitation.

        Rates that are known and that neither the file nor the plant has become states that the model tells.
        """
        source = Source.of(self.recording(None if system is None else system.signature), self.validation_share)
        if system is not None and system.known:
            return source
        known = self.known_rates(source.signature.state_names)
        for name in known.keys() - set(known.values()):
            source.signature.state_index(name)  # refuses what is no state
        return source.with_rates(known)


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
