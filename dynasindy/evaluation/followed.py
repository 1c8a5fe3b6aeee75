"""Whether a plant that equations do not describe has an input that acts through a lag, told by predictions of a log."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from dynasindy.evaluation.horizons import Forecasts, forecast
from dynasindy.evaluation.source import Source
from dynasindy.evaluation.verdict import LOST, unresolved
from dynasindy.systems import Signature
from dynasindy.world_models import FitReport, SindyModel
from dynasindy.world_models.models.follower import lag_of, widened, with_follower

BETTER = 0.7
"""Part of a model's errors, their geometric mean over states and horizons, that are left where a lag is believed."""


@dataclass(frozen=True)
class Followed:
    """Hold a model, and the data with all of its states.

    Attributes:
        model: as it was, or with a lag as one state more.
        source: the data; a lag is seen by no sensor.
        report: of the fit with the lag; None where there is none.
        words: what was found; empty where nothing was.
    """

    model: SindyModel
    source: Source
    report: FitReport | None = None
    words: str = ""


def followed(model: SindyModel, source: Source) -> Followed:
    """Return a model and data with the lag of an input as one state more, where something lacks; else as they are.

    It is looked for where the model misses the last part of a log by more than the sensors explain, and believed where
    with the lag the model misses far less.

    Args:
        model: what was fitted to the training data.
        source: the data.
    """
    plain = Followed(model, source)
    before = forecast(model, source.training, source.validation) if source.logged else None
    if before is None or not bool(unresolved(before, model.signature).any()):
        return plain
    for place, name in enumerate(model.signature.input_names):
        try:
            found = _with_lag(model, source, place)
        except (ArithmeticError, ValueError, RuntimeError):  # numbers that run away, or too few samples
            continue
        if found is None:
            continue
        after = forecast(found.model, found.source.training, found.source.validation)
        if after is not None and _better(before, after, model.signature):
            seconds = 1 / float(found.model.coefficients[:, -1].abs().sum())
            return replace(found, words=f"{name} acts through a lag of {seconds:.3g} s, a state that no sensor sees")
    return plain


def _with_lag(model: SindyModel, source: Source, place: int) -> Followed | None:
    """Return a fit with the lag of an input; None where none explains more."""
    time = lag_of(model, source.training, place)
    wide = with_follower(model, source.training, place, time) if time else None
    if wide is None:
        return None
    training, validation = widened(source.training), widened(source.validation)
    data = replace(source, signature=wide.signature, training=training, validation=validation)
    return Followed(wide, data, wide.fit(training))


def _better(before: Forecasts, after: Forecasts, signature: Signature) -> bool:
    """Tell whether errors are lower by far, in the geometric mean over the states that were measured and horizons.

    An error counts as what the sensor resolves at least, and as what has run away at most.
    """
    most = LOST * torch.tensor(signature.x_scale, dtype=before.model.dtype)
    least = torch.minimum(before.resolution.nan_to_num(nan=0.0).to(most), most).clamp_min(1e-300)
    ours, theirs = (f.model[:, : len(most)].clamp(least, most) for f in (after, before))
    seen = ~before.model.isnan()
    return bool((ours / theirs).log()[seen].mean().exp() < BETTER)
