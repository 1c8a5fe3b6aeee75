"""Identify a model from a source of data, judge it on data it has not seen, and write down what was found."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from dynasindy.data.columns import Column
from dynasindy.data.rates import check_rates, require_consistent_rates
from dynasindy.data.recording import LogReader
from dynasindy.findings import Finding, records, weak
from dynasindy.identification import verdict
from dynasindy.identification.forecast_errors import (
    LOST,
    ForecastErrors,
    LinearModel,
    characteristic,
    errors_over,
    forecast_errors,
    samples_after,
    start_rows,
    with_start_states,
)
from dynasindy.identification.log_fit import LogFit, fit_log
from dynasindy.identification.recording_diagnostics import low_signal_findings, low_signal_states
from dynasindy.identification.source import VALIDATION_SHARE, DataSource, Source, rates_of
from dynasindy.limits import one_thread
from dynasindy.progress import report_progress
from dynasindy.safe_io import checked, write_json, write_text
from dynasindy.sentences import error_of, gravest_first, lines
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.named_libraries import LibraryBuilder
from dynasindy.sindy.reconstruction import rate_states
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.sindy.world_model import nrmse, one_step_error, open_loop
from dynasindy.systems.base import Signature, System
from dynasindy.systems.transitions import Transitions
from dynasindy.text import format_duration

if TYPE_CHECKING:
    from dynasindy.envs import Excitation

FINEST = 1e-6
"""Part of the range of a state below which what a sensor resolves is no noise."""
PAST, FEW, ROWS, JUDGED = 8, 3, 4000, 40_000
"""Past samples that a linear model may read, also with products, and rows for its fit and its judgement, at most."""
SLOWEST, FARTHEST, HORIZONS = 3, 1000, 5
"""How far ahead they predict [times in which the slowest state changes], [samples] at most, and over how many times."""
WIDEST = 8
"""States that move of which products are looked at, at most."""
BETTER = 0.95
"""Part of an error to which another one must fall at some time ahead, to be of a model that knows more."""


@dataclass(frozen=True)
class LoggedData(LogReader, DataSource):
    """Take data from a log, see `LogReader`; the last part of it is kept for validation.

    Attributes:
        validation_share: part of the transitions that is kept for validation, 0 to below 1.

    Raises:
        ValueError: a setting is not allowed.
    """

    validation_share: float = VALIDATION_SHARE

    def source(self, plant: Signature | None = None) -> Source:
        """Read the file without states that nothing moves, unless states, rates or a plant are given."""
        source = Source.of(self.recording(plant), self.validation_share)
        given = self.states is not None or bool(self.known) or plant is not None
        return source if given else source.without(_unmoved_states(source.training, source.signature))

    def load(self, system: System | None, excitation: Callable[..., Excitation] | None) -> Source:
        """Read the file, and add what it lacks; of the plant names, units and ends are used, nothing of the excitation.

        Rates that are known and that neither the file nor the plant has become states that the model tells.
        """
        source = self.source(None if system is None else system.signature)
        if system is not None and system.known:
            return source
        known = self.known_rates(source.signature.state_names)
        for name in known.keys() - set(known.values()):
            source.signature.state_index(name)  # refuses what is no state
        return source.with_rates(known)


@dataclass(frozen=True)
class Identified(LogFit):
    """Hold a fitted model, its report, the data as the model has them, and its figures.

    Attributes:
        predicted: open-loop prediction of the validation data, `(N, n_x)`.
        metrics: error of each measured state, open loop and over each horizon.
        forecasts: errors from many start times; None where the validation data are too short for them.
    """

    predicted: Tensor
    metrics: dict[str, dict[str, float]]
    forecasts: ForecastErrors | None = None

    @classmethod
    def of(cls, model: SindyModel, source: Source) -> Identified:
        """Fit a model and predict the validation data: open loop, and from many start times.

        Args:
            model: what to fit.
            source: the data.

        Raises:
            ValueError: It refuses the data.
        """
        fit = fit_log(model, source)
        model, source = fit.model, fit.source
        report_progress("prediction of the validation data")
        validation, names = source.validation, source.signature.state_names
        substeps = model.substeps(validation.dt)
        predicted = open_loop(model, with_start_states(model, validation), substeps)
        missing = validation.x_next.isnan().all(0).tolist()
        seen = [(name, i) for i, (name, gaps) in enumerate(zip(names, missing, strict=True)) if not gaps]
        errors = {"open_loop_nrmse": nrmse(predicted, validation)}
        if not bool(validation.x.isnan().any()):
            errors["one_step_error"] = one_step_error(model, delay_inputs(validation, model.delay), substeps)
        metrics = {what: {name: float(e[i]) for name, i in seen} for what, e in errors.items()}
        forecasts = forecast_errors(model, source.training, validation)
        if forecasts is not None:
            metrics |= _errors_by_horizon(forecasts, source.signature)
        return cls(model, source, fit.report, predicted, metrics, forecasts)

    @property
    def quiet(self) -> list[Finding]:
        """Which states the data are too quiet to tell of, and what to move."""
        return low_signal_findings(self.source.training, self.source.signature, self._rates())

    def resolved(self) -> ForecastErrors | None:
        """Return the errors of the states that the data tell of; None where they tell of none, or are too short."""
        return self.forecasts and self.forecasts.without(low_signal_states(self.source.training, self._rates()))

    @property
    def predicts(self) -> bool:
        """Whether the model was seen to predict; not where the validation data are too short, or too quiet, to tell."""
        return self.resolved() is not None and not any(each.severity == "wrong" for each in self.verdict)

    @cached_property
    def content(self) -> list[Finding]:
        """What the equations and the data hold."""
        return super().content + verdict.recording_findings(self.source.training, self.source.signature)

    @cached_property
    def verdict(self) -> list[Finding]:
        """Whether the model predicts, and what limits that, the gravest first."""
        if self.forecasts is None:
            return [*self.quiet, weak("model.short_validation")]
        errors, source = self.resolved(), self.source
        found = [] if errors is None else verdict.model_findings(errors, self.model.signature)
        rest = verdict.what_to_leave_out(found, source, self.model) if source.logged else []
        return [*found, *rest, *self.quiet]

    @property
    def findings(self) -> list[Finding]:
        """All findings: of the data, the fit, the equations, and of what the model predicts."""
        return [*self.source.findings, *self.report.findings, *self.content, *self.verdict]

    def to_text(self) -> str:
        """Return equations, fit, identifiability, what the data show, errors and a verdict for a reader."""
        source, forecasts = self.source, self.forecasts
        first, *others = gravest_first(self.verdict)
        text = [
            *self.model.equations(),
            *_errors(self.model),
            "",
            self.report.to_text(),
            *(each.line("found") for each in self.content),
            "",
            *(table(forecasts, source.signature) if forecasts is not None else []),
            "error of one prediction of all data that the fit did not see, begun anew after gaps, in % of the standard "
            "deviation of each state",
        ]
        for state, error in self.metrics["open_loop_nrmse"].items():
            text.append(f"  {state:<10} " + (f"{100 * error:.3g} %" if math.isfinite(error) else "runs away"))
        return "\n".join([*text, f"verdict: {first}", *(each.line() for each in others)])

    def save(self, folder: Path, before: Sequence[Finding] = ()) -> None:
        """Write model.json, metrics.json, report.txt and the coefficients as text and CSV.

        Args:
            folder: where; made if missing.
            before: what was found before the fit, with which the report begins.
        """
        self.model.save(folder / "model.json")
        findings = [*before, *(each for each in self.findings if each not in before)]
        write_json(folder / "metrics.json", {**self.metrics, "findings": records(findings)}, indent=1, finite=False)
        write_text(folder / "report.txt", "\n".join([*lines(before), self.to_text()]) + "\n")
        for ending, text in _coefficient_tables(self.model).items():
            write_text(folder / f"coefficients.{ending}", text)

    def _rates(self) -> set[int]:
        return set(rate_states(self.model.library, self.model.constraints))


@checked
def read(
    path: str | Path | Iterable[Any],  # pydantic says of wrong items nothing that a user can read
    states: Mapping[str, Any] | Sequence[str] | None = None,
    inputs: Mapping[str, Any] | Sequence[str] | None = None,
    time: str = "time",
    dt: float | None = None,
    validation_share: float = VALIDATION_SHARE,
) -> Source:
    """Read a log of a plant from a CSV file, or from several; the last part of it is kept for `forecast`.

    Args:
        path: The file, with a line of headings such as `angle [rad]`; or a list of files with the same columns.
        states: Columns of the states by name: the heading, or keys of `dynasindy.data.columns.Column`; a list takes
            them as they are; all columns but time, inputs and what tells nothing of a plant if omitted.
        inputs: Columns of the inputs, likewise; if omitted those that are called `u`, `u_...` or `input_...`, and where
            none is, commands, columns that move in steps, and what is called as an actuator.
        time: Heading of the time column, in seconds unless it says another unit, as in `count [ms]`.
        dt: Sampling time [s]; the file's own if omitted. Where the time counts rows it is the time between two.
        validation_share: Part of the log, at its end, that neither the fit nor the plan sees. With 0 they see all of
            it, and `forecast` can promise nothing.

    Returns:
        Both parts, the signature, and `findings` on what was skipped or resampled.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no log of a plant.
    """
    files = str(path) if isinstance(path, str | Path) else list(map(str, path))
    return LoggedData(files, states, inputs, time, dt, validation_share=validation_share).source()


@one_thread()
@checked
def identify(
    log: Source,
    library: str | Sequence[str] | LibraryBuilder = "auto_rig",
    known: Mapping[str, str] | None = None,
    method: Literal["integral", "one_step", "trajectory", "auto"] = "auto",
    longest_delay: float | None = None,
    time: Literal["continuous", "discrete"] = "continuous",
    seconds: float = 60.0,
) -> SindyModel:
    """Identify sparse equations from a log, as `train.py data=csv` does.

    Where they lack something, states that no sensor sees are looked for: an input that acts through a lag, or hidden
    states of a linear model.

    Args:
        log: What `read` returned.
        library: Candidate functions: a name of `dynasindy.sindy.named_libraries.NAMED`, or functions in words.
            `auto_rig` is quadratic polynomials and sines of states in rad, or for angles in rad and their rates in
            rad/s the functions of mechanics, and dry friction of every rate. Words may name `angle_rate`, the rate of
            `angle`, though the log does not have it.
        known: Equations that are known, such as `{"angle": "rate"}`: the state's rate is that function. A rate that
            the log does not have is estimated with the model. The fit may add others, as `angle_rate`, where it
            predicts better with them; of `{}` it adds none.
        method: How the fit is refined; `auto` chooses by the noise of the data.
        longest_delay: Longest delay of the inputs that is looked for [s]; None where the data are to tell.
        time: `continuous` identifies differential equations, `discrete` difference equations whose step is the sampling
            time of the log, for what moves in steps: all states have to be in the log.
        seconds: Time of computing that may be taken, about, where `auto` tries candidates [s].

    Returns:
        The model; `equations()` shows it, `save` keeps it, and `findings` holds what was found before the fit, by it,
        and of delay and dry friction in the equations. What is found before the fit is a warning, too.

    Raises:
        ValueError: The data or the library do not allow a fit, or a rate that is known is in other units than its
            state, counts the other way, or was exchanged with it.
        Diverged: A coefficient is not finite.
    """
    refinement = Refinement(method=method, longest_delay=longest_delay, seconds=seconds)
    regression = Regression("bic", tolerance=1e-4)
    build = partial(SindyModel, library=library, regression=regression, refinement=refinement, time=time)
    if named := log.named_rates(library):
        known = {**named, **(known or {})}
    rates = dict(known or {})
    source = log.with_rates(rates)
    columns = {name: Column(name) for name in log.signature.state_names}
    before = require_consistent_rates(source.training, source.signature, rates, columns)
    model = build(signature=source.signature, known=known)
    for each in before:
        warnings.warn(str(each), stacklevel=4)  # past the check of arguments
    found = fit_log(model, source)
    found.model.findings = (*before, *found.report.findings, *found.content)
    return found.model


def before_fit(model: SindyModel, source: Source) -> list[Finding]:
    """Return what was read, what is wrong with it or costs the fit dearly, before the fit.

    Args:
        model: A model of the data, not fitted yet.
        source: The data.

    Raises:
        TypeError: The model is not sparse.
    """
    if not isinstance(model, SindyModel):
        raise TypeError(
            f"world_model is a {type(model).__name__}, which has no coefficients to identify; choose world_model=sindy "
            "or another that builds a SindyModel"
        )
    return [*check_rates(source.training, source.signature, rates_of(model)), *source.findings]


def table(forecasts: ForecastErrors, signature: Signature) -> list[str]:
    """Write the errors over all horizons, a line each: of the model, of a linear one, and of the last value held.

    A linear model may run away without ever being infinite: beyond `LOST` ranges of a state its error is no number.

    Args:
        forecasts: The errors.
        signature: Names and units of the states.
    """
    kinds = {"model": forecasts.model, "linear model": forecasts.linear, "last value held": forecasts.held}
    heads = [format_duration(horizon, max(forecasts.horizons)) for horizon in forecasts.horizons]
    text = [
        f"RMS error so far ahead, of predictions from {forecasts.starts} samples that the fit did not see; "
        f"the linear model predicts from {forecasts.order} past sample{'s' * (forecasts.order > 1)}"
    ]
    for name, unit, scale, finest, *columns in zip(
        signature.state_names,
        signature.state_units,
        signature.x_scale,
        forecasts.resolution.tolist(),
        *(errors.mT.tolist() for errors in kinds.values()),
        strict=True,
    ):
        if np.isnan(columns[-1]).all():
            continue
        fine = "its sensor shows no noise"
        fine = fine if finest < FINEST * scale else f"its sensor resolves {error_of(finest)}"
        cells = [[error_of(math.inf if e > LOST * scale else e) for e in errors] for errors in columns]
        rows = pd.DataFrame(dict(zip(kinds, cells, strict=True)), heads).to_string(col_space=11)
        text += [f"  {name} [{unit}], {fine}", *(f"    {row}" for row in rows.split("\n"))]
    return text


def _errors_by_horizon(forecasts: ForecastErrors, signature: Signature) -> dict[str, dict[str, float]]:
    seen = [i for i in range(signature.n_x) if not bool(torch.isnan(forecasts.held[:, i]).all())]
    kinds = {"": forecasts.model, "linear_": forecasts.linear, "held_": forecasts.held}
    return {
        f"{kind}rmse_{h:g}_s": {signature.state_names[i]: float(found[k, i]) for i in seen}
        for kind, found in kinds.items()
        for k, h in enumerate(forecasts.horizons)
    }


def _errors(model: SindyModel) -> list[str]:
    if model.covariance is None:
        why = "none of them was fitted"
        if bool((model.constraints.free & (model.coefficients != 0)).any()):
            why = "the refinement, which tells them, found no equations, or ones that run away from the data"
        return ["", f"coefficients have no standard errors (±): {why}"]
    return ["", "coefficients and their standard errors", *_coefficient_lines(model, model.covariance)]


def _coefficient_lines(model: SindyModel, known: Covariance) -> list[str]:
    """Write a line for each coefficient that was fitted, such as `v'  -9.81 ± 0.03  sin(p)`, functions last."""
    # Of a difference equation it is that of the right side, whose coefficients are the step times those of the rates.
    library, table = model.library.mapping(model.coefficients)
    place = {feature.key: k for k, feature in enumerate(library.features)}
    sides = [library.left_side(state) for state in library.signature.state_names]
    errors = ((library.step or 1.0) * known.errors).tolist()
    each = zip(known.states.tolist(), known.features.tolist(), errors, strict=True)
    fitted = sorted((i, place[model.library.features[k].key], error) for i, k, error in each if error)
    found = [(sides[i], _plus_minus(float(table[k, i]), error), library.names[k]) for i, k, error in fitted]
    wide, long = (max((len(row[k]) for row in found), default=0) for k in (0, 1))
    return [f"{name:<{wide}}  {number:<{long}}  {feature}" for name, number, feature in found]


def _plus_minus(value: float, error: float) -> str:
    """Write a number and its standard error, the error to two digits: `1.2340 ± 0.0050`, `(3.10 ± 0.20)e-07`."""
    exponent = math.floor(math.log10(max(abs(value), error)))
    scale = exponent if not -4 < exponent < 6 else 0
    size, spread = value / 10.0**scale, error / 10.0**scale
    # 9.96 written to two digits is 10: the error tells its digits once it is rounded.
    digits = max(0, 1 - math.floor(math.log10(float(f"{spread:.1e}"))))
    written = f"{size:.{digits}f} ± {spread:.{digits}f}"
    return f"({written})e{scale:+03d}" if scale else written


def _coefficient_tables(model: SindyModel) -> dict[str, str]:
    """Return the Xi table, a row for each function, as text of 5 and as CSV of all digits, by the endings of files."""
    library, coefficients = model.library.mapping(model.coefficients)
    states, units = library.signature.state_names, library.signature.state_units
    left = [library.left_side(state) for state in states]
    head = "d({})/dt [{}/s]" if library.step is None else "{}[k+1] [{}]"
    table = pd.DataFrame(coefficients.numpy(), library.names, left)
    text = table.rename_axis(columns="function").to_string(float_format="{:.5g}".format, justify="right")
    heads = [*map(head.format, states, units)]
    return {"txt": text + "\n", "csv": table.to_csv(header=heads, index_label="function")}


def _unmoved_states(data: Transitions, signature: Signature) -> list[str]:
    """Return states that are foretold best by their own past alone, and that foretell no other one (Granger 1969).

    Those are a temperature of the computer or its free memory, say, beside the states of a plant. Linear models of
    past samples with and without the others are fitted to the first three quarters and compared on the last one, and
    those that know the samples of others, their sines and their products, by which a heading turns a speed.

    Args:
        data: the recording.
        signature: its names.
    """
    cut = 3 * len(data) // 4
    parts = choose_stretches(cut, ROWS), choose_stretches(len(data) - cut, JUDGED)
    none = [torch.zeros_like(each) for each in parts]
    fit, kept = data.select(torch.cat([parts[0], none[1]])), data.select(torch.cat([none[0], parts[1]]))
    reach = start_rows(kept, PAST)[1]
    last = min(reach // 5, max(round(SLOWEST * characteristic(fit, signature) / data.dt), 2), FARTHEST)
    if data.x.shape[1] < 2 or last < 2:
        return []
    starts, _ = start_rows(kept, PAST, last)
    later, real = samples_after(kept, starts, last)
    steps = sorted({round(k) for k in np.geomspace(1, last, HORIZONS).tolist()})

    def _errors(states: Sequence[int], driven: bool = True, known: Sequence[int] = ()) -> Tensor:
        """Return errors of models of some states, of the best one over each horizon, `(H, n)`."""
        mine, theirs = (_of_states(part, states, driven, known) for part in (fit, kept))
        models = LinearModel.candidates(mine, FEW if known else PAST)
        errors = [errors_over(model.predict(theirs, starts, later), real[..., states], steps) for model in models]
        return torch.stack(errors or [real.new_full((len(steps), len(states)), math.nan)]).amin(0)

    def _no_better(ours: Tensor, theirs: Tensor) -> Tensor:
        return (theirs.isfinite() & (ours >= BETTER * theirs)).all(0)

    states = list(range(data.x.shape[1]))
    alone, together = torch.cat([_errors([i], driven=False) for i in states], 1), _errors(states)
    unmoved = [i for i in states if _no_better(together, alone)[i] and _no_better(_errors([i])[:, 0], alone[:, i])]
    moved = [i for i in states if i not in unmoved]
    if not unmoved or not 0 < len(moved) <= WIDEST or not bool(_no_better(together[:, moved], _errors(moved)).all()):
        return []
    known = {j: _errors([j], known=[k for k in moved if k != j]) for j in states}
    acts = set[int]()
    for i, j in product(unmoved, moved):
        error = _errors([j], known=[k for k in (*moved, i) if k != j])
        if not (error / known[j].minimum(together[:, [j]])).median() >= BETTER:  # far ahead one alone may be by chance
            acts.add(i)
    free = [i for i in unmoved if i not in acts and _no_better(known[i][:, 0], alone[:, i])]
    return [signature.state_names[i] for i in free]


def _of_states(data: Transitions, states: Sequence[int], driven: bool, known: Sequence[int]) -> Transitions:
    """Return a recording of some states, driven by nothing, the inputs, or also others that are known and products."""
    u = data.u if driven else torch.zeros_like(data.u)
    mine = replace(data, x=data.x[:, states], x_next=data.x_next[:, states], u=u, u_end=data.u_end if driven else None)
    if not known:
        return mine
    x = data.x[:, known].double()
    terms = torch.cat([x, x.sin(), x.cos(), u], 1)
    low, high = torch.triu_indices(terms.shape[1], terms.shape[1])
    return replace(mine, u=torch.cat([terms, terms[:, low] * terms[:, high]], 1), u_end=None)
