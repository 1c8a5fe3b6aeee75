"""What a controller that was planned from a log may be expected to do: flights of models that its plan never saw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import torch

from dynasindy.envs import ControlEnv, DelayedEnv
from dynasindy.evaluation.scenarios import Evaluation, Policy, Scenario, evaluate
from dynasindy.evaluation.tracking_criteria import LOST, WITHIN, TrackingCriteria, error_reference, judge_tracking
from dynasindy.planning.equilibria import states_that_matter
from dynasindy.sensing import Sensing
from dynasindy.systems import Diverged, System
from dynasindy.text import format_duration

OVERSHOT = 20.0
"""Overshoot that a prediction tells of [% of the step]."""


@dataclass(frozen=True)
class Forecast:
    """Flights of a controller on several models of one plant.

    Attributes:
        flights: What each model shows, see `dynasindy.evaluation.tracking_criteria`; None for one that ran away.
        shown: The evaluation on the first model that did not run away, for figures; None if all did.
        own: Whether the model is the one that was planned on, which promises nothing of the plant.
        within: Mean absolute error at the end that is asked for, in target ranges.
        errors: Mean absolute error of each model's whole flights, of the worst output, in target ranges; infinite of
            one that ran away.
        doubts: Why the models, though they agree, are not to be relied on, a sentence each.
        unheld: Which targets no input holds in the model of the plan; empty if all are held.
        seconds: Length of the flights [s]; None where it is not known.
        overshoot: Of each output, the median of a model's flights, of the worst model [% of the step].
        resolved: Of each output, the step between two values that its sensor can tell apart, in target ranges, where
            one is known.
        period: What speaks for another control period, and which to try; empty if nothing does.
    """

    flights: tuple[TrackingCriteria | None, ...]
    shown: Evaluation | None = None
    own: bool = False
    within: float = WITHIN
    errors: tuple[float, ...] = ()
    doubts: tuple[str, ...] = ()
    unheld: str = ""
    seconds: float | None = None
    overshoot: Mapping[str, float] = field(default_factory=dict)
    resolved: Mapping[str, float] = field(default_factory=dict)
    period: str = ""

    def __repr__(self) -> str:
        kept = f"promised={self.promised}, controlled={self.controlled}, score={self.score:.3g}"
        return f"Forecast({kept}, {len(self.flights)} models; summary() says what they show)"

    @property
    def controlled(self) -> bool:
        """Whether the controller holds every model as near as is asked for, and nothing speaks against the models."""
        judge_tracking = all(flight is not None and not flight.away for flight in self.flights)
        return not self._missed and judge_tracking and not self.doubts

    @property
    def promised(self) -> bool:
        """Whether it is controlled on models that the plan never saw."""
        return not self.own and self.controlled

    @property
    def score(self) -> float:
        """The error of the worst model, ways to the targets included, by which settings compare."""
        return max(self.errors, default=math.inf)

    @property
    def place(self) -> str:
        """Say what was flown, in the words of the prediction: no plant."""
        return "on the model of the plan itself" if self.own else "on a model fitted to data that the plan never saw"

    @property
    def _missed(self) -> bool:
        """Whether an error is larger than is asked for; the worst reference of a model may be `LOST` times as far."""
        errors = [
            (_number(flight.share[name]), _number(flight.worst[name]))
            for flight in self.flights
            if flight is not None
            for name in flight.share
        ]
        return not all(share <= self.within and worst <= LOST * self.within for share, worst in errors)

    def summary(self) -> str:
        """Return the prediction in one line."""
        n = len(self.flights)
        flown = [flight for flight in self.flights if flight is not None]
        start = f"PREDICTED on {n} models fitted to data that the plan never saw (no plant was moved)"
        if self.own:
            start = f"PREDICTED {self.place}, which promises nothing of the plant"
        lacking = "NOT CONTROLLED" if self.own else "NOT promised"
        if not flown:
            gone = f"{start}: {lacking}, {'it runs' if n == 1 else 'all of them run'} away"
            return "; ".join(filter(None, (gone, self.period)))
        told = []
        for name in flown[0].share:
            shares = [100 * _number(flight.share[name]) for flight in flown]
            worst = max(100 * _number(flight.worst[name]) for flight in flown)
            both = dict.fromkeys(f"{end:.2g}" for end in (min(shares), max(shares)))  # one of them where they are alike
            ends = f"{' to '.join(both)} %"
            over = self.overshoot.get(name, 0.0)
            beyond = f", after it overshot by {over:.2g} % of the step" if over > OVERSHOT else ""
            step = 100 * self.resolved.get(name, 0.0)
            hidden = f" (its sensor resolves {step:.2g} %, and cannot show what is less)" if min(shares) < step else ""
            average = f"{name} {ends} {error_reference(name, flown[0].turned)} on average{hidden}"
            told.append(f"{average}, {worst:.2g} % at worst{beyond}")
        lost = [f"{n - len(flown)} of {n} models run away"] if len(flown) < n else []
        fates = {(name, name not in flight.swings) for flight in flown for name in flight.away}
        lost += sorted(f"{name}, which is not tracked, {_fate(away)}" for name, away in fates)
        lost += sorted({f"{name} runs on, which nothing depends on" for flight in flown for name in flight.idle})
        diverged = len(flown) < n or any(away for _, away in fates)
        if self.period and (diverged or self._missed):
            lost.append(self.period)
        elif not (self.controlled or diverged or self.doubts):
            lost.append(self._advice(flown))
        lost += self.doubts
        asked = f", {100 * self.within:g} % is asked for, and {100 * LOST * self.within:g} % at worst"
        verdict = "CONTROLLED" if self.controlled else f"{lacking}{asked if self._missed else ''}"
        end = "the end" if self.seconds is None else f"the end of flights of {format_duration(self.seconds)}"
        return f"{start}: {verdict}: errors at {end}: {'; '.join([*told, *lost])}"

    def _advice(self, flown: Sequence[TrackingCriteria]) -> str:
        """Say what may help where nothing runs away."""
        if self.unheld:
            return f"{self.unheld}: give a smaller range of targets, or log and use more of the inputs' range"
        shares = [max(_number(share) for share in flight.share.values()) for flight in flown]
        if not self.own and min(shares) <= self.within < max(shares):
            return (
                "some models are held and others are not, by what the log leaves open: log longer, let the inputs "
                "change more often and more widely, or name functions and states that the model lacks"
            )
        return "nothing runs away: a longer plan, of more updates, may hold it, or a smaller range of targets"

    def record(self) -> dict[str, Any]:
        """Return what `metrics.json` holds of it."""
        flights = [None if flight is None else asdict(flight) for flight in self.flights]
        judged = {"promised": self.promised, "controlled": self.controlled, "within": self.within}
        score = self.score if math.isfinite(self.score) else None
        return {
            "models": len(flights),
            **judged,
            "score": score,
            "sentence": self.summary(),
            "flights": flights,
            "doubts": [*self.doubts],
        }


def predict(
    models: Sequence[System],
    plan: ControlEnv,
    policy: Policy,
    scenario: Scenario,
    sensing: Sensing | None = None,
    within: float = WITHIN,
) -> Forecast:
    """Fly a controller on models in the place of the plant.

    A model with an attribute `delay` [s] gets its inputs so much later.

    Args:
        models: Models that the plan has not seen.
        plan: Environment that was planned in: task, control period and stops are its own.
        policy: Policy to fly.
        scenario: Situation to fly in.
        sensing: Sensors and observer through which the policy sees a plant.
        within: Mean absolute error at the end that is asked for, in target ranges.
    """
    flights: list[TrackingCriteria | None] = []
    errors: list[float] = []
    overshoot: dict[str, float] = {}
    shown: Evaluation | None = None
    for k, model in enumerate(models):
        env = DelayedEnv.around(plan.with_system(model, torch.float64), float(getattr(model, "delay", 0.0)))
        result: Evaluation | None = None
        with suppress(Diverged):
            seen = None if sensing is None else sensing.on(env, sensing.rng)
            result = evaluate(env, policy, scenario, seen, f"flights on model {k + 1} of {len(models)}")
        if result is None or bool(result.lost.any()):
            flights.append(None)
            errors.append(math.inf)
            continue
        shown = shown or result
        start = result.trajectory["state"][0, 0]
        flights.append(judge_tracking(result, states_that_matter(model, result.columns, start)))
        errors.append(_whole(result))
        over = result.metrics["overshoot"].nanmedian(0).values.nan_to_num(0.0).tolist() if result.columns else []
        overshoot = {
            name: max(overshoot.get(name, 0.0), share) for name, share in zip(result.output_names, over, strict=True)
        }
    seconds = scenario.length(plan)
    found = Forecast(tuple(flights), shown, within=within, errors=tuple(errors), seconds=seconds, overshoot=overshoot)
    return found if sensing is None or shown is None else replace(found, resolved=_resolved(shown, sensing))


def _resolved(shown: Evaluation, sensing: Sensing) -> dict[str, float]:
    """Return the step of the sensor of each output, in target ranges; none of a sensor of which none is known."""
    steps = sensing.observer.sensors.resolution(shown.signature).tolist()
    boxes = shown.boxes or (1.0,) * len(shown.columns)
    pairs = zip(shown.output_names, shown.columns, boxes, strict=True)
    return {name: steps[i] / box for name, i, box in pairs if steps[i] > 0}


def _whole(result: Evaluation) -> float:
    """Return the mean absolute error over whole flights, of the worst output, in target ranges."""
    errors = result.errors.mean((0, 1))
    return float(errors.amax()) if bool(errors.isfinite().all()) else math.inf


def _fate(away: bool) -> str:
    return "runs away" if away else "does not come to rest"


def _number(share: float | None) -> float:
    return float("inf") if share is None else share
