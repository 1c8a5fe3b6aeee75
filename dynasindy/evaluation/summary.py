"""An evaluation in a few numbers: a dictionary for `metrics.json` and a table to read."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from dynasindy.evaluation.metrics import CONTROL, STEP, TRACKING, UNITS
from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.tracking_criteria import representative_episode
from dynasindy.findings import Finding, note, weak
from dynasindy.safe_io import write_csv, write_json
from dynasindy.systems import Signature
from dynasindy.text import SECONDS, duration_unit, format_duration

Summary = dict[str, float | None]

RESTLESS = 0.02
"""Mean change of an input from one control period to the next, in the steady state, beyond which it is told [its range
from -1 to 1 counts as 2]."""
ROUNDING = 1e-4
"""What a reference may lie beyond its ends by, as float32 rounds it [ranges of the targets]."""
MOST = 12
"""States that are not tracked which a table has."""
SINGLE = 1e-6
"""The same as a share of the ends themselves, where the range is none or small."""
WORDS = {
    "rmse": "RMSE",
    "mean_abs_error": "mean abs error",
    "steady_state_error": "steady-state error (last 5 s)",
    "overshoot": "overshoot",
    "rise_time": "rise time (10-90 %)",
    "settling_time": "settling time (5 %)",
    "settled": "settled within the run",
    "steps": "targets that are steps",
    "control_effort": "control effort (mean u^2)",
    "control_variation": "control variation",
}


def summarise(evaluation: Evaluation) -> Summary:
    """Return flat, JSON-ready figures: `return`, `stop_share` and `<metric>/<axis or input>`.

    `own_return` is what a Gymnasium environment itself pays; other plants have none.

    Errors and control figures are means over the rows. Overshoot and times are medians over the rows that are
    steps, because one step that never settles has an infinite time; a median that is infinite, or that no row
    defines, is None. `settled/<axis>` is the share of steps that settle, `steps/<axis>` how many rows are steps.
    `least/<state>` and `most/<state>` are the ends between which a state that is not tracked moves.
    """
    summary: Summary = {
        "return": _number(evaluation.returns.mean()),
        "stop_share": _number(evaluation.trajectory["next", "at_stop"].float().mean()),
    }
    if (own := evaluation.trajectory["next"].get("own_reward", None)) is not None:
        summary["own_return"] = _number(own.sum((-1, -2)).mean())
    for i, axis in enumerate(evaluation.output_names):
        for name in TRACKING:
            summary[f"{name}/{axis}"] = _number(evaluation.metrics[name][:, i].mean())
        for name in STEP:
            summary[f"{name}/{axis}"] = _number(evaluation.metrics[name][:, i].nanquantile(0.5))
        times = evaluation.metrics["settling_time"][:, i]
        steps = times[~times.isnan()]
        summary[f"settled/{axis}"] = _number(steps.isfinite().float().mean())
        summary[f"steps/{axis}"] = float(len(steps))
    for i in evaluation.state_order[len(evaluation.columns) :]:
        name, ends = evaluation.signature.state_names[i], evaluation.trajectory["state"][..., i].aminmax()
        summary |= {f"least/{name}": _number(ends[0]), f"most/{name}": _number(ends[1])}
    for i, name in enumerate(evaluation.signature.input_names):
        for metric in CONTROL:
            summary[f"{metric}/{name}"] = _number(evaluation.metrics[metric][:, i].mean())
    return summary


def restless(evaluation: Evaluation) -> list[Finding]:
    """Return which inputs go on moving while all targets rest: a plant is held, and a valve wears out."""
    if not bool(evaluation.resting.all()):
        return []
    changes = evaluation.inputs[:, -evaluation.steady_periods :].double().diff(dim=1).abs().mean((0, 1)).tolist()
    return [
        weak("control.restless", input=name, percent=50 * change)
        for name, change in zip(evaluation.signature.input_names, changes, strict=True)
        if change > RESTLESS
    ]


def beyond_targets(evaluation: Evaluation) -> list[Finding]:
    """Return which references lie beyond the ends of the targets that were given for the plant."""
    findings = []
    for i, (low, high) in enumerate(evaluation.ends):
        name, unit = evaluation.output_names[i], evaluation.units[evaluation.output_names[i]]
        asked = evaluation.references[..., i]
        least, most = float(asked.min()), float(asked.max())
        room = max(ROUNDING * (high - low), SINGLE * max(abs(low), abs(high)))
        if least < low - room or most > high + room:
            facts = {"output": name, "scenario": evaluation.scenario, "unit": unit, "least": least, "most": most}
            findings.append(note("control.beyond_targets", **facts, low=low, high=high))
    return findings


def to_text(
    summary: Mapping[str, float | None],
    title: str = "",
    units: Mapping[str, str] | None = None,
    steady: float | None = 5.0,
    width: int | None = None,
) -> str:
    """Return a table of a summary, metrics down and axes across, aligned for a terminal.

    Where the scenario has no steps, their metrics are left out; where nothing is tracked, all errors.

    Args:
        summary: The figures.
        title: First line.
        units: Unit of each state; rad if omitted.
        steady: Length of the part that counts as steady state [s]; None leaves its error out, as of a sine.
        width: Columns of the terminal; axes that do not fit beside each other stand below. None lets lines be long.
    """
    units, words, errors = units or {}, dict(WORDS), list(TRACKING)
    if steady is None:
        errors.remove("steady_state_error")
    else:
        words["steady_state_error"] = f"steady-state error (last {format_duration(steady)})"
    axes, inputs = _columns(summary, "rmse"), _columns(summary, "control_effort")
    told = [units.get(axis, "rad") for axis in axes]
    shared = told[0] if len(set(told)) == 1 else ""
    beside = len(axes) + len(inputs) if width is None else max(1, (width - 38) // 12)
    steps = [name for name in ("steps", *STEP, "settled") if any(key.startswith(f"{name}/") for key in summary)]
    stepped = any(summary[f"settled/{axis}"] is not None for axis in axes)

    def row(heading: str, cells: Sequence[str]) -> str:
        return f"{heading:38s}" + "".join(f" {cell:>11s}" for cell in cells)

    def cells(metric: str, columns: Sequence[str], factor: float = 1.0) -> list[str]:
        # Among steps, a time without a number is one that most of them never reach.
        never = [metric.endswith("_time") and summary[f"settled/{column}"] is not None for column in columns]
        values = (summary[f"{metric}/{column}"] for column in columns)
        return [_cell(v, factor, "never" if n else "-") for v, n in zip(values, never, strict=True)]

    lines = [title] if title else []
    for some in (axes[k : k + beside] for k in range(0, len(axes), beside)):
        lines.append(row("", some if shared else [f"{axis} [{units.get(axis, 'rad')}]" for axis in some]))
        for name in (*errors, *(steps if stepped else ())):
            unit = shared if name in TRACKING else "" if name == "steps" else UNITS.get(name, "%")
            factor = 100.0 if name == "settled" else 1.0
            if unit == SECONDS.name:
                times = duration_unit(max((summary[f"{name}/{axis}"] or 0.0 for axis in some), default=0.0))
                unit, factor = times.name, 1 / times.seconds
            lines.append(row(f"{words[name]} [{unit}]" if unit else words[name], cells(name, some, factor)))
    for some in (inputs[k : k + beside] for k in range(0, len(inputs), beside)):
        lines.append(row("", some))
        lines += [row(f"{words[name]} [{UNITS[name]}]", cells(name, some)) for name in CONTROL]
    others = [name for name in _columns(summary, "least") if name in units][:MOST]
    lines += [row("not tracked", ("least", "most"))] * bool(others)
    lines += [row(f"{n} [{units[n]}]", [_cell(summary[f"{end}/{n}"]) for end in ("least", "most")]) for n in others]
    lines.append(row("return", [_cell(summary["return"])]))
    if summary.get("own_return") is not None:
        lines.append(row("return of the environment itself", [_cell(summary["own_return"])]))
    return "\n".join([*lines, row("share of time at a stop [%]", [_cell(summary["stop_share"], 100.0)])])


def _columns(summary: Mapping[str, float | None], metric: str) -> list[str]:
    return [key.partition("/")[2] for key in summary if key.startswith(f"{metric}/")]


def _cell(value: float | None, factor: float = 1.0, missing: str = "-") -> str:
    return missing if value is None else f"{factor * value:.4g}"


def _number(value: Tensor) -> float | None:
    return value.item() if torch.isfinite(value) else None


def save_evaluation(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write `<scenario>.json` (the summary) and `<scenario>.csv` (the episode that is drawn).

    Args:
        evaluation: What to write.
        folder: Where; made if missing.

    Returns:
        The files.
    """
    figures, table = (folder / f"{evaluation.scenario}.{suffix}" for suffix in ("json", "csv"))
    row, _ = representative_episode(evaluation)
    record = {"scenario": evaluation.scenario, "rows": len(evaluation.outputs), **summarise(evaluation)}
    write_json(figures, record)
    signature = evaluation.signature
    header = [*signature.state_names, *signature.input_names]
    header += [f"reference_{name}" for name in evaluation.output_names]
    parts = (evaluation.trajectory["state"], evaluation.inputs, evaluation.references)
    values = torch.cat([evaluation.time.unsqueeze(-1), *(part[row] for part in parts)], -1)
    write_csv(table, column_headings(["time", *header], signature), values.tolist())
    return [figures, table]


def column_headings(names: Sequence[str], signature: Signature) -> list[str]:
    """Return headings of a table over time: `time [s]`, `alpha_a [rad]`, `reference_alpha_a [rad]`, `u_a [-]`."""
    units = {**dict(zip(signature.state_names, signature.state_units, strict=True)), "time": "s"}
    return [f"{name} [{units.get(re.sub('^(reference|predicted)_', '', name), '-')}]" for name in names]
