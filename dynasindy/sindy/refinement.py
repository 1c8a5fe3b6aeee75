"""Refinement of a sparse model: from the trapezoidal rule to what the data can tell."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from torch import Tensor

from dynasindy.limits import Count
from dynasindy.progress import report_progress
from dynasindy.sindy import one_step_fit as one_step
from dynasindy.sindy.codegen import generate
from dynasindy.sindy.covariance import Covariance, of_rates
from dynasindy.sindy.delay import (
    delay_and_trim,
    estimate_delay,
    refine_delay,
    rows_after_delay,
    search_range,
    unexplained,
)
from dynasindy.sindy.fit_report import Refined
from dynasindy.sindy.library import Constraints, Library
from dynasindy.sindy.noise import looks_noisy
from dynasindy.sindy.one_step_fit import refine_one_step
from dynasindy.sindy.reconstruction import DelayedRecording, RegressionData, find_missing_rates, has_gaps, rate_states
from dynasindy.sindy.regression import Regression, Rows, RunningSums, means
from dynasindy.sindy.shape_parameters import fit_shapes
from dynasindy.sindy.shooting import Descent, RunsAway, shooting_covariance
from dynasindy.sindy.trajectory_fit import WORSE, TrajectoryFit, few_steps, refine_trajectory, trajectory_error_ratio
from dynasindy.systems.transitions import Transitions

AGAIN = 3
"""Rounds at most in which delay and equations are fitted in turn."""
HOPELESS = 4.0
"""Factor on the errors of windows on their own, beyond which no other delay lets one trajectory fit."""
STEPS = 6
"""Gauss-Newton steps after which two delays are compared."""
PERIODS = 2
"""Control periods within which noisy samples are searched for a delay where no regression tells one. An unstable plant
is excited under feedback, and in such data a longer delay, with other equations, may explain as much as the true
one."""
SOON = 0.05
"""The same [s], of samples that are so close that two control periods are less."""
FARTHER = 2
"""Delays of a first estimate within which a delay is looked for."""
ALIKE = 0.01
"""Samples by which a delay may differ from a whole number and be taken for it."""
SEVERAL = 10
"""Steps of a difference equation over whose mean samples are searched for a delay that single ones do not tell."""
METHODS = ("integral", "one_step", "trajectory", "auto")
ERRORS = ("auto", "simulation", "coloured", "prediction")
COMPARED = "the fit compares whole simulations with the log and not single steps, as {}"
STEPWISE = (
    "the fit predicts each sample from the one before, as errors of such predictions do not look like noise of the "
    "sensors"
)
"""Why a method was chosen."""
Model = tuple[Library, Tensor]
"""A library with the numbers inside its fitted factors, and coefficients, `(n_features, n_x)`."""


@dataclass(frozen=True)
class Refinement:
    """Settings of the refinement.

    Attributes:
        method: `integral` repeats the regression with a fourth-order integral form, at the cost of a regression;
            `one_step` minimises the one-step prediction error after that, for data without noise; `trajectory`
            minimises the error of whole trajectories, their start states estimated too, for data with noise;
            `auto` takes `trajectory` where the one-step errors look like measurement noise, else `one_step`. Data in
            which a state was not measured are always fitted by `trajectory`.
        rounds: repetitions of the fourth-order regression.
        tolerance: unexplained part of a rate of change that is taken as exact.
        window: sampling intervals between two states that `trajectory` estimates.
        longest_delay: longest delay of the inputs that is looked for [s], in whole samples, then in fractions of them;
            0 takes the inputs as they are. None looks within ten samples where a regression clearly tells a delay,
            farther where it is longer; else within two control periods or 0.05 s, or, without noise, not at all.
        error: what `trajectory` minimises: of one trajectory through each segment (`simulation`, output error), what
            is new in such errors, as they last from sample to sample (`coloured`), or of windows that begin anew
            (`prediction`), for plants that are pushed at random or unstable; `auto` takes windows that begin anew
            where they leave over much less than a trajectory, and keeps the latter aside.
            The default is `auto` for the method `auto`, and `simulation` for others.
        correlated: whether a coefficient of `trajectory` must be worth the more, the longer errors last: every model
            of a real plant leaves over more than noise. With noise alone it changes nothing. If not, every sample
            counts. By default it must with `prediction`, whose errors last no longer than a window; what pushes a plant
            may last through one simulation, beside which no function would be worth anything.

    Raises:
        ValueError: a setting is not allowed.
    """

    method: Literal["integral", "one_step", "trajectory", "auto"] = "integral"
    rounds: Count = 2
    tolerance: float = 1e-6
    window: int = 20
    longest_delay: float | None = 0.0
    error: Literal["auto", "simulation", "coloured", "prediction"] | None = None
    correlated: bool | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"refinement got method {self.method!r}; allowed are {', '.join(METHODS)}: choose one")
        if self.error not in (None, *ERRORS):
            raise ValueError(f"refinement got error {self.error!r}; allowed are {', '.join(ERRORS)}: choose one")
        if not 0 <= self._longest < math.inf:
            raise ValueError(f"refinement got longest_delay {self.longest_delay} s; allowed is 0 or more, or null")
        if self.rounds < 0 or not self.tolerance > 0 or self.window < 1:
            raise ValueError(
                f"refinement got rounds {self.rounds}, tolerance {self.tolerance}, window {self.window}; allowed are "
                "rounds >= 0, tolerance > 0, window >= 1: correct them"
            )

    @property
    def _longest(self) -> float:
        return self.longest_delay or 0.0

    def run(
        self,
        library: Library,
        coefficients: Tensor,
        constraints: Constraints,
        data: Transitions,
        guess: Transitions | None = None,
        late: float = 0.0,
    ) -> Refined:
        """Return refined coefficients, the library with its fitted factors, and the delay of the inputs.

        Args:
            library: candidate functions.
            coefficients: first estimate, `(n_features, n_x)`.
            constraints: what is known of the equations.
            data: transitions to refine on, NaN where a state was not measured.
            guess: the same, the states that were not measured guessed; needed where there are such states.
            late: delay of the inputs of the first estimate [s], if it has one; it is where the search begins.
        """
        guess = data if guess is None else guess
        first, longest, rough = (library, coefficients), self.longest_delay, late
        if longest is None:
            longest, rough = self._reach(first, constraints, data, guess)
            longest, rough = max(longest, FARTHER * late), rough or late
        settings = replace(self, longest_delay=longest)
        # A delay that a regression tells may explain how states go on, where nobody says how long it may be.
        lacking = find_missing_rates(library, delay_and_trim(data, rough)) if longest else []
        if not lacking:
            return settings._run(first, constraints, data, guess, rough)
        # A delay would stand for the rate that is missing.
        note = (
            f"no delay of the inputs was looked for, as it would stand for the rate of {' and '.join(lacking)}, "
            "which the log lacks"
        )
        alone = replace(self, longest_delay=0.0)._run(first, constraints, data, guess)
        return alone._replace(notes=(*alone.notes, note))

    def _run(
        self, first: Model, constraints: Constraints, data: Transitions, guess: Transitions, late: float = 0.0
    ) -> Refined:
        """Return what was found; the search for a delay begins at `late` [s], by a regression where that is 0."""
        library, coefficients = first
        recording = DelayedRecording.of(data, guess, rate_states(library, constraints), self._longest)
        brief = recording.brief(self._longest)
        delay = late or self._rough(library, coefficients, constraints, brief)
        if delay and self.method in ("integral", "one_step"):
            library, coefficients = self._regressed(library, coefficients, constraints, brief.seen(delay))
            delay = self._regressed_delay(delay, (library, coefficients), constraints, brief)
        found = self._regressed(library, coefficients, constraints, brief.seen(delay))
        raw, hidden = recording, not bool(found[1].any()) and self.method in ("auto", "trajectory")
        if hidden and not bool(data.x.isnan().any()):  # noise of single samples may hide every function
            recording, found = self._smoothed(found, constraints, recording, delay)
        if not late and not bool(found[1].any()):  # no function is left to follow, step by step or further
            return Refined(*found, delay)
        method, noisy, notes = self._chosen(*found, data, raw.guessed(delay))
        left = None
        if method == "one_step":
            found = refine_one_step(*found, constraints.free, recording.guessed(delay), self.tolerance)
            left = one_step.one_step_errors(*found, recording.guessed(delay))
        known = self._certainty(method, found, constraints, recording, delay)
        refined = Refined(*found, delay, covariance=known, missed=left)
        if method == "trajectory":
            if noisy and not hidden:
                recording, found = self._smoothed(found, constraints, recording, delay)
            refined = self._by_trajectories(found, delay, constraints, recording)
        return refined.with_notes(notes, self._longest, data.dt)

    def _smoothed(
        self, found: Model, constraints: Constraints, recording: DelayedRecording, delay: float
    ) -> tuple[DelayedRecording, Model]:
        """Return a recording as one whose samples are noisy, and what regressions find in it."""
        smooth = recording.smoothed(found[0].step)
        return smooth, self._regressed(*found, constraints, smooth.brief(self._longest).seen(delay))

    def _certainty(
        self, method: str, found: Model, constraints: Constraints, recording: DelayedRecording, delay: float
    ) -> Covariance | None:
        """Return how well coefficients are known that regressions or single steps have found, if there are any."""
        if method == "trajectory" or not bool(found[1].any()):
            return None
        if method == "one_step":
            return one_step.one_step_covariance(*found, constraints.free, recording.guessed(delay), self.tolerance)
        rows = recording.brief(self._longest).seen(delay).rows(found[0], generate(*found))
        return of_rates(found[1], constraints.free, *rows)

    def _rough(
        self, library: Library, coefficients: Tensor, constraints: Constraints, recording: DelayedRecording
    ) -> float:
        """Return the delay of whole samples that a regression finds [s]; 0 where none is looked for."""
        if not self._longest:
            return 0.0
        field, dt = generate(library, coefficients), recording.data.dt
        return estimate_delay(constraints.free, lambda d: recording.seen(d).rows(library, field), dt, self._longest)

    def _regressed_delay(
        self, rough: float, found: Model, constraints: Constraints, recording: DelayedRecording
    ) -> float:
        """Return the delay in fractions of a sample that regressions of samples without noise tell [s]."""
        field, data = generate(*found), recording.data

        def _cost(trial: float) -> float:
            return unexplained(constraints.free, *recording.seen(trial).rows(found[0], field))

        fine = refine_delay(
            rough, data.dt, self._longest, math.log(max(len(data), 2)), _cost, found[0].step is not None
        )
        return rough if abs(fine - rough) < ALIKE * data.dt else fine

    def _reach(
        self, found: Model, constraints: Constraints, data: Transitions, guess: Transitions
    ) -> tuple[float, float]:
        """Return how long a delay of the inputs may be, and how long it seems to be, as a regression tells [s]."""
        field, rates = generate(*found), rate_states(found[0], constraints)
        noisy = self.method == "trajectory" or bool(data.x.isnan().any())
        if not noisy and self.method == "auto":
            noisy = looks_noisy(*found, guess)

        def _rows(late: int, farthest: int, read: DelayedRecording, several: int = 1) -> Rows:
            recording = replace(read, known=rows_after_delay(data, farthest * data.dt)).brief(farthest * data.dt)
            return means(recording.seen(late * data.dt).rows(found[0], field), several)

        least = max(PERIODS * data.substeps, math.floor(SOON / data.dt + 1e-9)) if noisy else 0
        recording = DelayedRecording.of(data, guess, rates, 0.0)
        farthest, best = search_range(constraints.free, partial(_rows, read=recording), least)
        step = found[0].step
        if (noisy or step is not None) and not best and not bool(has_gaps(data)):
            # Most of single steps may be noise, which no delay explains: averages tell it, or means over jumps.
            read, several = recording.smoothed(step), 1 if step is None else SEVERAL
            farthest, best = search_range(constraints.free, partial(_rows, read=read, several=several), least)
        return farthest * data.dt, best * data.dt

    def _by_trajectories(
        self, first: Model, rough: float, constraints: Constraints, recording: DelayedRecording
    ) -> Refined:
        """Return the model that trajectories tell, the delay, and which error was minimised if that was chosen."""
        descent = Descent(min(self.window, int(recording.known.sum())), correlated=bool(self.correlated))
        kinds = {
            "simulation": descent,
            "coloured": replace(descent, coloured=True),
            "prediction": replace(descent, joined=False, correlated=self.correlated is not False),
        }
        error = self.error or ("auto" if self.method == "auto" else "simulation")
        if error != "auto":
            return self._in_turn(first, rough, constraints, recording, kinds[error])
        whole: Refined | None = None
        try:
            found = self._in_turn(first, rough, constraints, recording, descent, HOPELESS)
            ratio = _strain(found[:2], found.delay, constraints.free, recording, descent)
        except RunsAway:
            why = "one simulation through all samples runs away"
        else:
            worst = int(ratio.argmax())
            name = first[0].signature.state_names[worst]
            times = f"{ratio[worst]:.2f} times"
            if not math.isfinite(ratio[worst]):
                why = "a fit of one simulation through all samples leaves no function"
            elif float(ratio[worst]) <= WORSE:
                pieces = int(recording.data.begins().sum())
                over = "of each of its stretches between gaps, " if pieces > 1 else ""
                note = (
                    f"the model follows the log in one simulation {over}from its first sample to its last: the error "
                    f"of {name} is {times} that of simulations that begin anew every {descent.window} samples, which "
                    "noise of the sensors explains (error=simulation)"
                )
                return found._replace(notes=(note, *found.notes))
            else:
                strays = f"in one simulation through all samples the error of {name} is {times}"
                so = "so something pushes the plant, or functions are missing"
                why = f"{strays} as large, {so}"
                aside = (f"{strays} that of pieces that begin anew every {descent.window} samples, {so}",)
                whole = found._replace(notes=(*aside, *found.notes), in_pieces=True)
        note = (
            f"the fit simulates the log in pieces that begin anew every {descent.window} samples: {why} "
            "(error=prediction)"
        )
        found = self._in_turn(first, rough, constraints, recording, kinds["prediction"])
        return found._replace(notes=(note, *found.notes), in_pieces=True, aside=whole)

    def _in_turn(
        self,
        found: Model,
        delay: float,
        constraints: Constraints,
        recording: DelayedRecording,
        descent: Descent,
        hopeless: float = math.inf,
    ) -> Refined:
        """Return the model that trajectories tell, and the delay, fitted in turn with it.

        Turns end where one trajectory strays more than `hopeless` times: no other delay mends that.
        """
        free = constraints.free

        def _fitted(found: Model, delay: float) -> TrajectoryFit:
            return refine_trajectory(*found, free, recording.measured(delay), descent, recording.guessed(delay).x)

        if self._longest:
            delay = self._fine(delay, found, free, recording, descent)
            found = self._regressed(*found, constraints, recording.brief(self._longest).seen(delay))
        fitted = _fitted(found, delay)
        # The equations that were chosen tell the delay better than those they were chosen from.
        for _ in range(AGAIN if self._longest else 0):
            last, delay = delay, self._fine(delay, fitted[:2], free, recording, descent)
            if abs(delay - last) < 0.02 * recording.data.dt:
                break
            if hopeless < math.inf and bool((_strain(fitted[:2], last, free, recording, descent) > hopeless).any()):
                delay = last
                break
            fitted = _fitted(fitted[:2], delay)
        notes = _shortened(fitted.window, descent.window)
        return Refined(*fitted[:2], delay, notes, covariance=shooting_covariance(fitted.flow))

    def _fine(self, delay: float, found: Model, free: Tensor, recording: DelayedRecording, descent: Descent) -> float:
        """Return the delay in fractions of a sample that a few steps of the fit to trajectories find [s].

        Equations without functions tell none.
        """
        if not bool(found[1].any()):
            return delay
        report_progress("fit", note=f"trying delays of the inputs up to {self._longest:g} s")
        few, data = replace(descent, max_rounds=STEPS), recording.data

        def _cost(trial: float) -> float:
            return few_steps(*found, free, recording.measured(trial), few, recording.guessed(trial).x)[0]

        worth, whole = math.log(max(len(data), 2)), found[0].step is not None
        return refine_delay(delay, data.dt, self._longest, worth, _cost, whole)

    def _chosen(
        self, library: Library, coefficients: Tensor, data: Transitions, guess: Transitions
    ) -> tuple[str, bool, tuple[str, ...]]:
        """Return the method for these data, whether samples look noisy, and what is to be said of a choice."""
        unseen = (data.x.isnan() | data.x_next.isnan()).any(0).tolist()
        names = [name for name, gaps in zip(library.signature.state_names, unseen, strict=True) if gaps]
        if names:
            return "trajectory", False, (COMPARED.format(f"not all of {', '.join(names)} was measured"),)
        noisy = self.method != "integral" and looks_noisy(library, coefficients, guess)
        if self.method != "auto":
            return self.method, noisy, ()
        if noisy:
            return "trajectory", True, (COMPARED.format("the errors of single steps look like noise of the sensors"),)
        return "one_step", False, (STEPWISE,)

    def _regressed(
        self, library: Library, coefficients: Tensor, constraints: Constraints, seen: RegressionData
    ) -> Model:
        """Repeat the regression with what is known of the states between samples, and fit numbers inside functions."""
        regression = Regression(method="bic", tolerance=self.tolerance, dependent=seen.dependent)
        for _ in range(self.rounds):
            sums = RunningSums(len(library), library.signature.n_x)
            sums.add(seen.rows(library, generate(library, coefficients)))
            coefficients = regression.solve(sums, constraints.free, constraints.offset, seen.shares(library))
            library, coefficients = fit_shapes(library, coefficients, constraints.free, seen.rows, self.tolerance)
        return library, coefficients


def _strain(found: Model, delay: float, free: Tensor, recording: DelayedRecording, descent: Descent) -> Tensor:
    return trajectory_error_ratio(*found, free, recording.measured(delay), descent, recording.guessed(delay).x)


def _shortened(window: int, wanted: int) -> tuple[str, ...]:
    """Say that windows are shorter than they were wanted, if so."""
    if window == wanted:
        return ()
    return (
        f"the model runs away in simulations of {wanted} samples, so the fit simulates the log in pieces of {window}",
    )
