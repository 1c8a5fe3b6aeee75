"""Refinement of a sparse model: from the trapezoidal rule to what the data can tell."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Annotated, Any, Literal

import pydantic
import torch
from pydantic import Field
from torch import Tensor

from dynasindy.findings import Finding, note, weak
from dynasindy.limits import Count, Positive
from dynasindy.safe_io import checked_class
from dynasindy.sindy.codegen import generate, simulate
from dynasindy.sindy.covariance import of_rates
from dynasindy.sindy.delay import unexplained
from dynasindy.sindy.fit_report import Refined
from dynasindy.sindy.library import Constraints, Library
from dynasindy.sindy.reconstruction import RegressionData, disturbance_states, has_gaps
from dynasindy.sindy.regression import Regression, Rows, TriangularFactor, fit_supported, needed_at_edge
from dynasindy.sindy.sensitivity import slopes_by_state
from dynasindy.sindy.shape_parameters import fit_shapes
from dynasindy.sindy.shooting import Descent, RunsAway, relative_step, shooting_covariance, substeps_for
from dynasindy.sindy.trajectory_fit import refine_trajectory
from dynasindy.systems.integrators import moved
from dynasindy.systems.interpreter import MeasurementUpdate
from dynasindy.systems.transitions import Transitions

PERIODS = 2
"""Control periods within which noisy samples are searched for a delay where no regression tells one. An unstable plant
is excited under feedback, and in such data a longer delay, with other equations, may explain as much as the true
one."""
SOON = 0.05
"""The same [s], of samples that are so close that two control periods are less."""
FARTHER = 2
"""Delays of a first estimate within which a delay is looked for."""
CLOSE = 5e-3
"""Samples to which a delay is found by regressions."""
ALIKE = 0.01
"""Samples by which a delay may differ from a whole number and be taken for it."""
PLAIN = -0.3
"""Correlation of neighbouring errors of single steps below which a state is noisy: -1/2 of noise of the sensors alone,
0 of random pushes alone."""
KEPT = 0.5
"""Part of the errors that the functions of the model have to leave over, as they do not explain noise."""
SOONEST, FARTHEST = 10, 80
"""Samples within which a delay is looked for at first, at least, and at most, where nobody says how long it may be."""
ENOUGH = 2
"""Rows per function from which on a regression may tell a delay: of as many rows as functions nothing is left over."""
EXACT = 1e-3
"""Part of the rates of change, unexplained, below which the inputs act at once: a delay of a sample leaves far more."""
TELLING = 4.0
"""Factor on the squared error, of all states together, below which a regression tells neither a delay nor an
inertia."""
OBSERVED = 500
"""Samples in a window through which an observer follows the plant: so many that it matters little where it begins."""
NOISES, OTHER_NOISE = (0.03, 0.1, 0.3, 1.0, 3.0), 1e-3
"""Changes by chance of disturbances from sample to sample that are tried, and of other states and readings [ranges]."""
ALPHA = 0.7
"""Part of an error of one step that a filter first takes for the state's (Kalata 1984)."""
Model = tuple[Library, Tensor]
"""A library with the numbers inside its fitted factors, and coefficients, `(n_features, n_x)`."""


@checked_class
@pydantic.dataclasses.dataclass(frozen=True, config={"extra": "forbid"})
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
        error: what `trajectory` minimises: of one trajectory through each segment (`simulation`, output error), of
            windows that begin anew (`prediction`), for plants that are pushed at random or unstable, or of one step
            ahead of an observer whose gain is fitted, too (`innovation`), for both. If omitted it is `simulation`, and
            with the method `auto` also `prediction`, where the model runs away in one trajectory.
        select: whether functions come in and go while trajectories are fitted.
        penalty: factor on what a coefficient of trajectories must be worth.
        seconds: time of computing that a fit to a log may take, about, where candidates are tried [s].

    Raises:
        ValueError: a setting is not allowed.
    """

    method: Literal["integral", "one_step", "trajectory", "auto"] = "integral"
    rounds: Count = 2
    tolerance: Annotated[float, Field(gt=0)] = 1e-6
    window: Positive = 20
    longest_delay: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = 0.0
    error: Literal["simulation", "prediction", "innovation"] | None = None
    select: bool = True
    penalty: Annotated[float, Field(gt=0)] = 1.0
    seconds: Annotated[float, Field(gt=0)] = 60.0

    def run(
        self,
        first: Model,
        constraints: Constraints,
        recording: RegressionData,
        late: float | None = None,
        general: bool = False,
    ) -> Refined:
        """Return refined coefficients, the library with its fitted factors, and the delay of the inputs.

        Args:
            first: candidate functions, and a first estimate of their coefficients, `(n_features, n_x)`.
            constraints: what is known of the equations.
            recording: what to refine on.
            late: delay of the inputs of the first estimate [s], at which the fit begins; a regression is to find it
                where this is None.
            general: whether the library is one for any plant, of which fits to exact samples take what they need where
                all states were measured.
        """
        longest, seconds = self.longest_delay, len(recording.measured) * recording.measured.dt
        if longest is not None and longest >= seconds:
            raise ValueError(
                f"longest_delay is {longest:g} s, and the data last {seconds:g} s; give a delay that they can show, or "
                "null, where they are to tell"
            )
        return _Fit(self, constraints, replace(recording, longest=longest or 0.0), general).run(first, late)


@dataclass(frozen=True)
class _Fit:
    """Refine a model by settings on a recording; a delay is looked for as far as that reaches."""

    settings: Refinement
    constraints: Constraints
    recording: RegressionData
    general: bool = False

    def run(self, first: Model, late: float | None = None) -> Refined:
        """Return what was found; the search for a delay begins at `late` [s], by a regression where that is None."""
        if self.settings.longest_delay is None:
            longest, told = self._reach(first)
            late = late if late is not None else told or None
            self = replace(self, recording=replace(self.recording, longest=max(longest, FARTHER * (late or 0.0))))
        data, wanted, fit = self.recording.measured, self.settings.method, self
        dt, longest, delay = data.dt, self.recording.longest, late or 0.0
        if late is None and longest:  # of whole samples, by a regression
            samples = range(math.floor(longest / dt + 1e-9) + 1)
            delay = min((k * dt for k in samples), key=self._delay_cost(first))
        if delay and wanted in ("integral", "one_step"):
            first = self._regressed(first, delay)
            worth, whole = math.log(max(len(self._brief.measured), 2)), first[0].step is not None
            fine = _refined_delay(delay, dt, longest, worth, self._delay_cost(first), whole)
            delay = delay if abs(fine - delay) < ALIKE * dt else fine
        found = self._regressed(first, delay)
        exact = wanted in ("integral", "one_step") or (
            wanted == "auto" and not looks_noisy(*found, self.recording.guess)
        )
        if self.general and exact and not bool(data.x.isnan().any() | data.x_next.isnan().any()):
            # Samples at the edge of what was seen tell which functions are needed.
            seen, given, ranks = self._brief.delayed(delay), self.constraints, [f.complexity for f in found[0].features]
            rows = seen.rows(found[0], generate(*found))
            free = needed_at_edge(rows, seen.guess.x, given.free, given.offset, ranks)
            fit = replace(self, constraints=replace(given, free=free))
            found = fit._regressed(found, delay)
        hidden = not bool(found[1].any()) and wanted in ("auto", "trajectory")
        if hidden and not bool(data.x.isnan().any()):  # noise of single samples may hide every function
            fit, found = self._smoothed(found, delay)
        if not late and not bool(found[1].any()):  # no function is left to follow, step by step or further
            return Refined(*found, delay)
        method, noisy, findings = self._chosen(*found, delay)
        if method == "one_step":
            refined = fit._by_single_steps(found, delay)
        else:
            free, known = fit.constraints.free, None
            if method == "integral" and bool(found[1].any()):
                known = of_rates(found[1], free, *fit._brief.delayed(delay).rows(found[0], generate(*found)))
            refined = Refined(*found, delay, covariance=known)
        if method == "trajectory":
            if noisy and not hidden:
                fit, found = fit._smoothed(found, delay)
            refined = fit._by_trajectories(found, delay)
        findings, longest = findings + refined.findings, self.recording.longest
        if refined.delay and refined.delay > longest - 0.5 * data.dt:
            findings += (weak("fit.longest_delay", seconds=longest),)
        return refined._replace(findings=findings)

    def _reach(self, first: Model) -> tuple[float, float]:
        """Return how long a delay of the inputs may be, and how long it seems to be, as a regression tells [s]."""
        read, data, method = self.recording, self.recording.measured, self.settings.method
        noisy = method == "trajectory" or bool(data.x.isnan().any())
        noisy = noisy or (method == "auto" and looks_noisy(*first, read.guess))
        least = max(PERIODS * data.substeps, math.floor(SOON / data.dt + 1e-9)) if noisy else 0
        farthest, best = self._search_range(first, read, least)
        if noisy and not best and not has_gaps(data):
            # Most of single steps may be noise, which no delay explains: averages tell it.
            farthest, best = self._search_range(first, read.smoothed(first[0].step), least)
        return farthest * data.dt, best * data.dt

    def _search_range(self, first: Model, read: RegressionData, least: int) -> tuple[int, int]:
        """Return within how many samples to look for a delay, where nobody says that, and the best one, or 0."""
        # Where the longest one that was tried is the best, it is twice as far, while enough rows are left.
        free, field, dt = self.constraints.free, generate(*first), read.measured.dt

        def _rows(late: int, farthest: int) -> Rows:
            recording = replace(read, longest=farthest * dt).brief()
            return recording.delayed(late * dt).rows(first[0], field)

        enough = ENOUGH * int(free.sum(0).max())
        if (not least and _exact(free, *_rows(0, 0))) or len(_rows(0, least)[1]) < enough:
            return 0, 0
        farthest, found = max(SOONEST, least), (least, 0)
        while farthest <= FARTHEST and len(_rows(0, farthest)[1]) >= enough:
            costs = [unexplained(free, *_rows(k, farthest)) for k in range(farthest + 1)]
            best = min(range(farthest + 1), key=costs.__getitem__)
            if costs[0] - costs[best] > 0.5 * len(_rows(best, farthest)[1]) * math.log(TELLING):
                found = farthest, best
            if best < farthest:
                break
            farthest *= 2
        return found

    @cached_property
    def _brief(self) -> RegressionData:
        """Return enough of the recording for a regression."""
        return self.recording.brief()

    def _smoothed(self, found: Model, delay: float) -> tuple[_Fit, Model]:
        """Return the fit to a recording as one whose samples are noisy, and what regressions find in it."""
        fit = replace(self, recording=self.recording.smoothed(found[0].step))
        return fit, fit._regressed(found, delay)

    def _delay_cost(self, found: Model) -> Callable[[float], float]:
        """Return what a regression under inputs that act so much later [s] leaves over, see `unexplained`."""
        brief, field = self._brief, generate(*found)
        return lambda late: unexplained(self.constraints.free, *brief.delayed(late).rows(found[0], field))

    def _descent(self, window: int, **more: Any) -> Descent:
        return Descent(window, select=self.settings.select, penalty=self.settings.penalty, **more)

    def _by_single_steps(self, first: Model, delay: float) -> Refined:
        """Return the model of least one-step error, that of trajectories of one interval without noise."""
        data = self.recording.delayed(delay).guess
        change = data.x_next - data.x
        floor = self.settings.tolerance * change.square().mean(0).sqrt()
        descent = self._descent(1, joined=False, floor=floor)
        flow = refine_trajectory(*first, self.constraints.free, data, descent)
        parts = (data.x_next - flow.predicted[:, 0]).norm(dim=0) / change.norm(dim=0).clamp_min(1e-300)
        missed = dict(zip(first[0].signature.state_names, parts.tolist(), strict=True))
        model = flow.estimate.library, flow.estimate.xi
        return Refined(*model, delay, covariance=shooting_covariance(flow), missed=missed)

    def _by_trajectories(self, first: Model, rough: float) -> Refined:
        """Return the model that trajectories tell, and the delay."""
        try:
            return self._fit_with_delay(first, rough, self.settings.error or "simulation")
        except RunsAway:
            if self.settings.error is not None or self.settings.method != "auto":
                raise
        found = self._fit_with_delay(first, rough, "prediction")
        return found._replace(findings=(weak("fit.multiple_shooting", samples=self._window), *found.findings))

    @property
    def _window(self) -> int:
        return min(self.settings.window, int(self.recording.known.sum()))

    def _fit_with_delay(self, found: Model, delay: float, error: str) -> Refined:
        """Return the model of least error of trajectories, or of an observer, and the delay, fitted with it."""
        recording, gain = self.recording, None
        fits = bool(recording.longest) and found[0].step is None
        if recording.longest:
            found = self._regressed(found, delay)
        data, window = recording.delayed(0.0 if fits else delay).measured, self._window
        if error == "innovation":
            gain, window = _first_gain(found, recording.delayed(delay)), min(max(window, OBSERVED), len(data))
        descent = self._descent(window, joined=error == "simulation", before=recording.before() if fits else None)
        start = recording.delayed(delay).guess.x
        flow = refine_trajectory(*found, self.constraints.free, data, descent, start, delay if fits else 0.0, gain)
        findings: tuple[Finding, ...] = ()
        if flow.windows.length != window:
            findings = (weak("fit.shorter_shooting", long=window, short=flow.windows.length),)
        model, delay = (flow.estimate.library, flow.estimate.xi), flow.estimate.delay if fits else delay
        return Refined(*model, delay, findings, covariance=shooting_covariance(flow))

    def _chosen(self, library: Library, coefficients: Tensor, delay: float) -> tuple[str, bool, tuple[Finding, ...]]:
        """Return the method for these data, whether samples look noisy, and the finding of a choice."""
        method, data = self.settings.method, self.recording.measured
        unseen = (data.x.isnan() | data.x_next.isnan()).any(0).tolist()
        names = [name for name, gaps in zip(library.signature.state_names, unseen, strict=True) if gaps]
        if names:
            return "trajectory", False, (note("fit.trajectories", unmeasured=names),)
        noisy = method != "integral" and looks_noisy(library, coefficients, self.recording.delayed(delay).guess)
        if method != "auto":
            return method, noisy, ()
        if noisy:
            return "trajectory", True, (note("fit.trajectories", unmeasured=[]),)
        return "one_step", False, (note("fit.single_steps"),)

    def _regressed(self, found: Model, delay: float) -> Model:
        """Repeat the regression with what is known of the states between samples, and fit numbers inside functions."""
        (library, coefficients), seen, settings = found, self._brief.delayed(delay), self.settings
        free, offset = self.constraints.free, self.constraints.offset
        regression = Regression(method="bic", tolerance=settings.tolerance, dependent=seen.dependent)
        for _ in range(settings.rounds):
            factor = TriangularFactor(seen.rows(library, generate(library, coefficients)))
            coefficients = regression.solve(factor, free, offset)
            library, coefficients = fit_shapes(library, coefficients, free, seen.rows, settings.tolerance)
        return library, coefficients


def _refined_delay(
    rough: float, dt: float, longest: float, worth: float, cost: Callable[[float], float], whole: bool = False
) -> float:
    """Return the delay of least cost [s], in fractions of a sample or `whole` ones; 0 if that is worse by < `worth`."""
    known = cache(cost)

    def _at(delay: float) -> float:
        return known(delay) if 0 <= delay <= longest * (1 + 1e-9) else math.inf

    best = rough
    while (better := min((best - dt, best, best + dt), key=_at)) != best:
        best = better
    if not whole:
        from scipy.optimize import minimize_scalar  # a third of a second of imports

        ends = max(0.0, best - dt), min(longest, best + dt)
        within = minimize_scalar(_at, bounds=ends, method="bounded", options={"xatol": CLOSE * dt})
        best = min(best, float(within.x), key=_at)
    return 0.0 if best and _at(0.0) - _at(best) < worth else best


def _exact(free: Tensor, theta: Tensor, dx: Tensor) -> bool:
    """Tell whether the functions explain the rates of change but for errors of the regression itself."""
    left = (dx - theta @ fit_supported(theta, dx, free)).norm(dim=0)
    return not bool((left > EXACT * dx.norm(dim=0))[free.any(0)].any())


def looks_noisy(library: Library, coefficients: Tensor, data: Transitions) -> bool:
    """Tell measurement noise from errors of the model by the one-step errors, of most states.

    White noise n of the states makes errors n_k+1 - n_k, whose neighbours correlate by -1/2; errors of a model last
    over many samples. Where the time between samples is long, these change from sample to sample, too, but are
    functions of the present states and inputs, as noise is not.
    """
    data = data.to(torch.float64)
    error = data.x_next - moved(generate(library, coefficients), data.x, data.u, data.dt, 1, data.u_end)
    # A constant, too, as a library need not have one.
    functions = torch.nn.functional.pad(library(data.x, data.u), (0, 1), value=1.0)
    functions = functions / functions.norm(dim=0).clamp_min(1e-300)
    left = error - functions @ torch.linalg.lstsq(functions, error, driver="gelsd").solution
    kept = left.norm(dim=0) > KEPT * error.norm(dim=0)
    follows = data.segment[1:] == data.segment[:-1]
    before, after = error[:-1][follows], error[1:][follows]
    correlation = (before * after).sum(0) / (before.norm(dim=0) * after.norm(dim=0)).clamp_min(1e-300)
    return bool(2 * ((correlation < PLAIN) & kept).sum() > len(kept))


def _first_gain(model: Model, recording: RegressionData) -> tuple[Tensor, Tensor]:
    """Return a first gain of an observer, of measured states on themselves and their rates, and where it is fitted.

    Where there are disturbances, which nothing moves but noise, it is that of a stationary Kalman filter.
    """
    (library, xi), data, rates = model, recording.measured, recording.rates
    seen, alone = ~data.x_next.isnan().all(0), disturbance_states(library, xi)
    mask, gain, pushed = torch.diag(seen), torch.diag(ALPHA * seen.double()), torch.zeros_like(seen)
    for i in (~seen).nonzero().flatten().tolist():
        of = rates.get(i)
        if of is None or not bool(seen[of]):
            mask[i], pushed[i] = seen, i in alone
        else:
            mask[i, of], gain[i, of] = True, ALPHA**2 / (2 - ALPHA) / data.dt
    if not bool(pushed.any()):
        return gain, mask
    guess, starts = recording.guess, recording.guess.segment_starts()
    rows = starts == starts.mode().values  # the longest stretch
    guess, measured = guess.select(rows), data.x_next[rows]
    u, u_end = guess.inputs_of(torch.arange(len(guess)).unsqueeze(0))
    substeps = substeps_for(relative_step(library, xi, guess.x, guess.u, data.dt))

    def _innovations(gain: Tensor) -> float:
        update = MeasurementUpdate(measured.unsqueeze(0), gain)
        ends = simulate(library, xi, guess.x[:1], u, data.dt, substeps, u_end, update)[0]
        return float((ends - measured)[:, seen].square().nanmean(0).log().sum().nan_to_num(math.inf))

    gains = [gain]
    with suppress(ValueError):  # there is none
        gains += [torch.where(mask, _kalman_gain(library, xi, guess, seen, pushed, noise), 0.0) for noise in NOISES]
    return min(gains, key=_innovations), mask


def _kalman_gain(library: Library, xi: Tensor, data: Transitions, seen: Tensor, pushed: Tensor, noise: float) -> Tensor:
    """Return the gain of a stationary Kalman filter of a model, linearised at the median of data, `(n_x, n_x)`."""
    from scipy.linalg import solve_discrete_are

    x, u = (each.median(0, keepdim=True).values for each in (data.x, data.u))
    scale = xi.new_tensor(library.signature.x_scale)
    moves = torch.matrix_exp(data.dt * slopes_by_state(library, xi, x, u)[0])
    pushes = torch.diag((scale * torch.where(pushed, noise, OTHER_NOISE)).square())
    reads, error = torch.eye(len(scale), dtype=xi.dtype)[seen], torch.diag((OTHER_NOISE * scale[seen]).square())
    p = torch.from_numpy(solve_discrete_are(*(each.numpy() for each in (moves.mT, reads.mT, pushes, error))))
    gain = torch.zeros(len(scale), len(scale), dtype=xi.dtype)
    gain[:, seen] = torch.linalg.solve(reads @ p @ reads.mT + error, reads @ p).mT
    return gain
