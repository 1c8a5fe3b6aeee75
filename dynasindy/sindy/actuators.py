"""What an actuator makes of commands: what is held from sample to sample acts later, slower, or not all the way.

| kind       | what it does with a command u, its output a                  | size                          |
| ---------- | ------------------------------------------------------------ | ----------------------------- |
| rate limit | a follows u, by no more than its size a second               | [unit of the input per second] |
| play       | a stands still until u is its size ahead, on either side     | [unit of the input]           |
| dead zone  | a is what u has beyond its size, on either side              | [unit of the input]           |
| lag        | a' = (u - a) / size                                          | [s]                           |

Where an input acts at once but not in proportion, a dead zone with two ends of its own or a saturation is read off the
equations instead, off functions that bend in it: `InputNonlinearity`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Literal

import torch
from torch import Tensor

from dynasindy.progress import report_progress
from dynasindy.sindy.codegen import generate
from dynasindy.sindy.delay import delay_inputs, unexplained
from dynasindy.sindy.library import CONSTANT, Feature, Library, of, variable
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.noise import looks_noisy
from dynasindy.sindy.reconstruction import (
    DelayedRecording,
    RegressionData,
    has_gaps,
    rate_states,
    reconstruct,
    settle_lag_states,
    simulate_hidden_states,
)
from dynasindy.sindy.refinement import STEPS
from dynasindy.sindy.regression import least_squares
from dynasindy.sindy.shooting import Descent, Estimate, RunsAway, choose_stretches
from dynasindy.sindy.trajectory_fit import few_steps
from dynasindy.systems.transitions import Transitions

Kind = Literal["rate limit", "play", "dead zone", "lag"]
MET = 1e-3
"""Part of the range of its commands by which two outputs may differ that are one."""


@dataclass(frozen=True)
class Actuator:
    """Say what stands between a command and its effect.

    Attributes:
        place: which input.
        kind: what holds its effect back.
        size: by how much, above 0, see above.
    """

    place: int
    kind: Kind
    size: float

    def acts(self, data: Transitions) -> tuple[Transitions, Tensor]:
        """Return a recording whose input is what acts, its mean over each interval, and where that is known.

        Where the actuator was when a segment began is not known. It is followed from both ends of the range of its
        commands, and is known once both ways have met, bool `(N,)`.

        Args:
            data: the recording, under zero-order hold.
        """
        commands, begins = data.u[:, self.place].tolist(), data.begins().tolist()
        ways = [self._from(start, commands, begins, data.dt) for start in (min(commands), max(commands))]
        low, high = torch.tensor(ways, dtype=data.u.dtype)
        inputs = data.u.clone()
        inputs[:, self.place] = (low + high) / 2
        return replace(data, u=inputs), (high - low).abs() <= MET * (max(commands) - min(commands))

    def _from(self, start: float, commands: Sequence[float], begins: Sequence[bool], dt: float) -> list[float]:
        """Return the mean output over each interval, if it is `start` where a segment begins."""
        acting, after = [], start
        for u, anew in zip(commands, begins, strict=True):
            mean, after = self._over(u, start if anew else after, dt)
            acting.append(mean)
        return acting

    def _over(self, u: float, a: float, dt: float) -> tuple[float, float]:
        """Return the mean of the output over an interval in which u is held, and its end."""
        gap = u - a
        if self.kind == "rate limit":
            busy = min(abs(gap) / self.size, dt)
            end = a + math.copysign(busy * self.size, gap)
            return ((a + end) / 2 * busy + end * (dt - busy)) / dt, end
        if self.kind == "lag":
            left = math.exp(-dt / self.size)
            return u - gap * (1 - left) * self.size / dt, u - gap * left
        if self.kind == "play":
            end = min(max(a, u - self.size), u + self.size)
        else:
            end = u - min(max(u, -self.size), self.size)
        return end, end


WANTED: tuple[Kind, ...] = ("rate limit", "play")
RIVALS: tuple[Kind, ...] = ("dead zone", "lag")
FRACTIONS = (0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4)
"""Sizes that the regression tries, in ranges of the input, a rate limit per interval; a lag in 20 intervals."""
CLOSER = (0.8, 1.0, 1.25)
"""Factors on a size that trajectories compare."""
FITTED = 2 / 3
"""Part of a recording on which sizes and coefficients are fitted; the rest judges."""
MOST, ALONE, FEWEST = 1000, 10, 8
"""Rows that are looked at, at most; samples in a window; windows that must be left to judge."""
LARGEST = 100
"""Functions in a model, beyond which the many fits would take too long."""
MARGIN, DEVIATIONS = 0.1, 2.0
"""Part of the error by which an actuator must lower it, and standard errors that its gain must be above zero."""
FULL = 20.0
"""Ranges of a state within which dry friction is not yet full: one by so many."""
FAST = 2.5
"""How much of its way to the command an actuator makes in a sampling interval, were it not held back [1/interval]."""
FEW = Descent(ALONE, joined=False, max_rounds=STEPS)
"""How trajectories are fitted: in windows on their own, by a few steps."""


@dataclass(frozen=True)
class ActuatorFit:
    """Hold what was found out about the actuators of a recording.

    Attributes:
        actuator: the one that data ask for, if any.
        coefficients: Xi of the same equations behind it, `(n_features, n_x)`.
        gain: part of the error of windows that no fit has seen by which it is lower.
        words: what is to be said.
        library: the functions that the coefficients belong to, with the numbers inside them as fitted.
        sought: whether actuators were looked for.
    """

    actuator: Actuator | None
    coefficients: Tensor
    gain: float
    words: str
    library: Library
    sought: bool = True

    @classmethod
    def none(cls, model: SindyModel, why_not: str = "") -> ActuatorFit:
        """Say that none was found, or why none was looked for."""
        words = "no rate limit and no play of an input was found"
        if why_not:
            words = f"rate limits and play of inputs were not looked for: {why_not}"
        return cls(None, model.coefficients, 0.0, words, model.library, not why_not)


def find_actuator(model: SindyModel, data: Transitions) -> ActuatorFit:
    """Say whether an input has a rate limit or play; at most one is found.

    Args:
        model: what was fitted to the recording.
        data: the recording, NaN where a state was not measured.
    """
    if model.step is not None:
        return ActuatorFit.none(model, "they are those of differential equations")
    if (n := int((model.coefficients != 0).any(1).sum())) > LARGEST:
        return ActuatorFit.none(model, f"the model has {n} functions, and the limit is {LARGEST}")
    bench = _Bench.of(model, data)
    if bench is None:
        return ActuatorFit.none(model, "the recording is too short")
    names, plain = model.signature.input_names, bench.judged(None)
    if plain is None:  # there is nothing to be better than
        return ActuatorFit.none(model, f"the equations alone run away in windows of {ALONE} samples")
    best: tuple[Tensor, Actuator, Estimate] | None = None
    for place, name in enumerate(names):
        for kind in WANTED:
            report_progress("actuators", note=f"{kind} of {name}")
            actuator = bench.size(place, kind)
            judged = None if actuator is None else bench.judged(actuator)
            if actuator and judged and (best is None or float(judged[0].sum()) < float(best[0].sum())):
                best = judged[0], actuator, judged[1]
    if best is None:
        return ActuatorFit.none(model)
    gain = math.inf
    for rival in chain([plain[0]], bench.rivals(best[1].place)):
        gain = min(gain, _gain(rival, best[0]))
        if gain < MARGIN:
            return ActuatorFit.none(model)
    said = f"{best[1].kind} of {best[1].size:.3g}" + (" per second" if best[1].kind == "rate limit" else "")
    words = f"{names[best[1].place]} has a {said}: samples that were not fitted are met {100 * gain:.0f} % more closely"
    return ActuatorFit(best[1], best[2].xi, gain, words, best[2].library)


def add_actuator(model: SindyModel, found: ActuatorFit, dt: float) -> SindyModel:
    """Return a model whose actuator is one state more, which no sensor sees and which its equations read.

    With `slack(u, a; p)`, which is what u - a has beyond p on either side, play is `a' = k slack(u, a; p)`, and a rate
    limit is `a' = k (u - a - slack(u, a; p))`, at most k p; k is fast against a sampling interval. Both are functions
    that models are made of anyway, so such a model is saved, printed and exported as any other.

    Args:
        model: the equations.
        found: the actuator, and the functions and coefficients behind it.
        dt: sampling interval [s].

    Raises:
        ValueError: no actuator was found.
    """
    if found.actuator is None:
        raise ValueError("behind got no actuator; allowed is what find_actuator found: keep the model as it is")
    given, fast = model.signature, FAST / dt
    name = given.input_names[found.actuator.place]
    follower = f"applied_{name}"
    signature = given.with_state(follower, "1")
    play = found.actuator.kind == "play"
    held = of("slack", name, follower, frequency=found.actuator.size / (1 if play else fast))
    own = {held: fast} if play else {variable(name): fast, variable(follower): -fast, held: -fast}
    read = [feature.reading(name, follower) for feature in found.library.features]
    library = Library(signature, [*read, *own])
    xi = torch.zeros(len(library), signature.n_x, dtype=torch.float64)
    places = {feature.key: k for k, feature in enumerate(library.features)}
    xi[[places[feature.key] for feature in read], :-1] = found.coefficients
    for feature, value in own.items():
        xi[places[feature.key], -1] = value
    wider = SindyModel(signature, library, model.regression, model.refinement, machine_code=model.machine_code)
    wider.set_coefficients(xi)
    wider.delay = model.delay
    return wider


@dataclass(frozen=True)
class _Bench:
    """Fit equations behind an actuator to the first part of a recording, and judge them by the rest."""

    model: SindyModel
    library: Library
    support: Tensor
    whole: Transitions
    rows: Tensor
    data: Transitions
    guess: Transitions
    noisy: bool
    fitted: Tensor

    @classmethod
    def of(cls, model: SindyModel, data: Transitions) -> _Bench | None:
        """Guess what was not measured; None where too little is left to judge."""
        whole, rows = delay_inputs(data.to(torch.float64), model.delay), choose_stretches(len(data), MOST)
        data = whole.select(rows)
        rates = rate_states(model.library, model.constraints)
        guess = simulate_hidden_states(model.library, model.coefficients, data, reconstruct(data, rates), rates)
        noisy = not bool(has_gaps(data)) and looks_noisy(model.library, model.coefficients, guess)
        guess = reconstruct(data, rates, True) if noisy else guess
        first = torch.arange(len(data)) < FITTED * len(data)
        enough = len(data) * (1 - FITTED) >= FEWEST * ALONE
        support = (model.coefficients != 0) & model.constraints.free
        return cls(model, model.library, support, whole, rows, data, guess, noisy, first) if enough else None

    def size(self, place: int, kind: Kind) -> Actuator | None:
        """Return the actuator of a kind that explains the first part best, None where the equations alone do."""
        rough, costs = self.rough(place, kind), dict[float, float]()
        if rough is None:
            return None

        def _at(size: float) -> float:
            if size not in costs:
                try:
                    costs[size] = self._fit(replace(rough, size=size))[0]
                except RunsAway:
                    costs[size] = math.inf
            return costs[size]

        best, step = rough.size, CLOSER[-1]
        while step > 1.01:
            better = min((best / step, best, best * step), key=_at)
            if better == best:
                step = math.sqrt(step)
            best = better
        return replace(rough, size=best) if math.isfinite(_at(best)) else None

    def rough(self, place: int, kind: Kind) -> Actuator | None:
        """Return the actuator whose rates of change the regression explains best; None where it is not worth it."""
        u = self.data.u[:, place]
        whole = float(u.max() - u.min())
        unit = {"rate limit": whole / self.data.dt, "lag": 20 * self.data.dt}.get(kind, whole)
        if not whole:
            return None
        trials = [Actuator(place, kind, part * unit) for part in FRACTIONS]
        costs = [self._explained(trial) for trial in trials]
        worth = math.log(len(self.data)) / int(self.fitted.sum())
        return trials[costs.index(min(costs))] if min(costs) < self._explained(None) - worth else None

    def judged(self, actuator: Actuator | None) -> tuple[Tensor, Estimate] | None:
        """Return squared errors of windows that no fit has seen, `(W, n_x)`, and the fit.

        None where too little is known of what acts, or where the model runs away in windows as long as they are for
        all, so that errors could not be compared.
        """
        rest, known = self._acts(self.data, actuator)
        if not bool(known[~self.fitted].all()):
            return None
        try:
            estimate = self._fit(actuator)[1]
            free, start = torch.zeros_like(self.support), self.guess.x[~self.fitted]
            last = rest.select(~self.fitted)
            errors = few_steps(_frozen(estimate.library), estimate.xi, free, last, FEW, start)[2]
        except RunsAway:
            return None
        return None if errors is None else (errors, estimate)

    def rivals(self, place: int) -> Iterator[Tensor]:
        """Yield the errors of the equations with what looks like an actuator."""
        for kind in RIVALS:
            actuator = self.rough(place, kind)
            if actuator and (found := self.judged(actuator)):
                yield found[0]
        signature = self.library.signature
        ranges = zip(signature.state_names, signature.x_scale, strict=True)
        wider = Library(signature, [*self.library.features, *(of("tanh", n, frequency=FULL / s) for n, s in ranges)])
        more = torch.zeros(len(wider), signature.n_x, dtype=torch.bool)
        more[: len(self.library)] = self.support
        more[len(self.library) :] = self.support.any(0)
        if found := replace(self, library=wider, support=more).judged(None):
            yield found[0]

    def _fit(self, actuator: Actuator | None) -> tuple[float, Estimate]:
        """Return the logarithm of the errors that a few steps on the first part leave over, and the estimate.

        Raises:
            RunsAway: too little is known of what acts, or the model runs away.
        """
        xi = torch.zeros(self.support.shape, dtype=torch.float64)
        xi[: len(self.model.library)] = self.model.coefficients
        xi = torch.where(self.support & (xi == 0), 1e-9, xi)  # what is zero is no part of a model
        data, known = self._acts(self.data, actuator)
        rows = known & self.fitted
        if 2 * int(rows.sum()) < int(self.fitted.sum()):
            raise RunsAway("too little is known of what acts")
        cost, estimate, errors = few_steps(self.library, xi, self.support, data.select(rows), FEW, self.guess.x[rows])
        if errors is None:
            raise RunsAway(f"the model runs away in windows of {ALONE} samples")
        return cost / int(rows.sum()), estimate

    def _explained(self, actuator: Actuator | None) -> float:
        """Return the logarithm of what the regression of the first part leaves over; infinite if little is known."""
        model, support = self.model, self.support
        (guess, known), (data, _) = (self._acts(part, actuator) for part in (self.guess, self.data))
        rows = known & self.fitted
        if 2 * int(rows.sum()) < int(self.fitted.sum()):
            return math.inf
        rates = rate_states(model.library, model.constraints)
        seen = RegressionData.of(guess.select(rows), data.select(rows), rates, self.noisy)
        theta, dx = seen.rows(model.library, generate(model.library, model.coefficients))
        fixed = torch.where(model.constraints.free, 0.0, model.coefficients)
        n, states = len(dx), int(support.any(0).sum())
        return unexplained(support, theta, dx - theta @ fixed) / n - 0.5 * states * math.log(n)

    def _acts(self, data: Transitions, actuator: Actuator | None) -> tuple[Transitions, Tensor]:
        """Return the rows that are looked at under what acts, and where that is known; all rows tell what acts."""
        if actuator is None:
            return data, torch.ones(len(data), dtype=torch.bool)
        acts, known = actuator.acts(self.whole)
        return replace(data, u=acts.u[self.rows]), known[self.rows]


def _gain(rival: Tensor, ours: Tensor) -> float:
    """Return by which part of the rival's error ours is lower; 0 where that may be chance. Errors squared, `(W, n_x)`.

    Every state counts alike, by what the rival makes of it.
    """
    seen = rival.sum(0) > 0
    unit = rival[:, seen].mean(0)
    before, after = ((errors[:, seen] / unit).mean(1) for errors in (rival, ours))
    better = before - after
    if not bool(better.mean() > DEVIATIONS * better.std() / math.sqrt(len(better))):
        return 0.0
    return float(1 - (after.mean() / before.mean()).sqrt())


def _frozen(library: Library) -> Library:
    """Return a library whose numbers inside functions stay as they are."""
    features = [Feature(tuple(replace(f, fitted=0.0) for f in feature.factors)) for feature in library.features]
    return Library(library.signature, features)


FLAT = 0.1
"""Slope in a part of the range of an input below which it does nothing there [largest slope]."""
ROUGHLY = 0.25
"""The same where slopes are a first guess."""
HALF = 0.5
"""Part of the squared errors that bends may leave over."""
PLACES = tuple(0.05 * k for k in range(2, 19))
"""Parts of the samples of an input below the bends that are tried."""
NARROW = 0.1
"""Part of the range of an input, at least, that a bend leaves between its ends: a jump is neither of the two."""
LEVELS = 10
"""Values of an input from which on its bends can be told."""


@dataclass(frozen=True)
class InputNonlinearity:
    """Hold where an input does nothing.

    Attributes:
        input: the input.
        kind: what it is.
        low: lower end of a dead zone, and of what lies between two ends of a saturation [of the model's input].
        high: upper end, likewise; a saturation may lack either, which is infinite then.
    """

    input: str
    kind: Literal["dead zone", "saturation"]
    low: float
    high: float


def _classify_nonlinearity(
    name: str, edges: Sequence[float], slopes: Sequence[float], flat: float = FLAT
) -> InputNonlinearity | None:
    """Return what a piecewise linear function of an input is, None where it is neither.

    It bends at `edges`, which rise; `slopes` are below the first, between them, and above the last one. A slope is none
    that is below `flat` times the largest one.
    """
    still = [abs(slope) <= flat * max(map(abs, slopes)) for slope in slopes]
    if not edges or all(still):
        return None
    if still[0] or still[-1]:
        ends = (edges[0] if still[0] else -math.inf), (edges[-1] if still[-1] else math.inf)
        return InputNonlinearity(name, "saturation", *ends)
    if True in still:
        k = still.index(True)
        return InputNonlinearity(name, "dead zone", edges[k - 1], edges[k])
    return None


def read_nonlinearity(model: SindyModel, state: int, name: str) -> InputNonlinearity | None:
    """Return the dead zone or the saturation of an input in an equation, None where it has neither.

    Args:
        model: a fitted model.
        state: whose equation it is.
        name: the input, or the state that stands for it.
    """
    edges: dict[float, float] = {}
    slope = 0.0
    for k in model.coefficients[:, state].nonzero().flatten().tolist():
        feature, size = model.library.features[k], float(model.coefficients[k, state])
        if name not in feature.variables:
            continue
        (first, *others) = feature.factors
        if others or first.power != 1 or first.variables != (name,) or first.function not in ("id", "hinge"):
            return None
        if first.function == "id":
            slope += size
        else:
            edges[first.frequency] = edges.get(first.frequency, 0.0) + size
    slopes, rising = [slope], sorted(edges)
    for edge in rising:
        slopes.append(slopes[-1] + edges[edge])
    return _classify_nonlinearity(name, rising, slopes) if any(slopes) else None


def find_missing_nonlinearity(model: SindyModel, data: Transitions) -> InputNonlinearity | None:
    """Return the dead zone or the saturation that what the equations leave over looks like most, None if neither.

    Two bends of each input are tried beside the functions of each equation that reads it, by regressions of the rates
    of change.

    Args:
        model: a fitted model.
        data: the log that it was fitted to, NaN where a state was not measured.
    """
    data = data.to(torch.float64)
    rates = rate_states(model.library, model.constraints)
    guess = settle_lag_states(reconstruct(data, rates), model.followers)
    seen = DelayedRecording.of(data, guess, rates, model.delay).brief(model.delay).seen(model.delay)
    found: InputNonlinearity | None = None
    least = HALF
    for place, name in enumerate(model.signature.input_names):
        u = seen.guess.u[:, place]
        edges = sorted({*torch.quantile(u, torch.tensor(PLACES, dtype=u.dtype)).tolist()})
        if len(u.unique()) < LEVELS or len(edges) < 2 or name in model.followed.values():
            continue
        for part, ends, slopes in _bent(model, seen, name, edges):
            bend = _classify_nonlinearity(name, ends, slopes, ROUGHLY)
            if part < least and bend is not None and ends[-1] - ends[0] >= NARROW * float(u.max() - u.min()):
                found, least = bend, part
    return found


def _bent(
    model: SindyModel, seen: RegressionData, name: str, edges: Sequence[float]
) -> Iterator[tuple[float, Sequence[float], list[float]]]:
    """Yield, of each equation that reads an input, what its two best bends leave over, where they are, and slopes."""
    straight, bent = [CONSTANT, variable(name)], [of("hinge", name, frequency=edge) for edge in edges]
    library = Library(model.signature, [*straight, *bent, *model.library.features])
    places = {feature.key: k for k, feature in enumerate(library.features)}
    theta, dx = seen.rows(library, generate(model.library, model.coefficients))
    for column, target in zip(model.coefficients.unbind(-1), dx.unbind(-1), strict=True):
        own = [model.library.features[k].key for k in column.nonzero().flatten().tolist()]
        if variable(name).key not in own:
            continue
        base = theta[:, [places[key] for key in dict.fromkeys([variable(name).key, CONSTANT.key, *own])]]
        tried = []
        for pair in combinations(zip(edges, bent, strict=True), 2):
            more = theta[:, [places[feature.key] for _, feature in pair]]
            tried.append((*_left(torch.cat([base, more], -1), target), [edge for edge, _ in pair]))
        after, xi, ends = min(tried, key=lambda trial: (math.isnan(trial[0]), trial[0]))
        before = _left(base, target)[0]
        if before > 0:
            yield after / before, ends, torch.stack([xi[0], xi[-2], xi[-1]]).cumsum(0).tolist()


def _left(columns: Tensor, target: Tensor) -> tuple[float, Tensor]:
    """Return the squares that least squares leave over, and the coefficients."""
    scale = columns.norm(dim=0).clamp_min(1e-300)
    xi = least_squares(columns / scale, target) / scale
    return float((target - columns @ xi).square().sum()), xi
