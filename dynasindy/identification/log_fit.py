"""The fit to data: where a log shows that the equations lack something, a state that no sensor sees is tried."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynasindy.findings import Finding, note, weak
from dynasindy.identification.equations import equation_findings, hidden_states, idle_states
from dynasindy.identification.forecast_errors import LOST, ForecastErrors, forecast_errors
from dynasindy.identification.source import Source
from dynasindy.identification.verdict import unresolved
from dynasindy.limits import raise_if_memory
from dynasindy.progress import report_progress, reporting_as
from dynasindy.sindy.delay import delay_and_trim
from dynasindy.sindy.fit_report import FitReport, Refined
from dynasindy.sindy.lag_states import LagStateCandidate, lag_state_candidates
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.reconstruction import find_missing_rates
from dynasindy.sindy.refinement import Refinement
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions


@contextmanager
def attempt() -> Iterator[None]:
    """Let a search or a fit fail; that memory runs out is no failure of what was tried."""
    try:
        yield
    except FAILURES as error:
        raise_if_memory(error)


@dataclass(frozen=True, kw_only=True)
class _FixedRefinement(Refinement):
    """Return what was found before, at no cost.

    Attributes:
        found: what it was.
    """

    found: Refined

    def run(self, *of: object, **given: object) -> Refined:
        """Return it, whatever the data are."""
        return self.found


def _take_alternative(model: SindyModel, found: Refined, data: Transitions) -> tuple[SindyModel, FitReport]:
    """Return the model that a fit has set aside, and the report of it.

    What it is fitted to later, as parts of the log are, it is fitted to as a whole, too: by one simulation.

    Args:
        model: what was fitted; it stays as it is.
        found: what the fit set aside.
        data: the recording that it was fitted to.
    """
    other, settings = copy.deepcopy(model), model.refinement or Refinement()
    other.refinement = _FixedRefinement(**vars(settings), found=found)
    report = other.fit(data)
    other.refinement = replace(settings, error="simulation")
    return other, report


BETTER = 0.7
"""Part of a model's errors, their geometric mean over states and horizons, that are left where a state is believed."""
PLAIN = "id", "ahead"
"""What the factors of polynomials are, and what a state has that follows a signal."""
MOST = 3
"""States that are tried, those first that regressions prefer."""
FAILURES = ArithmeticError, ValueError, RuntimeError
"""What a search or a fit raises where numbers run away, or where there are too few samples."""


FINEST = 1e-5
"""Error that is as good as none, whatever a sensor resolves [ranges of the state]."""
ROUGHLY = 1.1
"""Ratio of errors of a state up to which they count as the same."""


@dataclass(frozen=True)
class LogFit:
    """Hold a fitted model, and the data with all of its states.

    Attributes:
        model: as it was given, or with one state more, which follows an input or a measured state.
        source: the data; that state is seen by no sensor.
        report: of the fit.
        follower: what was found of such a state; None where nothing was.
        sought: that such a state was looked for in vain; None where none was looked for, or one was found.
    """

    model: SindyModel
    source: Source
    report: FitReport
    follower: Finding | None = None
    sought: Finding | None = None

    @property
    def content(self) -> list[Finding]:
        """What the equations hold, and which of their states no sensor sees."""
        found = equation_findings(self.model, self.report)
        return [*found, *self.hidden, *idle_states(self.model, self.source.training)]

    @property
    def hidden(self) -> list[Finding]:
        """What came of the search for a state that no sensor sees."""
        return [each for each in (self.follower, self.sought) if each is not None]


def fit_log(model: SindyModel, source: Source) -> LogFit:
    """Fit a model; where something lacks in it, fit it with one state more, which follows an input or a measured state.

    Such a state is looked for where the model misses the last part of a log by more than the sensors explain, and
    believed where with it the model misses far less. It is not looked for where a rate is missing, as it would stand
    for that.

    Args:
        model: what to fit.
        source: the data.

    Raises:
        ValueError: the model refuses the data.
        Diverged: a coefficient is not finite.
    """
    began = time.perf_counter()
    found = _fitted(model, source)
    return replace(found, report=replace(found.report, seconds=time.perf_counter() - began))


def _fitted(model: SindyModel, source: Source) -> LogFit:
    report_progress("fit")
    plain = LogFit(model, source, model.fit(source.training))
    before = forecast_errors(model, source.training, source.validation) if source.logged else None
    if before is None:
        return plain
    settings = model.refinement
    plain, before = _whole(plain, before)
    if model.initial is not None:
        # A state that nobody saw and somebody knew of comes before one that is guessed.
        plain, before = _straighter(plain, before)
    model, lacking = plain.model, bool(unresolved(before, model.signature).any())
    # A state that follows a signal is one of a differential equation.
    if (
        lacking
        and model.step is None
        and not find_missing_rates(model.library, delay_and_trim(source.training, model.delay))
    ):
        for found in _wider(model, source, settings):
            after = _forecast(found) if found.follower else None
            if after is None:
                continue
            found, after = _whole(found, after)
            if _better(before, after, model.signature):
                return _straighter(found, after)[0]
        named = hidden_states(model, source.training)
        plain = replace(plain, sought=weak("fit.no_lag_state", what="another state" if named else "a state"))
    return _straighter(plain, before)[0]


def _whole(found: LogFit, before: ForecastErrors) -> tuple[LogFit, ForecastErrors]:
    """Return the fit by one simulation, if it was set aside and predicts better what no fit has seen; and its errors.

    Where a trajectory strays, something pushes the plant, which spoils its fit, or functions are missing. Then pieces
    are so short that they hardly tell what is slow, and it depends on the plant which of the two fits is the better.
    """
    kept, signature = found.report.aside, found.model.signature
    if kept is None:
        return found, before
    with attempt(), reporting_as("fit by one simulation"):
        model, report = _take_alternative(found.model, kept, found.source.training)
        whole = _renamed(replace(found, model=model, report=report))
        after = _forecast(whole) if bool(whole.follower) == bool(found.follower) else None
        if after is not None:
            ratio = float(_ratios(before, after, signature).nanmean().exp())
            if ratio < 1 / ROUGHLY and _as_good(before, after, signature):
                return _noted(whole, note("fit.single_simulation", ratio=ratio, taken=True)), after
            return _noted(found, note("fit.single_simulation", ratio=ratio, taken=False)), before
    return found, before


def _renamed(found: LogFit) -> LogFit:
    """Return the fit with what its equations now say of the state that follows a signal, if it has one."""
    signal = found.model.followed.get(found.model.signature.state_names[-1], "") if found.follower else ""
    return replace(found, follower=LagStateCandidate(found.model, signal, 0.0).finding() if signal else None)


def _noted(found: LogFit, finding: Finding) -> LogFit:
    """Return the fit with one more finding in its report."""
    return replace(found, report=replace(found.report, findings=(*found.report.findings, finding)))


def _straighter(found: LogFit, before: ForecastErrors) -> tuple[LogFit, ForecastErrors]:
    """Return the fit without functions that bend, where it predicts as well what no fit has seen; and its errors.

    Where a model that lacks something is fitted, its errors last, and all the samples of one error are witnesses of the
    same. Products and squares then come in that make up for a shape of the motion, and turn up as bent characteristics
    beyond the log. They are judged by what they are worth on other samples: nothing, where nothing bends.
    """
    lasting = found.report.in_pieces or bool(unresolved(before, found.model.signature).any())
    model = _straight(found.model) if lasting else None
    if model is None:
        return found, before
    with attempt(), reporting_as("fit without functions that bend"):
        straight = _renamed(replace(found, model=model, report=model.fit(found.source.training)))
        after = _forecast(straight) if bool(straight.follower) == bool(found.follower) else None
        if after is not None:
            straight, after = _whole(straight, after)
            if _as_good(before, after, model.signature):
                return _noted(straight, note("fit.linear_preferred")), after
    return found, before


def _straight(model: SindyModel) -> SindyModel | None:
    """Return a model that may have no products and squares, not fitted yet; None if it has other functions, or none.

    It begins at the first guess that was given, as of a state that no sensor sees, or else at what was fitted.
    """
    factors = [feature.factors for feature in model.library.features]
    plain = torch.tensor([all(f.function in PLAIN for f in own) for own in factors])
    straight = torch.tensor([len(own) <= 1 and all(f.power == 1 for f in own) for own in factors])
    used = (model.coefficients != 0).any(-1)
    if bool((used & ~plain).any()) or not bool((used & ~straight).any()):
        return None
    bare, keep = copy.deepcopy(model), (plain & straight).unsqueeze(-1)
    bare.constraints = replace(model.constraints, free=model.constraints.free & keep)
    first = model.coefficients if model.initial is None else model.initial
    bare.initial = torch.where(keep, first, 0.0)
    bare.initial_delay = model.delay if model.initial is None else model.initial_delay
    return bare


def _forecast(found: LogFit) -> ForecastErrors | None:
    return forecast_errors(found.model, found.source.training, found.source.validation)


def _wider(model: SindyModel, source: Source, settings: Refinement | None) -> Iterator[LogFit]:
    """Yield fits with one state more, those first that regressions prefer; a fit that fails is left out.

    Products and squares may bend to what the followed signal alone explained, so each is fitted without them, too. The
    report of such a fit says so: it is taken where the one with them does not predict far better, and it does.
    """
    with attempt():
        for trial in lag_state_candidates(model, source.training)[:MOST]:
            trial.model.refinement = settings
            if (found := _with(trial, source)) is not None:
                yield found
            bare = _straight(trial.model)
            if bare is not None and (found := _with(replace(trial, model=bare), source)) is not None:
                yield _noted(found, note("fit.linear_preferred"))


def _with(trial: LagStateCandidate, source: Source) -> LogFit | None:
    """Return the fit with one state more; None where it fails."""
    with attempt(), reporting_as(f"fit with a state that follows {trial.signal}"):
        data = source.with_states_of(trial.model)
        report = trial.model.fit(data.training)
        return LogFit(trial.model, data, report, trial.finding())
    return None


def _better(before: ForecastErrors, after: ForecastErrors, signature: Signature) -> bool:
    """Tell whether errors are lower by far."""
    return float(_ratios(before, after, signature).nanmean().exp()) < BETTER


def _as_good(before: ForecastErrors, after: ForecastErrors, signature: Signature) -> bool:
    """Tell whether errors are no larger, and those of no state are larger by much."""
    ratios = _ratios(before, after, signature)
    return float(ratios.nanmean()) <= 0 and float(ratios.nanmean(0).nan_to_num().max()) <= math.log(ROUGHLY)


def _ratios(before: ForecastErrors, after: ForecastErrors, signature: Signature) -> Tensor:
    """Return the logarithm of how large errors are by what they were, `(horizons, n_x)`, NaN where nothing was seen.

    An error counts as what the sensor resolves at least, and as what has run away at most; exact logs resolve anything.
    """
    # A model that runs away is judged over shorter horizons as well, which the other is not.
    (ours, theirs), n_x = _over_the_same(after, before), before.model.shape[1]
    most = LOST * torch.tensor(signature.x_scale, dtype=theirs.dtype)[:n_x]
    least = before.resolution.nan_to_num(nan=0.0).to(most).clamp(FINEST / LOST * most, most)
    ratios = ours[:, :n_x].clamp(least, most) / theirs.clamp(least, most)
    return torch.where(theirs.isnan(), math.nan, ratios.log())


def _over_the_same(*both: ForecastErrors) -> list[Tensor]:
    """Return the errors of models over the horizons that all of them are judged over, `(horizons, n_x)` each."""
    shared = set.intersection(*(set(one.horizons) for one in both))
    return [one.model[[horizon in shared for horizon in one.horizons]] for one in both]
