"""From a log or a model of a plant to a controller and its prediction, without the plant; written down on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dynasindy.evaluation.forecast import Forecast
from dynasindy.evaluation.summary import beyond_targets, evaluation_title, restless, summarise, to_text
from dynasindy.identification.identify import before_fit
from dynasindy.identification.log_fit import fit_log
from dynasindy.identification.source import Source
from dynasindy.progress import say, width
from dynasindy.sentences import line, lines
from dynasindy.sindy import SindyModel


def model_of(source: Source | None, build: Callable[..., SindyModel], path: str | Path | None = None) -> SindyModel:
    """Return the model of a file, or identify one and print what the fit says of itself.

    A model that is fitted here may have a state more than the log, which follows an input or a measured state.

    Args:
        source: The log; None if there is none, and then there is a file.
        build: Makes a model from a signature.
        path: File of a model.

    Raises:
        ValueError: The file is damaged or of another plant.
        TypeError: The world model is not sparse.
    """
    if path is not None or source is None:
        model = SindyModel.load(str(path))
        if source is not None:
            source.with_states_of(model)  # refuses a model of another plant
        return model
    built = build(signature=source.signature)
    if before := before_fit(built, source):
        say(*lines(before))
    found = fit_log(built, source)
    say(
        found.report.to_text(), *(f"found: {each}" if each.severity == "note" else line(each) for each in found.content)
    )
    return found.model


def log_report(model: SindyModel, prediction: Forecast) -> str:
    """Return what a user reads at the end: equations, the table of the flight that is drawn, the prediction."""
    text = ["", "Identified equations", *(f"  {equation}" for equation in model.equations()), ""]
    if prediction.evaluation is not None:
        title = f"{evaluation_title(prediction.evaluation)}, {prediction.place}"
        shown = prediction.evaluation
        table = to_text(summarise(shown), title, shown.units, shown.told_steady_seconds, width())
        text += [table, *lines([*beyond_targets(shown), *restless(shown)]), ""]
    return "\n".join([*text, prediction.summary()])
