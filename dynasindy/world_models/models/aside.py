"""A fit that was set aside, taken in the place of the one that was preferred."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

from dynasindy.systems.transitions import Transitions
from dynasindy.world_models.models.report import FitReport
from dynasindy.world_models.models.sindy import SindyModel
from dynasindy.world_models.refinement.refine import Refinement
from dynasindy.world_models.refinement.refined import Refined


@dataclass(frozen=True, kw_only=True)
class Taken(Refinement):
    """Return what was found before, at no cost.

    Attributes:
        found: what it was.
    """

    found: Refined

    def run(self, *of: object, **given: object) -> Refined:
        """Return it, whatever the data are."""
        return self.found


def aside(model: SindyModel, found: Refined, data: Transitions) -> tuple[SindyModel, FitReport]:
    """Return the model that a fit has set aside, and the report of it.

    What it is fitted to later, as parts of the log are, it is fitted to as a whole, too: by one simulation.

    Args:
        model: what was fitted; it stays as it is.
        found: what the fit set aside.
        data: the recording that it was fitted to.
    """
    other, settings = copy.deepcopy(model), model.refinement or Refinement()
    other.refinement = Taken(**vars(settings), found=found)
    report = other.fit(data)
    other.refinement = replace(settings, error="simulation")
    return other, report
