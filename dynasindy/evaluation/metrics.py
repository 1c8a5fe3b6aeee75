"""Tracking metrics of a control engineer, from plain tensors, at any batch size.

| name                | meaning                                                                  | unit |
| ------------------- | ------------------------------------------------------------------------ | ---- |
| rmse                | root mean square error over the record                                   | that of the output |
| mean_abs_error      | mean absolute error over the record                                      | that of the output |
| steady_state_error  | mean absolute error over the last `steady_seconds` (5 s of 20 s)         | that of the output |
| overshoot           | largest excursion beyond the reference, in percent of the step           | %    |
| rise_time           | from 10 % to 90 % of the step                                            | s    |
| settling_time       | from the step until the error stays within 5 % of the step, or the noise | s    |
| control_effort      | mean square input                                                        | -    |
| control_variation   | mean absolute change of the input per second                             | 1/s  |

The first six are per tracked axis, the last two per input. Overshoot, rise and settling time belong to
steps: they are NaN where the reference moves during the record or the step is smaller than `MIN_STEP` target ranges. A
step that never rises or never settles has an infinite time, so that a failure is never averaged away. One that comes
within 5 % later than the steady state begins has not settled. Where a disturbance begins later than the step, these
three are of what lies before it: how a step settles says nothing of a gust.
"""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from dynasindy.text import SECONDS, duration_unit, format_duration

TRACKING = ("rmse", "mean_abs_error", "steady_state_error")
STEP = ("overshoot", "rise_time", "settling_time")
CONTROL = ("control_effort", "control_variation")

STEADY_SECONDS = 5.0
"""Length of the final part of a record that counts as steady state [s], where the record allows it."""
STEADY_PERIODS = 20
"""Fewest samples of that part."""
STEADY_SHARE = 0.25
"""Largest share of the record that it takes."""
RISE = (0.1, 0.9)
"""Shares of the step between which it rises."""
SETTLING_BAND = 0.05
"""Half width of the settling band, as a share of the step."""
NOISE = 3.0
"""Half width of the band of what a sensor cannot tell from the target [standard deviations of its noise]."""
MIN_STEP = 0.05
"""Smallest step whose overshoot, rise and settling time are meaningful [target ranges]."""


def steady_seconds(dt: float, samples: int) -> float:
    """Return the length of the final part of a record that counts as steady state [s].

    Args:
        dt: Time between samples [s].
        samples: Their number.
    """
    return max(dt, min(max(STEADY_SECONDS, STEADY_PERIODS * dt), STEADY_SHARE * dt * samples))


def tracking_metrics(
    time: Tensor,
    y: Tensor,
    r: Tensor,
    u: Tensor,
    boxes: Tensor | None = None,
    until: float = math.inf,
    noise: Tensor | None = None,
) -> dict[str, Tensor]:
    """Compute every metric of the module's table.

    Args:
        time: `(T,)` sample times, evenly spaced, the first one is the moment of the step [s].
        y: `(*batch, T, n_r)` measured outputs, in their units.
        r: `(*batch, T, n_r)` references at the same times.
        u: `(*batch, T, n_u)` inputs held from each sample on, in [-1, 1].
        boxes: `(n_r,)` extents of the targets, of which a step is a share; one of each unit if omitted.
        until: When a disturbance begins, before which steps are judged [s]; one from the start on is part of the step.
        noise: `(n_r,)` standard deviations of the sensors, by `NOISE` of which what has settled may miss; 0 if omitted.

    Returns:
        `rmse` to `settling_time` of shape `(*batch, n_r)`, `control_*` of shape `(*batch, n_u)`.
    """
    error, dt = (y - r).abs(), time[1] - time[0]
    smallest = MIN_STEP * (torch.ones(y.shape[-1]) if boxes is None else boxes).to(y)
    early = time < until if bool((time < until).sum() > 1) else torch.ones_like(time, dtype=torch.bool)
    t, before, target = time[early], y[..., early, :], r[..., early, :]
    size = target[..., -1:, :] - before[..., :1, :]
    step = (size.abs() >= smallest) & (target == target[..., -1:, :]).all(-2, keepdim=True)
    progress = (before - before[..., :1, :]) / torch.where(step, size, 1.0)  # share of the step, 1 on the reference
    floor = NOISE * (torch.zeros(y.shape[-1]) if noise is None else noise).to(y)
    outside = (progress - 1.0).abs() > (floor / size.abs()).clamp_min(SETTLING_BAND)
    # Index of the first sample that is inside together with all that follow it.
    index = torch.where(outside, torch.arange(1, len(t) + 1, device=t.device).unsqueeze(-1), 0).amax(-2)
    never = outside[..., _steady(t), :].any(-2)
    settling = torch.where(never, torch.inf, (t - t[0])[index.clamp_max(len(t) - 1)])
    start, end = (_first_crossing(t, progress, share) for share in RISE)
    rise = torch.where(end.isinf(), end, end - start)  # inf - inf would be NaN, which is reserved for "not a step"
    of_steps = (100.0 * (progress.amax(-2) - 1.0).clamp_min(0.0), rise, settling)
    return {
        "rmse": error.square().mean(-2).sqrt(),
        "mean_abs_error": error.mean(-2),
        "steady_state_error": error[..., _steady(time), :].mean(-2),
        **{name: torch.where(step.squeeze(-2), value, torch.nan) for name, value in zip(STEP, of_steps, strict=True)},
        "control_effort": u.square().mean(-2),
        "control_variation": u.diff(dim=-2).abs().mean(-2) / dt,
    }


def _steady(time: Tensor) -> Tensor:
    """Return which samples count as steady state: exactly the last steady_seconds / dt."""
    dt = time[1] - time[0]
    return time > time[-1] - steady_seconds(float(dt), len(time)) + 0.5 * dt


def _first_crossing(time: Tensor, progress: Tensor, level: float) -> Tensor:
    """Return when `progress` first reaches `level`, between samples too, inf where it never does."""
    above = progress >= level
    after = above.long().argmax(-2, keepdim=True)
    before = (after - 1).clamp_min(0)
    p0, p1 = progress.gather(-2, before), progress.gather(-2, after)
    fraction = ((level - p0) / torch.where(p1 == p0, 1.0, p1 - p0)).clamp(0.0, 1.0)
    crossing = torch.lerp(time[before].to(progress), time[after].to(progress), fraction)
    return torch.where(above.any(-2), crossing.squeeze(-2), torch.inf)


Summary = dict[str, float | None]

MOST = 12
"""States that are not tracked which a table has."""
WORDS = {
    "rmse": ("RMSE", ""),
    "mean_abs_error": ("mean abs error", ""),
    "steady_state_error": ("steady-state error", ""),
    "overshoot": ("overshoot", "%"),
    "rise_time": ("rise time (10-90 %)", "s"),
    "settling_time": ("settling time (5 %)", "s"),
    "settled": ("settled within the run", "%"),
    "steps": ("targets that are steps", ""),
    "control_effort": ("control effort (mean u^2)", "-"),
    "control_variation": ("control variation", "1/s"),
}
"""What figures are called, and their units but for those of the outputs."""


def to_text(
    summary: Mapping[str, float | None],
    title: str = "",
    units: Mapping[str, str] | None = None,
    steady: float | None = 5.0,
) -> str:
    """Return a table of a summary, metrics down and axes across, aligned for a terminal.

    Where the scenario has no steps, their metrics are left out; where nothing is tracked, all errors.

    Args:
        summary: The figures.
        title: First line.
        units: Unit of each state; rad if omitted.
        steady: Length of the part that counts as steady state [s]; None leaves its error out, as of a sine.
    """
    units, errors = units or {}, [name for name in TRACKING if steady is not None or name != "steady_state_error"]
    last = f"steady-state error (last {format_duration(steady or 0.0)})"
    axes, inputs = _columns(summary, "rmse"), _columns(summary, "control_effort")
    told = [units.get(axis, "rad") for axis in axes]
    shared = told[0] if len(set(told)) == 1 else ""
    steps = [name for name in ("steps", *STEP, "settled") if any(key.startswith(f"{name}/") for key in summary)]
    stepped = any(summary[f"settled/{axis}"] is not None for axis in axes)

    def row(heading: str, cells: Sequence[str]) -> str:
        return f"{heading:38s}" + "".join(f" {cell:>11s}" for cell in cells)

    def cells(metric: str, columns: Sequence[str], factor: float = 1.0) -> list[str]:
        return [_cell(summary[f"{metric}/{column}"], factor) for column in columns]

    lines = [title] if title else []
    if axes:
        lines.append(row("", axes if shared else [f"{axis} [{units.get(axis, 'rad')}]" for axis in axes]))
    for name in (*errors, *(steps if stepped else ())) if axes else ():
        words, unit = (last if name == "steady_state_error" else WORDS[name][0]), WORDS[name][1]
        unit, factor = shared if name in TRACKING else unit, 100.0 if name == "settled" else 1.0
        if unit == SECONDS.name:
            times = duration_unit(max(summary[f"{name}/{axis}"] or 0.0 for axis in axes))
            unit, factor = times.name, 1 / times.seconds
        lines.append(row(f"{words} [{unit}]" if unit else words, cells(name, axes, factor)))
    if inputs:
        lines.append(row("", inputs))
        lines += [row("{} [{}]".format(*WORDS[name]), cells(name, inputs)) for name in CONTROL]
    others = [name for name in _columns(summary, "least") if name in units][:MOST]
    lines += [row("not tracked", ("least", "most"))] * bool(others)
    lines += [row(f"{n} [{units[n]}]", [_cell(summary[f"{end}/{n}"]) for end in ("least", "most")]) for n in others]
    lines.append(row("return", [_cell(summary["return"])]))
    if summary.get("own_return") is not None:
        lines.append(row("return of the environment itself", [_cell(summary["own_return"])]))
    return "\n".join([*lines, row("share of time at a stop [%]", [_cell(summary["stop_share"], 100.0)])])


def _columns(summary: Mapping[str, float | None], metric: str) -> list[str]:
    return [key.partition("/")[2] for key in summary if key.startswith(f"{metric}/")]


def _cell(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.4g}"
