"""Whether a plant that equations do not describe has an input that acts through a lag, told by predictions of a log."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dynasindy.evaluation.horizons import Forecasts, forecast
from dynasindy.evaluation.source import Source
from dynasindy.evaluation.verdict import doubts
from dynasindy.systems import Diverged
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

    It is looked for where a linear model on past samples predicts the last part of a log far better than the model, and
    believed where with the lag the model does.

    Args:
        model: what was fitted to the training data.
        source: the data.
    """
    plain = Followed(model, source)
    before = forecast(model, source.training, source.validation) if source.logged else None
    if before is None or not doubts(before, model.signature):
        return plain
    for place, name in enumerate(model.signature.input_names):
        time = lag_of(model, source.training, place)
        wide = with_follower(model, source.training, place, time) if time else None
        if wide is None:
            continue
        training, validation = widened(source.training), widened(source.validation)
        data = replace(source, signature=wide.signature, training=training, validation=validation)
        try:
            report = wide.fit(data.training)
        except (Diverged, ValueError):
            continue
        after = forecast(wide, data.training, data.validation)
        if after is not None and _better(before, after):
            seconds = 1 / float(wide.coefficients[:, -1].abs().sum())
            said = f"{name} acts through a lag of {seconds:.3g} s, a state that no sensor sees"
            return Followed(wide, data, report, said)
    return plain


def _better(before: Forecasts, after: Forecasts) -> bool:
    """Tell whether errors are lower by far, in the geometric mean over the states that were measured and horizons."""
    ratio = (after.model[:, : before.model.shape[1]] / before.model).log()
    return bool(ratio[~before.model.isnan()].mean().exp() < BETTER)
