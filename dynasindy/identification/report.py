"""What was identified, in words and in files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import torch

from dynasindy.findings import Finding, records
from dynasindy.identification.forecast_errors import LOST, ForecastErrors
from dynasindy.identification.identify import Identified
from dynasindy.identification.source import Source
from dynasindy.safe_io import write_json, write_text
from dynasindy.sentences import error_of, line, lines, verdict_lines
from dynasindy.sindy import SindyModel
from dynasindy.sindy.equations import coefficient_lines, coefficient_tables
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions
from dynasindy.text import format_duration

UNKNOWN = "the refinement, which tells them, found no equations, or ones that run away from the data"
"""Why coefficients that were fitted may have none."""


FINEST = 1e-6
"""Part of the range of a state below which what a sensor resolves is no noise."""
CELL = 11
"""Columns of a number in the table of errors."""


def to_words(found: Identified, source: Source, columns: int | None = None) -> str:
    """Write equations, fit, identifiability, what the data show, errors and a verdict for a reader.

    Args:
        found: What was identified.
        source: The data.
        columns: Columns of the terminal that the table of errors has to fit; None lets lines be long.
    """
    signature, forecasts = source.signature, found.forecasts
    text = [
        *found.model.equations(),
        *_errors(found.model),
        "",
        found.report.to_text(),
        *(f"found: {each}" if each.severity == "note" else line(each) for each in found.content),
        "",
        *(table(forecasts, signature, columns) if forecasts is not None else []),
        f"one prediction of all data that the fit did not see{describe_restarts(source.validation)}, relative to the "
        "standard deviation of each state",
    ]
    text += [f"  {state:<10} {_percent(error)}" for state, error in found.metrics["open_loop_nrmse"].items()]
    return "\n".join([*text, *verdict_lines(found.verdict)])


def table(forecasts: ForecastErrors, signature: Signature, columns: int | None = None) -> list[str]:
    """Write the errors over all horizons: of the model, of a linear one, and of the last value held, a line each.

    A linear model may run away without ever being infinite: beyond `LOST` ranges of a state its error is no number.

    Args:
        forecasts: The errors.
        signature: Names and units of the states.
        columns: Columns of the terminal; horizons that do not fit beside each other stand in a table below. None
            lets lines be long.
    """
    kinds = {"model": forecasts.model, "linear model": forecasts.linear, "last value held": forecasts.held}
    wide, heads = max(map(len, kinds)) + 4, [format_duration(horizon) for horizon in forecasts.horizons]
    beside = len(heads) if columns is None else max(1, (columns - wide - 2) // CELL)
    fine = (forecasts.resolution < FINEST * torch.tensor(signature.x_scale)).tolist()
    text = [
        f"RMS error of predictions that begin at {forecasts.starts} samples which the fit did not see; the linear "
        f"model predicts from {forecasts.order} past samples; over the first"
    ]
    for some in (range(len(heads))[first : first + beside] for first in range(0, len(heads), beside)):
        text.append(f"  {'':<{wide}}{''.join(f'{heads[k]:>{CELL}}' for k in some)}")
        for i, (name, unit) in enumerate(zip(signature.state_names, signature.state_units, strict=True)):
            if bool(forecasts.held[:, i].isnan().all()):
                continue
            finest = f"the sensor resolves {error_of(float(forecasts.resolution[i]))}"
            text.append(f"  {name} [{unit}], {'whose sensor shows no noise' if fine[i] else finest}")
            most = LOST * signature.x_scale[i]
            for kind, found in kinds.items():
                errors = [float(found[k, i]) for k in some]
                cells = (error_of(math.inf if error > most else error) for error in errors)
                text.append(f"    {kind:<{wide - 2}}{''.join(f'{cell:>{CELL}}' for cell in cells)}")
    return text


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


def write_identification(found: Identified, source: Source, folder: Path, before: Sequence[Finding] = ()) -> None:
    """Write model.json, metrics.json, report.txt and the coefficients as text, LaTeX and CSV.

    Args:
        found: the model and its figures.
        source: the data.
        folder: where; made if missing.
        before: what was found before the fit, with which the report begins.
    """
    found.model.save(folder / "model.json")
    findings = [*before, *(each for each in found.findings if each not in before)]
    write_json(folder / "metrics.json", {**found.metrics, "findings": records(findings)}, indent=1, finite=False)
    write_text(folder / "report.txt", "\n".join([*lines(before), to_words(found, source)]) + "\n")
    for ending, text in coefficient_tables(found.model.library, found.model.coefficients).items():
        write_text(folder / f"coefficients.{ending}", text)
