"""The control period that suits a log and the model that was fitted to it, and where the log mostly was."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dynasindy.envs import ControlEnv, Tracking
from dynasindy.findings import Finding, note
from dynasindy.identification.source import PERIOD, Source, closest_period
from dynasindy.identification.verdict import logged_input_ranges
from dynasindy.planning.plan_settings import LONGEST, choose_plan_settings, find_task_equilibria
from dynasindy.planning.regulator import regulated, squares_of
from dynasindy.sindy import SindyModel
from dynasindy.sindy.lag_states import lag_state_ranges
from dynasindy.sindy.reconstruction import rate_states, reconstruct
from dynasindy.systems.equilibria import LocalModes, slopes
from dynasindy.systems.transitions import Transitions

PERIODS = {"oscillation": 5, "doubling": 4}
"""Control periods in the fastest oscillation of the model at least, if nobody asks for another one, and in the time in
which a deviation of an unstable model doubles: inputs that act a period late have to hold it. With a hold of a period,
which delays by half of one, a deviation grows by exp(0.26) until then."""
PLACES = 64
"""Places of a log at which its model is looked at."""
SHARED = 0.25
"""Part of those places in which the model has to swing as fast, for the period to follow it: single ones lie where the
equations bend, or where they only guess."""
SETTLED = 0.05
"""Share of a step within which outputs have settled, as the longest window has to see."""
FINE = 64
"""Steps in which settling is told before they become twice as long: so they are some hundredths of the time so far."""
BEYOND = 2.0
"""How much longer settling is watched than a mode takes: several of one rate, as of tanks in a row, take longer."""


def suited_period(model: SindyModel, task: Tracking, log: Source | None) -> tuple[float, Finding | None]:
    """Return the control period that suits a model and its log [s], and why it is not `PERIOD`; None where it is.

    It is what suits the log, but a fifth of the model's fastest oscillation at most, and a quarter of the time in which
    a deviation doubles, where the log mostly was or in a quarter of its places; without a log where episodes begin. It
    is longer where a plan would otherwise not look as far ahead as the regulated plant takes to settle. With a log it
    is a multiple of its sampling time, and one sample at least. Of a difference equation without a log it is the step.

    Args:
        model: The fitted model.
        task: What is to be tracked.
        log: The log.
    """
    if log is None and model.step:
        return _chosen(model.step, "step")
    usual, step = closest_period(log), log.training.dt if log else 0.0
    task, (x, u) = as_planned(task, model, log), _places(model, task, log)
    # Which motion, at the first place or enough others, asks for the shorter period.
    modes, times = [LocalModes(model, *place, task.outputs) for place in zip(x, u, strict=True)], dict[str, float]()
    for kind in PERIODS:
        first, *others = (getattr(at, kind) for at in modes)
        enough = sorted(others)[max(0, math.ceil(SHARED * len(others)) - 1) :][:1]  # none of no other places
        times[kind] = min([first, *enough])
    kind = min(times, key=lambda kind: times[kind] / PERIODS[kind])
    fastest, longest = times[kind], times[kind] / PERIODS[kind]
    if step < usual and longest < usual * (1 - 1e-6):
        step = step or _two_digits(longest)
        samples = math.floor(longest / step + 1e-6)
        if samples:
            return _chosen(samples * step, kind, fastest)
        return _chosen(step, f"sample_{kind}", fastest)
    seconds = _settles(ControlEnv(model, task, usual), x, u)
    if (wanted := seconds / LONGEST) > usual * (1 + 1e-6):  # the least multiple of a sample, or number of two digits
        unit = step or _two_digits(wanted)
        samples = math.ceil(wanted / unit - 1e-6)
        slow = unit * (samples if samples * unit <= longest else math.floor(longest / unit + 1e-6))
        if slow > usual:
            return _chosen(slow, "settles", seconds)
    if usual < PERIOD - step:
        return _chosen(usual, "samples")
    alike = math.isclose(usual, PERIOD, rel_tol=1e-6)
    return usual, None if alike else note("control.sampled", seconds=usual, wanted=PERIOD, step=step)


def as_planned(task: Tracking, model: SindyModel, log: Source | None) -> Tracking:
    """Return a task as a model is planned for: from where the log mostly was, with inputs that it has tried.

    Args:
        task: The task.
        model: The fitted model.
        log: Its log.
    """
    if model.followers:
        task = task.following(model.followers)
    if log is None:
        return task
    data = log.with_states_of(model).training
    return task.as_logged(_typical(data, model), logged_input_ranges(model, data.u))


def _places(model: SindyModel, task: Tracking, log: Source | None) -> tuple[Tensor, Tensor]:
    """Return states `(n, n_x)` and inputs `(n, n_u)` at which a model is looked at.

    The first place is where the log mostly was: often at rest, where dry friction hides what swings. The others are
    places of the log in even steps of time. Without a log there is one, where episodes begin.
    """
    if log is None:
        return task.start_ends.double().mean(0, keepdim=True), torch.zeros(1, model.signature.n_u, dtype=torch.float64)
    data = log.with_states_of(model).training
    middle, usual = _typical(data, model).mean(0), data.u.double().median(0).values
    seen = reconstruct(data, rate_states(model.library, model.constraints)).x
    rows = torch.linspace(0, len(data) - 1, PLACES + 2).round().long()[1:-1].unique()
    hidden = data.x.isnan().all(0) & (seen == 0).all(0)  # and no rate of what is seen
    x = torch.where(hidden, middle, seen[rows])
    return torch.cat([middle.unsqueeze(0), x]), torch.cat([usual.unsqueeze(0), data.u[rows].double()])


def _settles(env: ControlEnv, x: Tensor, u: Tensor, share: float = SETTLED) -> float:
    """Return how long outputs take to settle within a share of a step under a linear regulator [s], 0 without one."""
    # Linear as at the middle rest, or the median of the places if less: friction holds a plant as if it moved slowly.
    # A policy that begins as a regulator sees the end of a motion whatever the window.
    rests = find_task_equilibria(env)
    if rests is None or not len(rests) or choose_plan_settings(env, rests).warm_start:
        return 0.0
    assert isinstance(env.task, Tracking)
    moved, k, extents = rests.moved, rests.middle(), torch.full((len(rests.moved),), math.inf, dtype=torch.float64)
    extents[env.task.outputs] = env.task.boxes()
    away, q = (rests.x - rests.x[k])[:, moved], squares_of(env.task)[moved]
    places = torch.cat([rests.x[k : k + 1], x.double()]), torch.cat([rests.u[k : k + 1], u.double()])
    found = []
    for a, b in zip(*slopes(env.system, *places), strict=True):
        law = regulated(a[moved][:, moved], b[moved], env.dt, q, env.system.step)
        if law is None:
            found.append(math.nan)
            continue
        # When outputs stay within the share of what they are at first, in periods: slow modes that outputs do not show,
        # as a wall behind air whose temperature is held, do not count.
        end, x, power = -math.log(share) * BEYOND * law.slowest, away, law.closed.mT
        sizes, times, step, period = [], [], 1, 0
        while period <= end:
            for _ in range(FINE):
                sizes.append((x / extents[moved]).abs().amax())
                times.append(period := period + step)
                x = x @ power
            power, step = power @ power, 2 * step
        outside = (torch.stack(sizes) > share * sizes[0]).nonzero()
        found.append(float(times[int(outside.amax())]) if len(outside) else 0.0)
    seconds = env.dt * torch.tensor(found, dtype=torch.float64)
    return float(seconds[0].fmin(seconds[1:].nanmedian()).nan_to_num(nan=0.0))


def _two_digits(seconds: float) -> float:
    return 10.0 ** (math.floor(math.log10(seconds)) - 1)


def _chosen(seconds: float, cause: str, value: float = 0.0) -> tuple[float, Finding]:
    return seconds, note("control.period", seconds=seconds, cause=cause, value=value, ahead=LONGEST)


def _typical(data: Transitions, model: SindyModel) -> Tensor:
    """Return where a log mostly was, `(2, n_x)`: zero of states that pass through it, of others the median.

    A state that follows an input may be wherever the log had it, and zero, where inputs are before a flight; one that
    follows a measured state as far from that as in the log. Other states that were not measured are zero.
    """
    x = data.x.double()
    middle = x.nanmedian(0).values.nan_to_num(nan=0.0)
    middle[((x <= 0).any(0)) & ((x >= 0).any(0))] = 0.0
    ends = middle.expand(2, -1).clone()
    for place, (low, high) in lag_state_ranges(model, data).items():
        ends[:, place] = torch.tensor([low, high]).double()
    return ends
