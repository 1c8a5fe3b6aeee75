"""The spread of a model: fits to stretches of its data."""

from __future__ import annotations

import copy
from dataclasses import replace

import torch

from dynasindy.progress import reporting_as
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.model import SindyModel
from dynasindy.systems.transitions import Transitions


def refits(model: SindyModel, data: Transitions, stretches: int, name: str) -> list[SindyModel]:
    """Fit the functions that a model uses to stretches of data, each on its own.

    Each fit is refined as the model was, from its coefficients on.

    Args:
        model: a fitted model, which is not changed.
        data: transitions, NaN where a state was not measured.
        stretches: number of stretches of equal length; each gives a model.
        name: what the data are, for those who wait.

    Raises:
        ValueError: a stretch has fewer transitions than the library has functions.
        Diverged: a coefficient is not finite.
    """
    late, places = delay_inputs(data, model.delay), torch.arange(len(data))
    length, found = len(data) // stretches, []
    for k in range(stretches):
        member = copy.deepcopy(model)
        used = model.constraints.free & (model.coefficients != 0)
        given = torch.where(model.constraints.free, 0.0, model.constraints.offset)
        member.constraints = replace(model.constraints, free=used, offset=given)
        member.initial, member.initial_delay = model.coefficients.clone(), 0.0
        if member.refinement is not None:
            member.refinement = replace(member.refinement, longest_delay=0.0)
        with reporting_as(f"fit to {name}" if stretches == 1 else f"fit to part {k + 1} of {stretches} of {name}"):
            member.fit(late.select((places >= k * length) & (places < (k + 1) * length)))
        member.delay = model.delay
        found.append(member)
    return found
