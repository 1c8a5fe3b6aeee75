"""What a controller that was planned from a log may be expected to do: flights of models that its plan never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.held import Held, held
from dynasindy.evaluation.scenarios import Evaluation, Policy, Scenario, evaluate
from dynasindy.sensing import Sensing
from dynasindy.systems import Diverged, System

WITHIN = 0.01
"""Mean absolute error at the end that a promise allows, in boxes of targets."""


@dataclass(frozen=True)
class Prediction:
    """Flights of a controller on several models of one plant.

    Attributes:
        flights: What each model shows, see `dynasindy.evaluation.held`; None for one that ran away.
        shown: The evaluation on the first model that did not run away, for figures; None if all did.
        own: Whether the model is the one that was planned on, which promises nothing of the plant.
    """

    flights: tuple[Held | None, ...]
    shown: Evaluation | None = None
    own: bool = False

    @property
    def promised(self) -> bool:
        """Whether the controller holds every model, to 1 % of the box, and nothing else of it runs away."""
        sound = (flight is not None and not flight.away and _largest(flight) <= WITHIN for flight in self.flights)
        return not self.own and all(sound)

    def words(self) -> str:
        """Return the prediction in one line."""
        n = len(self.flights)
        flown = [flight for flight in self.flights if flight is not None]
        start = f"PREDICTED on {n} models fitted to data that the plan never saw (no plant was moved)"
        if self.own:
            start = "PREDICTED on the model of the plan itself, which promises nothing of the plant"
        if not flown:
            return f"{start}: NOT promised, all of them run away"
        told = []
        for name in flown[0].share:
            shares = [100 * float(flight.share[name] or float("inf")) for flight in flown]
            told.append(f"{name} to {min(shares):.2g} to {max(shares):.2g} % of its box")
        lost = [f"{n - len(flown)} of {n} models run away"] if len(flown) < n else []
        lost += sorted({f"{name}, which is not tracked, runs away" for flight in flown for name in flight.away})
        verdict = "CONTROLLED" if self.promised else f"NOT promised, {100 * WITHIN:g} % is asked for"
        return f"{start}: {verdict}: {'; '.join([*told, *lost])}"

    def record(self) -> dict[str, Any]:
        """Return what `metrics.json` holds of it."""
        flights = [None if flight is None else asdict(flight) for flight in self.flights]
        return {"models": len(flights), "promised": self.promised, "sentence": self.words(), "flights": flights}


def predict(
    models: Sequence[System], plan: ControlEnv, policy: Policy, scenario: Scenario, sensing: Sensing | None = None
) -> Prediction:
    """Fly a controller on models in the place of the plant.

    Args:
        models: Models that the plan has not seen.
        plan: Environment that was planned in: task, control period and stops are its own.
        policy: Policy to fly.
        scenario: Situation to fly in.
        sensing: Sensors and observer through which the policy sees a plant.
    """
    flights: list[Held | None] = []
    shown: Evaluation | None = None
    for model in models:
        env = plan.with_system(model, torch.float64)
        try:
            result = evaluate(env, policy, scenario, None if sensing is None else sensing.on(env, sensing.rng))
        except Diverged:
            flights.append(None)
            continue
        shown = shown or result
        flights.append(held(result, torch.ones(model.signature.n_x, dtype=torch.bool)))
    return Prediction(tuple(flights), shown)


def _largest(flight: Held) -> float:
    return max(float("inf") if share is None else share for share in flight.share.values())
