"""An evaluation in a few numbers, as a table to read, and the headings of tables over time."""

from collections.abc import Mapping, Sequence

from dynasindy.evaluation.metrics import CONTROL, STEP, TRACKING, UNITS
from dynasindy.text import SECONDS, duration_unit, format_duration

Summary = dict[str, float | None]

MOST = 12
"""States that are not tracked which a table has."""
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
