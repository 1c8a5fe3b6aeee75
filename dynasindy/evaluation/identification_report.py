"""What was identified, in words and in files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from dynasindy.evaluation import verdict
from dynasindy.evaluation.equations import bend_hint, describe_model, idle
from dynasindy.evaluation.identification import Identified
from dynasindy.evaluation.source import Source
from dynasindy.safe_io import write_json, write_text
from dynasindy.sindy import SindyModel
from dynasindy.sindy.equations import coefficient_lines, coefficient_tables
from dynasindy.systems.transitions import Transitions

UNKNOWN = "the refinement, which tells them, found no equations, or ones that run away from the data"
"""Why coefficients that were fitted may have none."""


def to_words(found: Identified, source: Source, columns: int | None = None) -> str:
    """Write equations, fit, identifiability, what the data show, errors, notes and a verdict for a reader.

    Args:
        found: What was identified.
        source: The data.
        columns: Columns of the terminal that the table of errors has to fit; None lets lines be long.
    """
    signature, shown = source.signature, found.forecasts
    seen = [*describe_model(found.model, found.report), *verdict.describe_data(source.training, signature)]
    lines = [
        *found.model.equations(),
        *_errors(found.model),
        "",
        found.report.to_text(),
        *(f"found: {line}" for line in seen),
        *found.hidden,
        *idle(found.model, source.training),
        *([bend_hint(found.bend, found.model)] if found.bend else []),
        "",
    ]
    if shown is not None:
        lines += verdict.table(shown, signature, columns)
    free = found.metrics["open_loop_nrmse"]
    lines.append(
        f"one prediction of all data that the fit did not see{describe_restarts(source.validation)}, "
        f"relative to the standard "
        "deviation of each state"
    )
    lines += [f"  {state:<10} {_percent(error)}" for state, error in free.items()]
    if shown is None:
        return "\n".join([*lines, "the validation data are too short to judge how far ahead the model predicts"])
    lines += verdict.judge(told, signature) if (told := found.heard()) is not None else []
    return "\n".join([*lines, *filter(None, [found.quiet])])


def _errors(model: SindyModel) -> list[str]:
    """Return a line for each coefficient with its standard error, below a heading, or why there is no such error."""
    if model.covariance is None:
        fitted = bool((model.constraints.free & (model.coefficients != 0)).any())
        return ["", f"coefficients have no standard errors (±): {UNKNOWN if fitted else 'none of them was fitted'}"]
    errors = model.covariance.table(model.coefficients.shape)
    return ["", "coefficients and their standard errors", *coefficient_lines(model.library, model.coefficients, errors)]


def describe_restarts(data: Transitions) -> str:
    """Say that a prediction of all data begins anew after gaps, and how often; empty where there is none."""
    gaps = int(data.begins().sum()) - 1
    if gaps < 1:
        return ""
    return ", begun anew after its gap" if gaps == 1 else f", begun anew after each of its {gaps} gaps"


def _percent(error: float) -> str:
    return f"{100 * error:.3g} %" if math.isfinite(error) else "runs away"


def write_identification(found: Identified, source: Source, folder: Path, before: Sequence[str] = ()) -> None:
    """Write model.json, metrics.json, report.txt and the coefficients as text, LaTeX and CSV.

    Args:
        found: the model and its figures.
        source: the data.
        folder: where; made if missing.
        before: lines with which the report begins.
    """
    found.model.save(folder / "model.json")
    write_json(folder / "metrics.json", found.metrics, indent=1, finite=False)
    write_text(folder / "report.txt", "\n".join([*before, to_words(found, source)]) + "\n")
    for ending, text in coefficient_tables(found.model.library, found.model.coefficients).items():
        write_text(folder / f"coefficients.{ending}", text)
