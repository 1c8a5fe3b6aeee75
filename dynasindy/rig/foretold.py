"""What a model foretells of the next flight of its rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from dynasindy import workbench
from dynasindy.control import Controller
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.rig.shown import LAST
from dynasindy.sindy import SindyModel
from dynasindy.systems import Diverged
from dynasindy.tasks import Step


def foretold(controller: Controller, model: SindyModel, targets: Sequence[Sequence[float]], seconds: float) -> str:
    """Say how near a model comes to each target; where the model cannot be flown, say why, as the flight goes on.

    Args:
        controller: What will fly the rig.
        model: The model that it was planned on.
        targets: One number per output each, held one after the other.
        seconds: How long each is held [s].
    """
    try:
        return _predicted(controller, model, targets, seconds)
    except (ValueError, RuntimeError, Diverged) as error:
        why = " ".join(str(error).split())
        return (
            "prediction: nothing is foretold of this flight, as the model could not be flown "
            f"({type(error).__name__}{why and f': {why}'}); the flight goes on without it"
        )


def _predicted(controller: Controller, model: SindyModel, targets: Sequence[Sequence[float]], seconds: float) -> str:
    """Fly a model to each target, from where episodes begin, and say how near it comes, as of a flight."""
    scenario = Scenario("flight", Step(targets), len(targets), seconds)
    flight = workbench.foretell(controller, model, None, scenario).shown
    if flight is None:
        return "prediction: on the model this flight runs away"
    signature, wanted = model.signature, torch.tensor(np.array(targets, dtype=float)).unsqueeze(1)
    apart = (flight.outputs.double() - wanted).abs()
    errors = apart[:, round((1 - LAST) * apart.shape[1]) :].mean((0, 1)).tolist()
    units = (signature.state_units[signature.state_index(name)] for name in controller.outputs)
    told = [f"{n} to {error:.3g} {unit}" for n, error, unit in zip(controller.outputs, errors, units, strict=True)]
    return f"prediction of the model, mean error over the last half of each target: {', '.join(told)}"
