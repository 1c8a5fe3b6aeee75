"""The fit to data: where a log shows that the equations lack something, an input that acts through a lag is tried."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import torch

from dynasindy.evaluation.horizons import Forecasts, forecast
from dynasindy.evaluation.source import Source
from dynasindy.evaluation.verdict import LOST, unresolved
from dynasindy.systems import Signature
from dynasindy.told import tell, telling
from dynasindy.world_models import FitReport, SindyModel
from dynasindy.world_models.models.follower import lag_of, with_follower
from dynasindy.world_models.refinement.order import moving_on

BETTER = 0.7
"""Part of a model's errors, their geometric mean over states and horizons, that are left where a lag is believed."""


@dataclass(frozen=True)
class Fitted:
    """Hold a fitted model, and the data with all of its states.

    Attributes:
        model: as it was given, or with a lag as one state more.
        source: the data; a lag is seen by no sensor.
        report: of the fit.
        lag: what was found of a lag, in words; empty where nothing was.
    """

    model: SindyModel
    source: Source
    report: FitReport
    lag: str = ""


def fitted(model: SindyModel, source: Source) -> Fitted:
    """Fit a model; where something lacks in it, fit it with the lag of an input as one state more.

    A lag is looked for where the model misses the last part of a log by more than the sensors explain, and believed
    where with the lag the model misses far less. It is not looked for where a rate is missing, as it would stand for
    that.

    Args:
        model: what to fit.
        source: the data.

    Raises:
        ValueError: the model refuses the data.
        Diverged: a coefficient is not finite.
    """
    began = time.perf_counter()
    found = _fitted(model, source)
    return replace(found, report=replace(found.report, seconds=time.perf_counter() - began))


def _fitted(model: SindyModel, source: Source) -> Fitted:
    tell("fit")
    plain = Fitted(model, source, model.fit(source.training))
    before = forecast(model, source.training, source.validation) if source.logged else None
    if before is None or not bool(unresolved(before, model.signature).any()):
        return plain
    if moving_on(model.library, source.training):
        return plain
    for place, name in enumerate(model.signature.input_names):
        try:
            with telling(f"fit with a lag of {name}"):
                found = _with_lag(model, source, place)
        except (ArithmeticError, ValueError, RuntimeError):  # numbers that run away, or too few samples
            continue
        if found is None:
            continue
        after = forecast(found.model, found.source.training, found.source.validation)
        if after is not None and _better(before, after, model.signature):
            seconds = 1 / float(found.model.coefficients[:, -1].abs().sum())
            return replace(found, lag=f"{name} acts through a lag of {seconds:.3g} s, a state that no sensor sees")
    return plain


def _with_lag(model: SindyModel, source: Source, place: int) -> Fitted | None:
    """Return a fit with the lag of an input; None where none explains more."""
    time = lag_of(model, source.training, place)
    wide = with_follower(model, source.training, place, time) if time else None
    if wide is None:
        return None
    data = source.with_states_of(wide)
    return Fitted(wide, data, wide.fit(data.training))


def _better(before: Forecasts, after: Forecasts, signature: Signature) -> bool:
    """Tell whether errors are lower by far, in the geometric mean over the states that were measured and horizons.

    An error counts as what the sensor resolves at least, and as what has run away at most.
    """
    most = LOST * torch.tensor(signature.x_scale, dtype=before.model.dtype)
    least = torch.minimum(before.resolution.nan_to_num(nan=0.0).to(most), most).clamp_min(1e-300)
    ours, theirs = (f.model[:, : len(most)].clamp(least, most) for f in (after, before))
    seen = ~before.model.isnan()
    return bool((ours / theirs).log()[seen].mean().exp() < BETTER)
