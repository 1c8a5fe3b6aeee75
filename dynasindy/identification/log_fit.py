"""The fit to a log: candidates are fitted to one part of it and judged on another, and the best one is kept.

What is optional in a model is a candidate and nothing else decides: which rates and hidden states it has, its
functions, how inputs move between samples and how late they act, which error is minimised and over how long a window.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dynasindy.findings import Finding, note, weak
from dynasindy.identification.forecast_errors import (
    LinearModel,
    characteristic,
    errors_over,
    predict_from,
    samples_after,
    start_rows,
    starting_states,
)
from dynasindy.identification.recording_diagnostics import sensor_errors
from dynasindy.identification.source import Source, rate_name, rates_of
from dynasindy.identification.state_space import (
    chain_candidates,
    state_space_candidates,
    with_disturbance,
)
from dynasindy.identification.verdict import equation_findings, idle_states
from dynasindy.limits import raise_if_memory
from dynasindy.progress import Event, TimeIsUp, listening, report_progress, reporting_as
from dynasindy.sindy.delay import delay_and_trim, unexplained
from dynasindy.sindy.fit_report import FitReport
from dynasindy.sindy.functions import QUOTIENTS
from dynasindy.sindy.lag_states import (
    acts_at_once,
    has_clear_lags,
    lag_state_candidates,
    lag_state_findings,
    with_lag_state,
)
from dynasindy.sindy.library import Constraints, Factor, Feature, Library, variable
from dynasindy.sindy.library import of as function_of
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.named_libraries import PLACE, LibraryBuilder, auto, auto_rig, is_speed, polynomial
from dynasindy.sindy.reconstruction import (
    RegressionData,
    disturbance_states,
    find_rates,
    has_gaps,
    rate_states,
    reconstruct,
)
from dynasindy.sindy.refinement import FARTHER, TELLING, Refinement
from dynasindy.sindy.regression import SAMPLES_EACH, Rows, fit_supported
from dynasindy.sindy.shooting import CHOSEN_STRETCHES, MOST_STEPS, choose_stretches
from dynasindy.sindy.world_model import variance
from dynasindy.systems.base import TURNS
from dynasindy.systems.transitions import Transitions

KEPT = 0.25
"""Part of the training data that candidates are judged on at a time; up to half of it are whole recordings."""
MOST = 200
"""Samples before a start on which its states may be estimated, at most."""
NOISES = 0.01, 0.03, 0.1, 0.3
"""Process noise with which states are filtered [their ranges in the time in which the slowest of them changes]."""
SOONEST, SLOWEST = 0.02, 3
"""First and last time ahead over which candidates are judged [times in which the slowest state changes]."""
LOST = 1e3
"""Times the error of the best simple model that counts at most, as of a candidate that runs away."""
NEAR = 3
"""Ranges of a state within which equations stay near what was seen."""
EXPLODED = 1e6
"""Ranges of a state that only exponential growth leaves within the time of a log."""
FORGOTTEN = 2**0.5
"""Error of a prediction that has nothing to do with what comes [deviations of the state]."""
ROWS, FINAL_ROWS = 10_000, 30_000
"""Rows that a candidate is fitted to at most, and the best one in the end, in stretches spread evenly."""
SHORT, FOLDS = 2000, 3
"""Samples below which several parts are kept in turn, and how many."""
HORIZONS, STARTS = 7, 60
"""Times ahead, and start times, over which they are judged."""
SHORTEST, LONGEST, WORSE = 50, 800, 2
"""Samples in the shortest and the longest of the windows over which they are simulated, each twice as long as the one
before; and how many of them in turn may be worse than the best before longer ones are given up."""
PER_TERM = 0.01
"""Part by which errors have to be lower for a coefficient more; of functions that are not linear, and for a state more
that follows a signal, twice as much; for inputs that are linear between samples, and for half of the samples, once."""
FARTHEST, LIMIT = 200, 10_000
"""Samples ahead up to which candidates are judged at least, where there are so many, and at most."""
BEHIND = 1.0
"""Weight of being behind the best simple model where that is worst, beside the mean."""
BEHIND_BY = 1.03
"""Factor on the error of the best simple model beyond which a finding says that it predicts better."""
PRICES, SURE = (1.0, 2.0), 0.1
"""Factors on what a function must be worth; standard error below which it is worth any of them [coefficients]."""
HOPELESS = 1.0
"""Score behind the best one, or without one behind the best simple model, beyond which nothing dearer is tried of a
candidate, and a fit to all data is not taken."""
LEADERS = 3
"""Models that longer simulations are fitted by, those first that predict best."""
MANY = 100
"""Functions up to which regressions choose among all of them, and beyond which those of one factor come first."""
STAGE_SHARE, LARGEST_SHARE, LAST_SHARE = 0.25, 0.3, 0.15
"""Part of the time that lag states, longer simulations or hidden states may take each, any one candidate, and the last
fit."""
CUBIC = 6
"""States and inputs up to which cubic functions are tried."""
ANGLES = frozenset({"rad", *TURNS})
"""Units of what has no root."""
LATEST, DELAY_RATIO = 30, 1.25
"""Samples within which a delay is looked for, at least, and ratio of those that regressions try."""
RATE_ERRORS = 0.01, 0.1
"""Part of the movement of a state that the integral of its rate may leave over, and of a rate that is filtered."""
EXACT = 1e-5
"""Error that is as good as none, however fine a sensor is [ranges of the state]."""
CLEAR = 2.0
"""Standard errors by which hidden states have to be better, as the parts that were kept differ."""
RESOLVED = 1.2
"""Times the error of a sensor up to which an error leaves nothing to be found."""
STIFF = 10 * MOST_STEPS
"""Steps of a simulation between two samples, the most that there are, at which a model is too stiff for them."""
FUNCTION_SETS = "functions of single states", "signed squares", "cubic functions", "square roots"
"""Functions that models are tried with beside those of their libraries, those first that cost little."""
SPARSE = 30
"""Samples within the time in which the slowest state changes, down to which every second one may do."""
LINEAR = ", inputs linear between samples"
"""How a model with such inputs is called."""
LAG_STATES = 3
"""States that follow a signal that are tried, those first that regressions prefer."""
FAILURES = ArithmeticError, ValueError, RuntimeError
"""What a fit raises where numbers run away, or where there are too few samples."""


@contextmanager
def _attempt() -> Iterator[None]:
    """Let a fit fail; that memory runs out is no failure of what was tried."""
    try:
        yield
    except FAILURES as error:
        raise_if_memory(error)


@dataclass(frozen=True)
class LogFit:
    """Hold a fitted model, and the data with all of its states.

    Attributes:
        model: the model; it may have states more than the one that was given, which no sensor sees.
        source: the data with these states.
        report: of the fit.
    """

    model: SindyModel
    source: Source
    report: FitReport

    @cached_property
    def content(self) -> list[Finding]:
        """What the equations hold, and which of their states no sensor sees."""
        found = [*equation_findings(self.model, self.report), *lag_state_findings(self.model)]
        return [*found, *idle_states(self.model, self.source.training)]


def fit_log(model: SindyModel, source: Source) -> LogFit:
    """Fit a model to data; of a log the one of many candidates that predicts best what their fits have not seen.

    Candidates are tried where the refinement of the model is left to the data (`auto`); of data of a simulated plant,
    where the library suits any plant and samples are not the states themselves. Of such a library, rates, hidden states
    and more functions are candidates, too. Of any other refinement rates alone are, where nobody said what is known. A
    model with `known={}` gets none.

    Args:
        model: what to fit.
        source: the data.

    Raises:
        ValueError: the model refuses the data.
        Diverged: a coefficient is not finite.
    """
    began = time.process_time()
    report_progress("fit")
    settings = model.refinement
    free = settings is not None and settings.method == "auto" and settings.error is None
    unknown = source.logged or (not source.exact and _builder_of(model) is not None)
    searched = settings is not None and unknown and model.step is None and (free or model.given_known is None)
    if settings is not None and searched and (folds := HoldOut.folds(source)):
        search = _Search(model, settings, source, folds)
        if free and (found := search.run()) is not None:
            return replace(found, report=replace(found.report, seconds=time.process_time() - began))
        model, source = (model, source) if free else search.with_rates()
    return LogFit(model, source, model.fit(source.training))


@dataclass(frozen=True)
class HoldOut:
    """The part of the training data that candidates are judged on, and what simple models reach there.

    Attributes:
        early: rows that candidates are fitted to, bool `(N,)`; the others are kept.
        kept: transitions that they are judged on.
        steps: horizons [samples].
        starts: rows of `kept` at which predictions begin, `(S,)`.
        later: rows whose inputs act in turn, `(S, T)`.
        real: what was measured, `(S, T, n_x)`.
        before: samples before each start on which its states may be estimated.
        others: errors of simple models over each horizon, `(M, H, n_x)`.
        floor: error that is as good as none, `(n_x,)`.
        sensors: errors of the sensors, `(n_x,)`.
        slow: time in which the slowest state changes [s].
    """

    early: Tensor
    kept: Transitions
    steps: list[int]
    starts: Tensor
    later: Tensor
    real: Tensor
    before: int
    others: Tensor
    floor: Tensor
    sensors: Tensor
    slow: float

    @classmethod
    def folds(cls, source: Source) -> list[HoldOut]:
        """Split training data: long ones once, short ones several times, each time with another part kept.

        A part is a recording without gaps, where two or more hold a quarter to half of the data each, as on another day
        sensors have other zeros. There is none where the parts to judge on would be too short for that.
        """
        data, n = source.training, len(source.training)
        place, length, errors = torch.arange(n), round(KEPT * n), sensor_errors(data)
        cuts = [0, *(data.segment.diff().nonzero().flatten() + 1).tolist(), n]
        parts = [(first, end) for first, end in pairwise(cuts) if length <= end - first <= n / 2][::-1]
        if len(parts) < 2:
            parts = [(n - k * length, n - (k - 1) * length) for k in range(1, FOLDS + 1)]
        kept = parts[: FOLDS if n < SHORT else 1]
        found = [cls._of(source, (place < first) | (place >= end), errors) for first, end in kept]
        return [each for each in found if each is not None]

    @classmethod
    def _of(cls, source: Source, early: Tensor, least: Tensor) -> HoldOut | None:
        data = source.training
        fit, kept = data.select(early), data.select(~early)
        slow = characteristic(fit, source.signature)
        before = min(MOST, len(kept) // 4)
        starts, reach = start_rows(kept, before)
        last = min(2 * reach // 3, max(round(SLOWEST * slow / data.dt), FARTHEST), LIMIT)
        if before < 3 or last < 2:
            return None
        starts, _ = start_rows(kept, before, last)
        starts = starts[torch.linspace(0, len(starts) - 1, min(STARTS, len(starts))).long().unique()]
        later, real = samples_after(kept, starts, last)
        pairs = (fit, kept), (fit.with_linear_inputs(), kept.with_linear_inputs())
        linear = [m.predict(own, starts, later) for data, own in pairs for m in LinearModel.candidates(data, before)]
        held = reconstruct(kept, {}).x[starts].unsqueeze(1).expand_as(real)
        deviation = variance(data.x_next).sqrt()
        spread = (data.x_next - data.x_next.nanmean(0)).abs().nan_to_num().amax(0)
        floor = torch.maximum(least.nan_to_num(), EXACT * spread)
        steps = _horizon_samples(last, SOONEST * slow / data.dt)
        if linear:
            # How far ahead an unstable plant can be predicted, the linear model tells that is the best one at first: in
            # closed loop those that are better far ahead are stable, as the plant is not.
            errors = torch.stack([errors_over(guess, real, steps) for guess in linear])
            share = (errors / deviation).log().nanmean(-1)
            best = share[share[:, 0].nan_to_num(math.inf).argmin()]
            known = int((best < math.log(FORGOTTEN)).long().cumprod(0).sum())
            if known < len(steps):
                last = steps[max(1, known - 1)]
                steps = _horizon_samples(last, SOONEST / SLOWEST * last)
        errors = torch.stack([errors_over(guess, real, steps) for guess in [*linear, held]])
        later, real = later[:, : steps[-1]], real[:, : steps[-1]]
        return cls(early, kept, steps, starts, later, real, before, errors, floor, least, slow)

    @cached_property
    def simple(self) -> Tensor:
        """Errors of the best simple model over each horizon, `(H, n_x)`."""
        return self.others[self.others.log().nanmean((1, 2)).nan_to_num(math.inf).argmin()]

    def fit_rows(self, stride: int = 1, window: int = 1) -> Tensor:
        """Return rows that candidates are fitted to, bool `(N,)`: stretches of the early part.

        Args:
            stride: of the samples that are read.
            window: how many of these are simulated at once.
        """
        rows = self.early.nonzero().flatten()
        chosen = rows[choose_stretches(len(rows), ROWS * stride, window * stride)]
        return torch.zeros_like(self.early).index_fill(0, chosen, True)

    def errors(self, model: SindyModel, source: Source, filtered: bool = False) -> Tensor:
        """Return the errors of a model over each horizon, `(H, n_x)`, by the best way to estimate where it starts.

        That is on as many samples as are best. To compare models nearer horizons tell it, as what is farther says
        little of where a prediction began. For good it is told by all, and `filtered` with the best process noise, too.
        """
        count = len(self.steps) if filtered else -(-len(self.steps) // 2)
        lengths = dict.fromkeys(max(3, self.before >> k) for k in range(6))
        noises = [noise / self.slow**0.5 for noise in NOISES if filtered]
        best, least, chosen = None, math.inf, (model.memory, model.process_noise)
        for length, noise in (*((each, 0.0) for each in lengths), *((self.before, each) for each in noises)):
            with _attempt():
                model.memory, model.process_noise = length * self.kept.dt, noise
                begin = self._starts(model, source)
                errors = self._errors_from(model, source, begin, count)
                cost = self.score(errors) if filtered else float(errors.clamp_max(1e9).log().nanmean())
                if cost < least:
                    best, least, chosen = begin, cost, (model.memory, noise)
        model.memory, model.process_noise = chosen
        if best is None:
            return torch.full_like(self.simple, math.inf)
        return self._errors_from(model, source, best, len(self.steps))

    def errors_by_memory(self, model: SindyModel, source: Source) -> Tensor:
        """Return the errors over each horizon, `(H, n_x)`, of a model whose memory and process noise are chosen."""
        return self._errors_from(model, source, self._starts(model, source), len(self.steps))

    def _starts(self, model: SindyModel, source: Source) -> Tensor:
        """Return the states, `(S, n_x)`, that a model estimates with its memory and its process noise."""
        kept = source.training.select(~self.early)
        return starting_states(model, kept, self.starts, max(1, round(model.memory / kept.dt)), self.sensors)

    def _errors_from(self, model: SindyModel, source: Source, begin: Tensor, count: int) -> Tensor:
        """Return errors over the first horizons from states on, `(count, n_x)`."""
        kept, steps, n_x = source.training.select(~self.early), self.steps[:count], self.real.shape[-1]
        guess = predict_from(model, kept, begin, self.later[:, : steps[-1]])[..., :n_x]
        return errors_over(guess, self.real[:, : steps[-1]], steps)

    def score(self, errors: Tensor) -> float:
        """Return the mean logarithm of errors by those of the best simple model, and more where they are larger."""
        ratios = self.ratios(errors)
        seen = ratios[~ratios.isnan()]
        return float(seen.mean() + BEHIND * seen.max().clamp_min(0.0)) if len(seen) else math.inf

    def ratios(self, errors: Tensor) -> Tensor:
        """Return the logarithm of errors by those of the best simple model, `(H, n_x)`; none is below the floor."""
        least = self.floor.clamp_min(1e-300)
        most = LOST * self.simple.maximum(least)
        return (errors.maximum(least).minimum(most) / self.simple.maximum(least)).log()

    def exact(self, errors: Tensor) -> bool:
        """Tell whether no error is much larger than that of the sensor."""
        return bool(((errors <= RESOLVED * self.floor) | self.simple.isnan()).all())


@dataclass(frozen=True, eq=False)
class Candidate:
    """Hold a model that was fitted to the early part of the data, and how it predicts the kept one.

    Attributes:
        models: the model, as it was fitted for each part that was kept; the first one where it was not.
        source: the data with all of its states.
        settings: of its fit.
        errors: over each horizon, `(H, n_x)`, for each part that it was judged on.
        score: what is to be least.
        what: what it is, in words.
        structure: model with all functions, of which this one has the linear ones; None of others.
    """

    models: list[SindyModel]
    source: Source
    settings: Refinement
    errors: list[Tensor]
    score: float
    what: str
    structure: SindyModel | None = None

    @property
    def model(self) -> SindyModel:
        """The model, as it was fitted first."""
        return self.models[0]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its states but for those that follow a signal."""
        return tuple(n for n in self.source.signature.state_names if n not in self.model.followed)

    @property
    def equations(self) -> frozenset[tuple[object, ...]]:
        """Which function stands in which equation, how inputs move, and which samples are read; no coefficients."""
        names, features = self.source.signature.state_names, self.model.library.features
        terms = (self.model.coefficients != 0).nonzero().tolist()
        moves = zip(self.source.signature.input_names, self.source.training.linear_inputs.tolist(), strict=True)
        read = [(names[i], frozenset(map(_unfitted, features[k].factors))) for k, i in terms]
        return frozenset([*read, *moves, ("stride", self.source.stride)])


@dataclass
class _Search:
    """Fit candidates, those first that cost little, and keep the best."""

    given: SindyModel
    refinement: Refinement
    source: Source
    folds: list[HoldOut]
    tried: list[Candidate] = field(default_factory=list)
    began: float = field(default_factory=time.process_time)
    variations: set[tuple[Candidate, str]] = field(default_factory=set)

    @property
    def best(self) -> Candidate:
        return _best_first(self.tried)[0]

    @cached_property
    def end(self) -> float:
        """CPU time at which the last candidate ends [s]."""
        return self.began + (1 - LAST_SHARE) * self.refinement.seconds

    @cached_property
    def until(self) -> float:
        """CPU time after which no other candidate begins [s]; one that has begun goes on until all end."""
        return self.end

    @property
    def expired(self) -> bool:
        """Whether it is as late as that."""
        return time.process_time() > self.until

    @contextmanager
    def _within(self, share: float) -> Iterator[None]:
        """Try candidates for a share of the time at most."""
        last, self.until = self.until, min(self.until, time.process_time() + share * self.refinement.seconds)
        try:
            yield
        finally:
            self.until = last

    @contextmanager
    def _time_limit(self, until: float) -> Iterator[list[Event]]:
        """End a fit by trajectories at some CPU time [s], if there is a candidate, and list where that happened."""
        ended = list[Event]()

        def _stop(event: Event) -> None:
            if self.tried and time.process_time() > until:
                ended.append(event)
                raise TimeIsUp(event.phase)

        with listening(_stop):
            yield ended

    @cached_property
    def builder(self) -> LibraryBuilder | None:
        """What the library was built by, if that suits any plant."""
        return _builder_of(self.given)

    @cached_property
    def slow(self) -> float:
        """Time in which the slowest state changes [s]."""
        return characteristic(self.source.training, self.source.signature)

    def run(self) -> LogFit | None:
        """Return the best candidate, fitted to all training data; None where none could be fitted."""
        try:
            self._try_all()
            for each in _best_first(self.tried):
                with _attempt():
                    return self._final(each)
            return None
        except KeyboardInterrupt:
            if not self.tried:
                raise
            return self._final(self.best, stopped=True)

    def with_rates(self) -> tuple[SindyModel, Source]:
        """Return the model and the data with rates that nobody measured, if linear equations predict better by them."""
        wide, *_, given = (*self._structures(), (self.given, self.source))
        for structure in (wide, given) if wide[1] is not self.source else ():
            self._linear(*structure)
        return wide if self.tried and self.best.states != given[1].signature.state_names else given

    def _exact(self) -> bool:
        return all(map(HoldOut.exact, self.folds, self.best.errors))

    def _try_all(self) -> None:
        """Try what costs little first: linear equations, functions of the best, hidden states, longer windows."""
        structures = list(self._structures())
        self._single_steps(structures)
        if self.builder is None:
            self._regressed(*structures[-1])
        for structure in structures:
            self._linear(*structure)
        self.tried = [each for each in self.tried if not self._explodes(each.model, each.source)]
        self._try_functions(structures)
        if early := bool(self.tried) and self.best.score > HOPELESS:  # no function explains it
            attempt = self._try_chains if self.given.given_known else self._try_state_space
            self._try_hidden_states(self._try_disturbances, attempt)
        self._try_larger_libraries(self._near())
        with self._within(STAGE_SHARE):
            if self.builder is not None and self.tried:
                self._with_lag_states(self.best)
            self._windows_of_leaders(self._near())
        self._try_larger_libraries(self._near())
        every = self._try_disturbances, self._try_chains, self._try_state_space
        self._try_hidden_states(*([self._try_chains] if early else every))
        seen = list[Candidate]()
        while self.tried and self.best not in seen:  # until nothing gets better
            seen.append(self.best)
            self._try_larger_libraries(seen[-1:])
            self._windows(self.best)

    def _try_functions(self, structures: Sequence[tuple[SindyModel, Source]]) -> None:
        """Try lags and functions of the best linear equations of each set of states; drop lags that are chance."""
        linear = sorted((each for each in self.tried if each.structure is not None), key=lambda each: each.score)
        if linear:
            linear[0] = self._varied(linear[0])
        firsts = dict[tuple[str, ...], Candidate]()  # of each set of states the best one
        for each in linear:
            firsts.setdefault(each.states, each)
        limit, lagging = linear[0].score + HOPELESS if linear else math.inf, list[Candidate]()
        with self._within(STAGE_SHARE):
            for each in firsts.values():
                if self.best.score > 0 and (found := self._with_lag_states(each)) is not each:
                    lagging.append(found)
        for each in sorted(lagging, key=lambda each: each.score):
            if each.score < limit:
                self._select(each)
        near = [each for each in firsts.values() if each.score < limit]
        for each in sorted(near, key=lambda each: len(each.states)):  # what costs little first
            if self._has_needless_states(each):
                break
            self._select(each)
            for model, source in structures if self.builder is not None else ():
                if each.structure is model:
                    self._regressed(model, replace(source, stride=each.source.stride))
            self._try_larger_libraries([each])
        plain = [each for each in self.tried if not each.model.followed]
        if plain and self.best not in plain and not self._clearly_better(self.best, _best_first(plain)[0]):
            self.tried = plain  # by chance

    def _varied(self, of: Candidate) -> Candidate:
        """Try inputs that are linear between samples, and equations without constants, and return what is best."""
        models, source = [_warm_started(model) for model in of.models], of.source.with_linear_inputs()
        moving = self._fit(f"{of.what}{LINEAR}", models, source, self._settings(select=False), of.structure)
        of, early, segment = _better(of, moving), self.folds[0].early, of.source.training.segment
        if of.structure is None or bool(torch.isin(segment[early], segment[~early]).any()):
            return of  # what sensors read at zero differs between recordings alone
        models, structure = [_without_constants(model) for model in of.models], _without_constants(of.structure)
        free = models[0].constraints.free
        if not bool(free.any()) or torch.equal(free, of.model.constraints.free):
            return of
        models = [_warm_started(model) for model in models]
        return _better(of, self._fit(f"{of.what}, no constants", models, of.source, of.settings, structure))

    def _windows_of_leaders(self, candidates: Sequence[Candidate]) -> None:
        """Simulate the best of some candidates over longer windows, of two with the same equations the better one."""
        leaders = dict[object, Candidate]()
        for each in sorted(candidates, key=lambda each: each.score):
            leaders.setdefault(each.equations, each)
        for each in list(leaders.values())[:LEADERS]:
            self._windows(each)

    def _clearly_better(self, first: Candidate, second: Candidate) -> bool:
        """Tell whether a candidate is better in the parts that were kept, by more than they differ."""
        errors = zip(self.folds, second.errors, first.errors, strict=False)
        gains = torch.tensor([fold.score(theirs) - fold.score(mine) for fold, theirs, mine in errors])
        return len(gains) < 2 or bool(gains.mean() > CLEAR * gains.std() / len(gains) ** 0.5)

    def _has_needless_states(self, each: Candidate) -> bool:
        """Tell whether it has more states than the best one, which no simple model beats."""
        return self.best.score <= 0 and len(each.states) > len(self.best.states)

    def _near(self) -> list[Candidate]:
        """Return candidates that are not hopelessly behind the best one."""
        near = [each for each in self.tried if each.score < self.best.score + HOPELESS]
        return [each for each in near if not self._has_needless_states(each)]

    def _fit(
        self,
        what: str,
        models: Sequence[SindyModel],
        source: Source,
        settings: Refinement,
        structure: SindyModel | None = None,
    ) -> Candidate | None:
        """Fit copies of a model to what is not kept, and judge them."""
        # What is exact can only be made simpler.
        if self.tried and (self.expired or (self._exact() and source.signature.n_x >= self.best.source.signature.n_x)):
            return None
        fitted, errors, candidate = list[SindyModel](), list[Tensor](), None
        with _attempt(), reporting_as(what):
            for model, fold in zip(models, self.folds, strict=True):
                if errors and self.tried and self.expired:
                    return None  # by other parts alone it cannot be compared
                fitted.append(copy.deepcopy(model))
                fitted[-1].refinement = settings
                most = self.refinement.seconds * LARGEST_SHARE / len(self.folds)
                with self._time_limit(min(self.end, time.process_time() + most)):
                    report = fitted[-1].fit(source.fit_data(fold.fit_rows(source.stride, settings.window)))
                still = model.constraints.free.any(0) & ~(fitted[-1].coefficients != 0).any(0)
                unseen = source.training.x_next.isnan().all(0)
                if bool((still & unseen).any()) or not has_clear_lags(fitted[-1]) or self._drifts(fitted[-1]):
                    return None  # a hidden state that nothing moves, that moves nothing, or that only drifts, is none
                if any(each.code == "fit.dropped" for each in report.findings):
                    return None  # of functions that a fit finds useless a regression tells little
                if fitted[-1].substeps(source.training.dt) >= STIFF:
                    return None  # a motion that is over long before the next sample is told by none
                if self._explodes(fitted[-1], source):
                    return None
                errors.append(fold.errors(fitted[-1], source))
                hopeless = bool(self.tried) and fold.score(errors[-1]) > self.best.score + 2 * HOPELESS
                if fold.exact(errors[-1]) or hopeless:
                    break  # the other parts would tell the same
            score = self._score(fitted[0], source, errors)
            models = fitted + fitted[:1] * (len(self.folds) - len(fitted))
            candidate = Candidate(models, source, settings, errors, score, what, structure)
        if candidate is not None:
            self.tried.append(candidate)
            report_progress("fit", note=f"{what}: score {candidate.score:.3f}, best {self.best.score:.3f}")
        return candidate

    def _score(self, model: SindyModel, source: Source, errors: list[Tensor]) -> float:
        """Return what is to be least: of its errors, for each part that it was judged on, and of its size."""
        score = sum(map(HoldOut.score, self.folds, errors)) / len(errors)
        weight = torch.tensor([1 if _is_linear(feature) else 2 for feature in model.library.features])
        rates = rate_states(model.library, model.constraints)
        unseen = [i for i in source.training.x.isnan().all(0).nonzero().flatten().tolist() if i not in rates]
        size = int(weight @ (model.coefficients != 0).sum(-1)) + 2 * len(unseen)
        return score + PER_TERM * (size + int(source.training.u_end is not None) + math.log2(source.stride))

    def _again(self, what: str, of: Candidate, settings: Refinement) -> Candidate | None:
        """Fit the models of a candidate again, from their coefficients on."""
        return self._fit(what, [_warm_started(model) for model in of.models], of.source, settings, of.structure)

    def _settings(self, **changes: Any) -> Refinement:
        longest, data = self.refinement.longest_delay, self.source.training
        if longest is None:  # each stretch that is fitted loses as many samples
            stretch = len(data) if len(data) <= ROWS else ROWS // CHOSEN_STRETCHES
            longest = min(max(LATEST * data.dt, self.slow / 4), stretch * data.dt / 10)
        base = replace(self.refinement, method="trajectory", error="innovation", rounds=0, longest_delay=longest)
        return replace(base, **changes)

    @_attempt()
    def _single_steps(self, structures: Sequence[tuple[SindyModel, Source]]) -> None:
        """Try the fit of single steps, which finds exact equations in data without noise; first with measured rates."""
        fold = self.folds[0]
        for model, source in structures:
            if has_gaps(source.training) or len(model.library) > 2 * MANY:
                continue  # the cost grows with the cube of the functions
            trial = copy.deepcopy(model)
            trial.refinement = replace(self.refinement, method="integral")
            with _attempt():  # a regression of rates costs little: is it hopelessly behind the best simple model?
                trial.fit(source.training.select(fold.fit_rows()))
                if fold.score(fold.errors(trial, source)) < HOPELESS:
                    settings = replace(self.refinement, method="one_step", longest_delay=FARTHER * trial.delay)
                    found = self._fit("single steps", [_warm_started(trial)] * len(self.folds), source, settings)
                    if found is not None and found.score < 0:  # without that rate it is the same at best
                        return

    def _structures(self) -> Iterator[tuple[SindyModel, Source]]:
        """Yield the model with rates of all states, of positions, of what was measured as such, and as it is."""
        if self.builder is None or self.given.given_known == {}:
            yield self.given, self.source
            return
        names, known, every = self.given.signature.state_names, rates_of(self.given), list[dict[str, str]]()
        units = dict(zip(names, self.given.signature.state_units, strict=True))
        for part in RATE_ERRORS:
            rates = {names[i]: names[rate] for rate, i in find_rates(self.source.training, part).items()} | known
            lacking = [n for n in names if not is_speed(units[n]) and n not in rates and n not in rates.values()]
            moving = [n for n in lacking if PLACE.fullmatch(units[n])]  # beside it a current, say, may have no rate
            for added in (lacking, moving, ()):
                wide = {n: rates.get(n, rate_name(n, self.given.signature)) for n in names if n in (*rates, *added)}
                every += [wide] if wide not in (known, *every) else []
        for wide in every:
            source = self.source if set(wide.values()) <= set(names) else self.source.with_rates(wide)
            yield self._rebuilt(source, wide), source
        yield self.given, self.source

    def _rebuilt(self, source: Source, known: Mapping[str, str]) -> SindyModel:
        old = self.given
        return SindyModel(
            source.signature,
            self.builder or old.library,
            old.regression,
            old.refinement,
            known=known,
            machine_code=old.machine_code,
        )

    @_attempt()
    def _linear(self, model: SindyModel, source: Source) -> None:
        """Fit the linear functions of a model, from no delay on and from that which regressions tell, if it is long.

        Samples that are close together tell more of noise than of what is slow: so long as it predicts better, every
        second one of them is read.
        """
        plain, settings = _with_functions(model, _is_linear), self._settings(select=False)
        parts = [source.fit_data(fold.fit_rows(source.stride)) for fold in self.folds]
        if bool((parts[0].x_next.isnan() & ~source.training.x_next.isnan().all(0)).all(0).any()):
            return  # what a slow sensor reads falls between
        dt = parts[0].dt
        told, names = _rough_delay(plain, parts[0], settings.longest_delay or 0.0), source.signature.state_names
        for delay, late in ((0.5 * dt, ""), (told, ", late")) if told > dt else ((told, ""),):
            begun = [_linear_start(plain, part, delay) for part in parts]
            thin = f", one sample of {source.stride}" if source.stride > 1 else ""
            self._fit(f"linear equations of {', '.join(names)}{late}{thin}", begun, source, settings, model)
        own = [each for each in self._near() if each.structure is model]
        if own and _best_first(own)[0].source.stride == source.stride and self.slow > SPARSE * dt:
            self._linear(model, replace(source, stride=2 * source.stride))

    def _with_lag_states(self, of: Candidate) -> Candidate:
        """Try states that no sensor sees and that follow a signal, one after the other, and return the best one."""
        best = of
        for _ in range(of.source.signature.n_u):
            if self.expired:
                break
            last = best
            with _attempt():
                # Of linear equations alone, what acts at once beside a lag stands for functions that they lack.
                early = best.source.fit_data(self.folds[0].early)
                trials = lag_state_candidates(best.model, early, beside=of.structure is None)
                for lagging in trials[:LAG_STATES]:
                    signals = ", ".join(s for n, s in lagging.followed.items() if n not in last.model.followed)
                    what, models = f"{last.what}, states that follow {signals}", [lagging] * len(self.folds)
                    data = last.source.with_unmeasured(lagging.signature)
                    found = self._fit(what, models, data, self._settings(select=False), of.structure)
                    best = _better(best, found)
            if best is last:
                break
        return best

    def _try_hidden_states(self, *attempts: Callable[[], None]) -> None:
        """Try hidden states where a simple model predicts better, and drop them if it is chance."""
        if self.builder is None or self.given.given_known == {} or not self.tried or self.best.score <= 0:
            return
        known, before = len(self.tried), self.best
        with self._within(STAGE_SHARE):
            for attempt in attempts:
                attempt()
        if any(each in self.tried[known:] for each in self._near()):
            # Functions first, as longer windows cost more.
            self._try_larger_libraries([min(self.tried[known:], key=lambda each: each.score)])
            self._windows_of_leaders([each for each in self._near() if each in self.tried[known:]])
        if self.best is before or not self._clearly_better(self.best, before):
            del self.tried[known:]

    def _hidden_states(self, model: SindyModel) -> list[str]:
        """Return states of a model that no sensor sees, but for rates, disturbances and those that follow a signal."""
        known = {*self.source.signature.state_names, *rates_of(model).values(), *model.followed}
        return [n for n in model.signature.state_names if n not in (*known, *self._disturbances(model))]

    def _disturbances(self, model: SindyModel) -> dict[str, float]:
        """Return the hidden states that nothing moves but noise, and the time in which each fades [s]."""
        names, seen = model.signature.state_names, {*self.source.signature.state_names, *rates_of(model).values()}
        alone = {
            names[i]: float(model.coefficients[:, i].sum())
            for i in disturbance_states(model.library, model.coefficients)
        }
        return {n: -1 / rate if rate < 0 else math.inf for n, rate in alone.items() if n not in seen}

    def _drifts(self, model: SindyModel) -> bool:
        """Tell whether a disturbance hardly fades, as an offset, which equations hold and a plan cannot foresee."""
        return any(seconds > self.slow for seconds in self._disturbances(model).values())

    def _explodes(self, model: SindyModel, source: Source) -> bool:
        """Tell whether a model leaves all bounds under inputs that leave linear equations near what was seen."""
        linear = [each for each in self.tried if each.structure is not None]
        if not linear or _largest_excursion(model, source.training) < EXPLODED:
            return False
        best = min(linear, key=lambda each: each.score)
        return _largest_excursion(best.model, best.source.training) < NEAR

    @_attempt()
    def _try_disturbances(self) -> None:
        """Try hidden states that add to inputs, one after the other."""
        for signal in self.source.signature.input_names:
            of = self.best
            if not all(signal in _variables_read(model) for model in of.models):
                continue
            models = [with_disturbance(model, signal, self.slow / 2) for model in of.models]
            wide = of.source.with_unmeasured(models[0].signature)
            self._fit(f"{of.what}, {signal} disturbed", models, wide, self._settings(select=False))

    @_attempt()
    def _try_chains(self) -> None:
        """Try hidden states behind each state that a simple model predicts better; the other equations stay."""
        of, signature = self.best, self.source.signature
        linear = of.structure is not None and not self.given.given_known
        if linear or signature.n_x == 1 or self._hidden_states(of.model):
            return  # it would be a linear model, or have some already
        judged = zip(self.folds, of.errors, strict=False)
        ratios = torch.stack([fold.ratios(errors).nanmean(0) for fold, errors in judged]).nanmean(0).nan_to_num()
        behind = dict(zip(of.source.signature.state_names, ratios.tolist(), strict=False))
        measured = replace(self.source, stride=of.source.stride)
        measured = measured if of.source.training.u_end is None else measured.with_linear_inputs()
        early = [of.source.fit_data(fold.fit_rows(of.source.stride)) for fold in self.folds]
        for state in sorted(signature.state_names, key=lambda name: -behind[name]):
            if behind[state] > 0:
                parts = zip(of.models, early, strict=True)
                chains = (chain_candidates(*each, state, signature.state_names) for each in parts)
                self._ever_more_states(f"{of.what}, {state} with", chains, measured)

    @_attempt()
    def _try_state_space(self) -> None:
        """Try linear equations of all states with hidden ones, first under inputs that move as in the best model."""
        own = replace(self.source, stride=self.best.source.stride)
        holds = [(own, ""), (own.with_linear_inputs(), LINEAR)]
        for source, moving in holds if self.best.source.training.u_end is None else holds[::-1]:
            if self.best.score > 0 and not self.given.given_known:  # it would have equations of its own
                parts = [source.fit_data(fold.fit_rows(source.stride)) for fold in self.folds]
                begun = (state_space_candidates(self.given, part) for part in parts)
                self._ever_more_states(f"linear equations{moving}, with", begun, source)

    def _ever_more_states(self, what: str, candidates: Iterable[Iterator[list[SindyModel]]], source: Source) -> None:
        """Try models of ever more hidden states, for each part that is kept, until they do not get better."""
        best, worse, seconds = math.inf, 0, 0.0
        for count, begun in enumerate(zip(*candidates, strict=True), 1):
            before = time.process_time()
            if before + seconds > self.until or self._exact() or worse > WORSE:  # more of them cost no less
                break
            if models := self._best_starts(begun, source):
                wide, states = source.with_unmeasured(models[0].signature), "state" if count == 1 else "states"
                found = self._fit(f"{what} {count} hidden {states}", models, wide, self._settings(select=False))
                worse = 0 if found is not None and found.score < best else worse + 1
                best = min(best, found.score if found is not None else math.inf)
                seconds = time.process_time() - before

    def _best_starts(self, begun: Sequence[Sequence[SindyModel]], source: Source) -> list[SindyModel]:
        """Return of models, for each part that is kept, those that predict best before a fit; none of none."""

        def _cost(k: int) -> float:
            model = copy.deepcopy(begun[0][k])
            if (first := model.initial) is not None:
                model.set_coefficients(torch.where(model.constraints.free, first, model.constraints.offset))
            with _attempt():
                fold, wide = self.folds[0], source.with_unmeasured(model.signature)
                return fold.score(fold.errors(model, wide))
            return math.inf

        for k in sorted(range(len(begun[0])), key=_cost):
            names = begun[0][k].signature.state_names
            alike = [next((each for each in models if each.signature.state_names == names), None) for models in begun]
            if all(alike):
                return [begun[0][k], *filter(None, alike[1:])]
        return []

    @_attempt()
    def _select(self, of: Candidate) -> None:
        """Let functions come in and go, at two prices; of many those of one factor first, of too many none."""
        if of.structure is None:  # all of its functions are in its library
            self._at_prices(f"{of.what}, functions", of, replace(of.settings, rounds=0, select=True))
            return
        if len(of.structure.library) == len(of.model.library):
            return
        # Of those that suit any plant quotients of inertias are left to regressions.
        stages, rows = [of.structure], len(of.source.fit_data(self.folds[0].fit_rows(of.source.stride)))
        if self.builder is not None:
            stages = [_with_functions(of.structure, lambda each: not _quotients(each))]
            if len(stages[0].library) > MANY:
                stages.insert(0, _with_functions(stages[0], lambda each: len(each.factors) <= 1))
            stages = [each for each in stages if len(each.library) * SAMPLES_EACH <= rows]
        for library in stages:
            for signal in of.model.followed.values():
                library = with_lag_state(library, signal, acts_at_once(of.model, signal))
            begun = replace(of, models=[_with_coefficients(library, model) for model in of.models], structure=None)
            found = self._at_prices(f"{of.what}, functions", begun, replace(of.settings, rounds=0, select=True))
            of = replace(found, structure=of.structure, what=of.what) if found is not None else of

    def _at_prices(self, what: str, last: Candidate, settings: Refinement) -> Candidate | None:
        """Let functions come in and go from a candidate on, at rising prices, and return the best one; None of none."""
        best: Candidate | None = None
        for penalty in PRICES:
            tried = what if penalty <= 1 else f"{what}, few of them"
            found = self._again(tried, last, replace(settings, penalty=penalty))
            if found is None:
                break
            same = found.equations == last.equations
            last, best = found, found if best is None else _better(best, found)
            known = found.model.covariance
            sure = known is not None and bool((known.shares(found.model.coefficients) < SURE).all())
            if same or sure:  # the higher price would change nothing
                break
        return best

    @_attempt()
    def _regressed(self, model: SindyModel, source: Source) -> None:
        """Begin at the equations that regressions of rates of change choose, as of a library without linear ones."""
        if len(model.library) > MANY and self.builder is not None:
            model = self._with_one_inertia(model, source)
        if len(model.library) > MANY:
            return
        names, settings = ", ".join(source.signature.state_names), self._settings(rounds=2)
        pieces = replace(settings, error="prediction", longest_delay=self.refinement.longest_delay)
        what, begun = f"functions of {names}, simulations of {pieces.window} samples", [model] * len(self.folds)
        if (found := self._fit(what, begun, source, pieces)) is not None:
            begun = [_warm_started(each) for each in found.models]
        self._fit(f"functions of {names} chosen by regressions", begun, source, settings)

    def _with_one_inertia(self, model: SindyModel, source: Source) -> SindyModel:
        """Return a model with quotients of the one angle that regressions on all functions tell, or of none."""
        late = self.best.model.delay if self.tried else 0.0
        theta, dx = _mean_rates(model, delay_and_trim(source.fit_data(self.folds[0].fit_rows(source.stride)), late))
        quotients = [_quotients(each) for each in model.library.features]

        def _cost(angle: frozenset[Factor]) -> float:
            places = [k for k, each in enumerate(quotients) if each <= angle]
            free = model.constraints.free[places]
            return unexplained(free, theta[:, places], dx) + 0.5 * int(free.sum()) * math.log(len(dx))

        none, *_ = angles = list(dict.fromkeys([frozenset[Factor](), *quotients]))
        best = min(angles, key=_cost)
        few = len(dx) < SAMPLES_EACH * sum(each <= best for each in quotients)
        if few or _cost(none) - _cost(best) < 0.5 * len(dx) * math.log(TELLING):
            best = none
        return _with_functions(model, lambda each: _quotients(each) <= best)

    @_attempt()
    def _try_larger_libraries(self, candidates: Iterable[Candidate]) -> None:
        """Try more functions, those of the best states first, where the library was left to the data."""
        sets = dict.fromkeys(each.states for each in sorted(candidates, key=lambda each: each.score))
        for states, what in product(sets, FUNCTION_SETS if self.builder is not None else ()):
            of = min((each for each in self.tried if each.states == states), key=lambda each: each.score)
            if (of, what) in self.variations:
                continue
            self.variations.add((of, what))
            model = of.model
            known = {frozenset(map(_unfitted, each.factors)) for each in model.library.features}
            more = [each for each in self._functions(what, model) if frozenset(each.factors) not in known]
            if not more:
                continue
            library = Library(model.signature, [*model.library.features, *more], step=model.step)
            lags = torch.tensor([n in model.followed for n in model.signature.state_names])
            free = torch.cat([model.constraints.free, (model.constraints.free.any(0) & ~lags).expand(len(more), -1)])
            begun = replace(of, models=[_with_library(each, library, free) for each in of.models])
            own = of.settings if of.settings.error == "prediction" else self._settings()
            self._at_prices(what, begun, replace(own, rounds=0, select=True))

    def _functions(self, what: str, model: SindyModel) -> Sequence[Feature]:
        """Return functions of a kind of those states and inputs that a model has in its equations.

        Roots are those of what is never negative; functions of a plant's library are new to models with hidden states.
        """
        signature, read = model.signature, _variables_read(model) - {*self._disturbances(model)}
        names = [name for name in (*signature.state_names, *signature.input_names) if name in read]
        units = dict(zip(signature.state_names, signature.state_units, strict=True))
        if what == "functions of single states":
            own = self.builder(signature).features if self.builder is not None and self._hidden_states(model) else ()
            return [each for each in own if len(each.factors) == 1 and each.variables <= set(names)]
        if what == "signed squares":
            return [
                variable(n) * function_of("abs", n)
                for n in names
                if n in model.followed or n not in units or is_speed(units[n])
            ]
        if what == "cubic functions":
            names = [n for n in names if units.get(n) not in ANGLES]  # sines are bounded beyond what was seen, too
            return polynomial(signature, 3, names).features if len(names) <= CUBIC else ()
        x = self.source.training.x
        levels = ((x > 0).any(0) & ~(x <= 0).any(0)).tolist()
        roots = [n for (n, unit), level in zip(units.items(), levels, strict=False) if level and unit not in ANGLES]
        return [function_of("sqrt", n) for n in (*roots, *(model.followed if roots else ()))]

    @_attempt()
    def _windows(self, of: Candidate) -> None:
        """Simulate over windows that grow, each fit begun where the one before ended."""
        if self.expired or (of, "windows") in self.variations:
            return
        self.variations.add((of, "windows"))
        last, best, worse = of, of, 0
        window = max(SHORTEST, 2 * of.settings.window) if of.settings.error == "prediction" else SHORTEST
        longest = min(len(of.source.training) // (2 * of.source.stride), LONGEST)
        while window <= longest and worse <= WORSE:
            settings = self._settings(error="prediction", window=window, select=False)
            found = self._again(f"{of.what}, simulations of {window} samples", last, settings)
            if found is None:
                break
            worse = 0 if found.score < best.score else worse + 1
            last, best, window = found, _better(best, found), 2 * window
        if best is not of:
            self._select(best)

    def _final(self, best: Candidate, stopped: bool = False) -> LogFit:
        """Fit the best candidate to all training data; to the part that it was fitted to, if it is worse then.

        So it is where there is no time, too.
        """
        settings, data, late, fold = best.settings, best.source.training, self.expired, self.folds[0]
        stride, window = best.source.stride, settings.window
        early, whole = fold.fit_rows(stride, window), choose_stretches(len(data), FINAL_ROWS * stride, window * stride)
        linear = zip(best.model.signature.input_names, data.linear_inputs.tolist(), strict=True)
        # Of a long log it is fitted to stretches: what chance leaves of the coefficients is small then.
        for rows in (early,) if stopped else (whole, early):
            model = _warm_started(best.model)
            if settings.method == "one_step":
                model.initial, model.initial_delay = self.given.initial, self.given.initial_delay
            else:
                settings = replace(settings, rounds=0, select=False)
            model.refinement = settings
            budget = self.refinement.seconds
            until = max(self.began + budget, time.process_time() + LAST_SHARE * budget)
            limited = self._time_limit(until if settings.method == "trajectory" else math.inf)
            with reporting_as("fit to all training data"), limited as ended:
                report = model.fit(best.source.fit_data(rows))
            worse = fold.score(fold.errors(model, best.source)) > fold.score(best.errors[0]) + HOPELESS
            if not (worse or self._drifts(model) or self._explodes(model, best.source)):
                break
        model.initial, model.initial_delay = self.given.initial, self.given.initial_delay
        model.linear_inputs, model.stride = tuple(name for name, moves in linear if moves), stride
        errors = [self.folds[0].errors(best.model, best.source, filtered=True)]
        model.memory, model.process_noise = best.model.memory, best.model.process_noise
        for fold, each, _ in list(zip(self.folds, best.models, best.errors, strict=False))[1:]:
            each.memory, each.process_noise = model.memory, model.process_noise
            with _attempt():
                errors.append(fold.errors_by_memory(each, best.source))
        best = replace(best, errors=errors)
        seconds = self.folds[0].steps[-1] * data.dt
        findings = [*self._behind(best), note("fit.candidates", count=len(self.tried), seconds=seconds)]
        known = self.source.signature.state_names
        fading = self._disturbances(model)
        findings += [note("fit.disturbance", state=name, seconds=after) for name, after in fading.items()]
        if hidden := self._hidden_states(model):
            findings.append(note("fit.hidden_states", states=hidden))
        if rates := [name for name in best.states if name not in (*known, *hidden, *fading)]:
            findings.append(note("fit.added_rates", states=rates, known={}))
        if model.linear_inputs:
            findings.append(note("fit.linear_inputs", inputs=model.linear_inputs))
        if stride > 1:
            findings.append(note("fit.stride", stride=stride))
        if (count := int(rows.sum())) < len(data):
            stretches = int((rows.long().diff(prepend=torch.zeros(1, dtype=torch.long)) > 0).sum())
            findings.append(note("fit.fitted_to", rows=count, total=len(data), stretches=stretches))
            report = replace(report, findings=tuple(f for f in report.findings if f.code != "fit.chosen_on"))
        if stopped or late or ended:
            findings.append(weak("fit.budget", seconds=time.process_time() - self.began, stopped=stopped))
        return LogFit(model, best.source, replace(report, findings=(*findings, *report.findings)))

    def _behind(self, best: Candidate) -> list[Finding]:
        """Say where a simple model predicted better what was kept."""
        fold, ratios = self.folds[0], list(map(HoldOut.ratios, self.folds, best.errors))
        if len({len(each) for each in ratios}) > 1:
            ratios = ratios[:1]
        behind = torch.stack(ratios).mean(0).exp().nan_to_num(0.0)
        k, i = divmod(int(behind.argmax()), behind.shape[1])
        if float(behind[k, i]) <= BEHIND_BY:
            return []
        name, seconds = best.source.signature.state_names[i], fold.steps[k] * best.source.training.dt
        return [weak("fit.behind", state=name, seconds=seconds, factor=float(behind[k, i]))]


def _horizon_samples(last: int, first: float) -> list[int]:
    """Return horizons up to the last one [samples]."""
    return sorted({round(k) for k in np.geomspace(min(max(1, round(first)), last), last, HORIZONS).tolist()})


def _builder_of(model: SindyModel) -> LibraryBuilder | None:
    """Return what the library of a model was built by, if that suits any plant."""
    names = set(model.library.names)
    return next((each for each in (auto_rig, auto) if set(each(model.signature).names) == names), None)


def _largest_excursion(model: SindyModel, data: Transitions) -> float:
    """Return how far a model moves where each input is held at an end of its range in the data, in turn [ranges].

    Samples that are kept do not show this where they lie within the range of those that were fitted.
    """
    if not data.u.shape[1]:
        return 0.0
    u = data.u.double().mean(0).repeat(2 * data.u.shape[1], 1)
    for i, ends in enumerate(zip(data.u.amin(0), data.u.amax(0), strict=True)):
        u[2 * i : 2 * i + 2, i] = torch.stack(ends).double()
    x = model.guess_states(data).x.double().nanmedian(0).values.nan_to_num().expand(len(u), -1)
    steps = min(data.longest_segment, LIMIT)
    path = model.simulate(x, u.unsqueeze(1).expand(-1, steps, -1), data.dt, model.substeps(data.dt))
    return float((path / x.new_tensor(model.signature.x_scale)).abs().nan_to_num(math.inf).max())


def _warm_started(model: SindyModel) -> SindyModel:
    """Return a copy of a fitted model that is fitted anew from its coefficients on."""
    other = copy.deepcopy(model)
    other.initial, other.initial_delay = model.coefficients.clone(), model.delay
    return other


def _variables_read(model: SindyModel) -> set[str]:
    """Return the states and inputs of which equations of a model have functions."""
    used = (model.coefficients != 0).any(-1).nonzero().flatten().tolist()
    return {name for k in used for name in model.library.features[k].variables}


def _is_linear(feature: Feature) -> bool:
    """Tell whether a function is the constant, a state or an input, or what one is ahead of another."""
    own = feature.factors
    return len(own) <= 1 and all(factor.function in ("id", "ahead") and factor.power == 1 for factor in own)


def _quotients(feature: Feature) -> frozenset[Factor]:
    """Return the moments of inertia that a function is divided by."""
    return frozenset(factor for factor in feature.factors if factor.function in QUOTIENTS)


def _with_functions(model: SindyModel, wanted: Callable[[Feature], bool]) -> SindyModel:
    """Return a model with those functions alone that are wanted."""
    places = [k for k, each in enumerate(model.library.features) if wanted(each)]
    return _with_library(model, model.library.subset(places), model.constraints.free[places])


def _without_constants(model: SindyModel) -> SindyModel:
    """Return a model without constants but those that are known."""
    varies = torch.tensor([[bool(feature.factors)] for feature in model.library.features])
    return _with_library(model, model.library, model.constraints.free & varies)


def _rough_delay(model: SindyModel, data: Transitions, longest: float) -> float:
    """Return the delay of the inputs, between half a sample and a longest one, that regressions tell [s]."""
    steps = math.floor(math.log(max(longest / data.dt, 0.5) / 0.5, DELAY_RATIO))

    def _cost(delay: float) -> float:
        theta, dx = _mean_rates(model, delay_and_trim(data, delay))
        return unexplained(model.constraints.free, theta, dx) / len(dx)

    return min((0.5 * data.dt * DELAY_RATIO**k for k in range(steps + 1)), key=_cost) if longest else 0.0


def _linear_start(model: SindyModel, data: Transitions, delay: float) -> SindyModel:
    """Return a model that begins at the linear equations that a regression finds, its inputs late [s]."""
    theta, dx = _mean_rates(model, delay_and_trim(data, delay))
    begun = copy.deepcopy(model)
    begun.initial = model.constraints.offset + fit_supported(theta, dx, model.constraints.free)
    begun.initial_delay = delay
    return begun


def _mean_rates(model: SindyModel, data: Transitions) -> Rows:
    """Return functions averaged over parts of a recording, and rates of change beyond those that are known."""
    library, offset = model.library, model.constraints.offset
    seen = RegressionData.of(data, rate_states(library, model.constraints), True)
    theta, dx = seen.rows(library, lambda x, u: library(x, u) @ offset)
    return theta, dx - theta @ offset


def _with_library(model: SindyModel, library: Library, free: Tensor) -> SindyModel:
    """Return a model with other functions, which may stand where `free` is true, and the coefficients of the first."""
    other = SindyModel(model.signature, library, model.regression, model.refinement, machine_code=model.machine_code)
    other.constraints = Constraints(free, library.aligned(model.library, model.constraints.offset))
    return _with_coefficients(other, model)


def _with_coefficients(model: SindyModel, of: SindyModel) -> SindyModel:
    """Return a copy of a model with the delay of another one, and what that has of the functions of both."""
    other, numbers = copy.deepcopy(model), {_unfitted(shape): shape.frequency for shape in of.library.shapes}
    shapes = other.library.shapes
    other.library = other.library.with_shapes([numbers.get(_unfitted(each), each.frequency) for each in shapes])
    other.set_coefficients(other.library.aligned(of.library, of.coefficients))
    other.delay = of.delay
    return other


def _unfitted(factor: Factor) -> Factor:
    """Return a factor with the first guess of the number inside it."""
    return replace(factor, frequency=factor.fitted) if factor.fitted else factor


def _best_first(candidates: Sequence[Candidate]) -> list[Candidate]:
    return sorted(candidates, key=lambda each: round(each.score, 3))  # of two alike, the first that was tried


def _better(first: Candidate, second: Candidate | None) -> Candidate:
    return first if second is None or first.score <= second.score else second
