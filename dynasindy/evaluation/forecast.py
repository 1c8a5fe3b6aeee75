"""What a controller that was planned from a log may be expected to do: flights of models that its plan never saw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from dynasindy.control.observer import Observer
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Evaluation, Policy, Scenario, evaluate
from dynasindy.evaluation.tracking_criteria import WITHIN, TrackingCriteria, judge_control, judge_tracking
from dynasindy.findings import Finding, note, records, weak, wrong
from dynasindy.sentences import gravest_first
from dynasindy.systems import Diverged, System

PARTS, SURE = 10, 2.0
"""Parts of a log by which the mean square of its pushes is known, and standard errors that it may be larger."""


@dataclass(frozen=True)
class Forecast:
    """Flights of a controller on several models of one plant.

    Attributes:
        flights: What each model shows, see `dynasindy.evaluation.tracking_criteria`; None for one that ran away.
        evaluation: The one on the first model that did not run away, for figures; None if all did.
        in_sample: Whether the model is the one that was planned on, which promises nothing of the plant.
        within: Mean absolute error at the end that is asked for, in target ranges.
        doubts: Why the models, though they agree, are not to be relied on.
        no_equilibrium: Which targets no input holds in the model of the plan; empty if all are held.
        seconds: Length of the flights [s]; None where it is not known.
        static_friction: What a model shows whose dry friction at rest is larger than in motion, of which a log tells
            little: promises leave it out, and a finding says so.
        undisturbed: What the models show without pushes; empty where nothing pushed them.
    """

    flights: tuple[TrackingCriteria | None, ...]
    evaluation: Evaluation | None = None
    in_sample: bool = False
    within: float = WITHIN
    doubts: tuple[Finding, ...] = ()
    no_equilibrium: str = ""
    seconds: float | None = None
    static_friction: tuple[TrackingCriteria | None, ...] = ()
    undisturbed: tuple[TrackingCriteria, ...] = ()

    @classmethod
    def of(
        cls,
        models: Sequence[System],
        plan: ControlEnv,
        policy: Policy,
        scenario: Scenario,
        observer: Observer | None = None,
        within: float = WITHIN,
        pushes: Tensor | None = None,
    ) -> Forecast:
        """Fly a controller on models in the place of the plant.

        A model with an attribute `delay` [s] gets its inputs so much later.

        Args:
            models: Models that the plan has not seen.
            plan: Environment that was planned in: task, control period and stops are its own.
            policy: Policy to fly.
            scenario: Situation to fly in.
            observer: Observer by whose estimates, and sensors, the policy sees a plant.
            within: Mean absolute error at the end that is asked for, in target ranges.
            pushes: What moves the models besides, see `ControlEnv.pushes`; nothing if omitted. All models but the first
                get pushes as large as they may be in the long run.
        """
        undisturbed = list[TrackingCriteria]()

        def _fly(k: int, model: System) -> tuple[Evaluation | None, TrackingCriteria | None]:
            env, phase = plan.with_system(model, torch.float64), f"flights on model {k + 1} of {len(models)}"
            env.delay = float(getattr(model, "delay", 0.0))
            fly = partial(evaluate, env, policy, scenario, observer)
            with suppress(Diverged):
                result = fly(phase)
                if bool(result.lost.any()):
                    return None, None
                flight = judge_tracking(result, model, fly)
                if pushes is None:
                    return result, flight
                # Whether states come to rest, flights without pushes tell.
                undisturbed.append(flight)
                env.pushes = pushes if k == 0 else pushes * _growth(pushes)
                result = fly(f"{phase}, pushed as in the log")
                if not bool(result.lost.any()):
                    pushed = judge_tracking(result, model)
                    return result, replace(flight, share=pushed.share, worst=pushed.worst)
            return None, None

        results, flights = zip(*(_fly(k, model) for k, model in enumerate(models)), strict=True)
        result, length = next(filter(None, results), None), scenario.length(plan)
        return cls(flights, result, within=within, seconds=length, undisturbed=tuple(undisturbed))

    def __repr__(self) -> str:
        kept = f"promised={self.promised}, controlled={self.controlled}, {len(self.flights)} models"
        return f"Forecast({kept}; summary() says what they show)"

    @property
    def controlled(self) -> bool:
        """Whether the controller holds every model as near as is asked for, and nothing speaks against the models."""
        flown = self._flown
        return flown == [*self.flights] and judge_control(flown, self.within)[0] is not False and not self.doubts

    @property
    def promised(self) -> bool:
        """Whether it is controlled on models that the plan never saw."""
        return not self.in_sample and self.controlled

    @property
    def place(self) -> str:
        """Say what was flown, in the words of the prediction: no plant."""
        return (
            "on the model of the plan itself" if self.in_sample else "on a model fitted to data that the plan never saw"
        )

    @property
    def _flown(self) -> list[TrackingCriteria]:
        return [flight for flight in self.flights if flight is not None]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What the simulations show, and what speaks against the models; `wrong` where nothing is promised for it."""
        n, flown, findings = len(self.flights), self._flown, [*self.doubts]
        if flown:
            held, tracked = judge_control(flown, self.within, "forecast.tracked", seconds=self.seconds)
            findings.insert(0, tracked)
            told = tracked.values["outputs"]
            for flight in self.static_friction:
                ends = {name: (flight.share[name], flight.worst[name]) if flight else (None, None) for name in told}
                means = {name: math.inf if mean is None else mean for name, (mean, _) in ends.items()}
                if worse := {name: each for name, each in ends.items() if means[name] > told[name]["most"]}:
                    findings.append(note("forecast.static_friction", outputs=worse))
            stays = len(flown) == n and all(each["swings"] for each in tracked.values["away"].values())
            if held is False and stays and not self.doubts:  # something may help
                errors = tracked.values["outputs"].values()
                least, most = (max((each[key] for each in errors), default=0.0) for key in ("least", "most"))
                if self.no_equilibrium:
                    findings.append(wrong("forecast.no_equilibrium", targets=self.no_equilibrium))
                elif self.undisturbed and judge_control(self.undisturbed, self.within)[0] is not False:
                    findings.append(weak("forecast.pushed"))
                elif not self.in_sample and least <= self.within < most:
                    findings.append(weak("forecast.models_differ"))
                else:
                    findings.append(weak("forecast.longer_plan"))
        if len(flown) < n:
            findings.append(wrong("forecast.runs_away", models=n - len(flown), of=n))
        return tuple(gravest_first(findings))

    def summary(self) -> str:
        """Return the prediction in one line."""
        n = len(self.flights)
        place = f"on {n} models fitted to data that the plan never saw (no plant was moved)"
        if self.in_sample:
            place = f"{self.place}, which promises nothing of the plant"
        lacking = "NOT CONTROLLED" if self.in_sample else "NOT promised"
        return (
            f"PREDICTED {place}: {'CONTROLLED' if self.controlled else lacking}: {'; '.join(map(str, self.findings))}"
        )

    def record(self) -> dict[str, Any]:
        """Return what `metrics.json` holds of it."""
        flights = [None if flight is None else asdict(flight) for flight in self.flights]
        judged: dict[str, Any] = {"promised": self.promised, "controlled": self.controlled, "within": self.within}
        judged |= {"sentence": self.summary()}
        return {"models": len(flights), **judged, "flights": flights, "findings": records(self.findings)}


def _growth(pushes: Tensor) -> Tensor:
    """Return the factor by which pushes `(T, n_x)` of each state may be larger than in a log that had few, `(n_x,)`."""
    means = torch.stack([part.square().mean(0) for part in pushes.tensor_split(PARTS) if len(part)])
    error = (means.std(0) / len(means) ** 0.5 / means.mean(0)).nan_to_num(nan=0.0)
    return (1 + SURE * error).sqrt()
