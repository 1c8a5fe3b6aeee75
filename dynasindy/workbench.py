"""From a log to a controller and to what it will do: `read`, `identify`, `plan`, `forecast`; `load` a saved one.

The speed of a cart follows its motor with a time constant of 0.5 s, sampled every 0.05 s, without noise:

>>> import dynasindy, numpy
>>> u, speed = numpy.sin(numpy.arange(300) // 10), numpy.zeros(300)
>>> for k in range(299):
...     speed[k + 1] = u[k] + numpy.exp(-0.1) * (speed[k] - u[k])
>>> rows = numpy.column_stack((0.05 * numpy.arange(300), speed, u))
>>> numpy.savetxt("log.csv", rows, delimiter=",", header="time [s],speed [m/s],u", comments="")
>>> log = dynasindy.read("log.csv")
>>> model = dynasindy.identify(log)
>>> print(*model.equations())
speed' = -2 speed + 2 u
>>> controller = dynasindy.plan(model, {"speed": (-0.5, 0.5)}, log=log, updates=60)  # without it, as many as suit
>>> print(dynasindy.forecast(controller, model, log).summary())
PREDICTED on 3 models fitted to data that the plan never saw (no plant was moved): CONTROLLED: ...
>>> controller.reset()
>>> u = controller.act({"speed": 0.1}, {"speed": 0.3})  # once per control period: measured, wanted

Nothing is printed while they work; `with dynasindy.Progress():` around them shows on standard error what is under way.
`train.py data=csv` calls the same and writes everything down; `train.py` alone has a plant in the loop.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from dynasindy.agents import Actor
from dynasindy.control import Controller, Observer
from dynasindy.control.controller import ControlSetup, IntegralAction, acting
from dynasindy.control.period import as_planned, suited_period
from dynasindy.envs import Channel, ControlEnv, RandomStep, Sensors, Tracking, TrackingReward
from dynasindy.evaluation.forecast import Forecast
from dynasindy.evaluation.metrics import to_text
from dynasindy.evaluation.scenarios import Policy, Scenario, step_references
from dynasindy.evaluation.tracking_criteria import WITHIN
from dynasindy.findings import Finding, FindingError, wrong
from dynasindy.identification.forecast_errors import forecast_errors, predict_from
from dynasindy.identification.recording_diagnostics import (
    low_signal_states,
    resolution,
    resolutions,
    samples_of,
    sensor_resolution,
)
from dynasindy.identification.source import Source, rates_of
from dynasindy.identification.verdict import (
    dry_friction,
    inputs_beyond_log,
    linear_better,
    require_controlled,
    runs_away,
    shortcoming,
    targets_beyond_log,
    what_to_leave_out,
)
from dynasindy.limits import one_thread
from dynasindy.planning import GradientPlanning
from dynasindy.planning.plan_settings import LONGEST, find_task_equilibria, unheld
from dynasindy.progress import reporting_as
from dynasindy.safe_io import checked
from dynasindy.sentences import lines
from dynasindy.sindy import Refinement, SindyModel
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.library import Feature, Library
from dynasindy.sindy.reconstruction import rate_states
from dynasindy.sindy.shooting import STABLE
from dynasindy.systems import Diverged, System
from dynasindy.systems.transitions import Transitions

FINE = 5
"""Runge-Kutta steps of a predicted control period."""
FLOWN = 64
"""Targets that are flown to where no scenario is given."""
MOST_ROWS = 4000
"""Rows of a log, at most, whose pushes models are flown under: ten samples each of the periods of a flight."""
STATIC_FRICTION = 2.0
"""Friction at rest by that in motion, at most: one to two (Armstrong-Helouvry, Dupont and Canudas de Wit 1994)."""
SHARPER, STEPS, MOST_STEPS = 10.0, 100, 1000
"""How much sharper than in the fit friction changes its sign, at most; steps of a control period that show it."""
HALVES = 2
"""Stretches of a log that a model is fitted to again, to see what the log leaves open."""


@one_thread()
@checked
def plan(
    model: SindyModel,
    task: Tracking | Mapping[str, tuple[float, float]],
    log: Source | None = None,
    sensors: Sensors | None = None,
    dt: float | None = None,
    seed: int = 0,
    **settings: Any,
) -> Controller:
    """Train a controller by the gradient through a model; no plant is moved.

    With a log, the functions of the model are fitted to each half of it, too, and the controller is planned on all
    three models, which spans what the log leaves open.

    Args:
        model: Model of the plant.
        task: Outputs to hold, each with the lower and upper end of its targets; or a task.
        log: Log of the plant, from which the controller's observer learns its noise levels; needed with sensors.
        sensors: What will be measured in flight; if omitted, what the log shows. Without a log all states.
        dt: Control period [s]. If omitted it is the least of 0.05 s, ten samples of the log, and a fifth of the model's
            fastest oscillation that is lightly damped, as a multiple of the log's sampling time; or longer, where the
            outputs would not settle within the control periods that a plan looks ahead.
        seed: Seed of networks, references and starts.
        **settings: Settings of `GradientPlanning`, such as `updates`.

    Returns:
        The controller, with an observer where one is needed.

    Raises:
        ValueError: The task or the log does not fit the model, an output depends on no input, or an observer has no log
            to learn from, which a model whose inputs act late needs; or no policy has a finite imagined return for
            targets far beyond the log.
        Diverged: The model explodes, or no policy has a finite imagined return.
    """
    if not isinstance(task, Tracking):
        task = tracking_task(model, task)
    if log is None and model.delay:
        raise ValueError(
            f"the model's inputs act {model.delay:.3g} s late, which only an observer makes up for; give its log, too: "
            "log= in Python, data=csv data.path=FILE on the command line"
        )
    require_controlled(model, task.output_names)
    if log is not None:
        log = log.with_states_of(model)
    task = as_planned(task, model, log)
    dt = dt or suited_period(model, task, log)[0]
    # A motion that is fast against the period, as that of a current, makes longer steps of the observer unstable.
    setup = ControlSetup(task, dt, model.substeps(dt, STABLE), model.stops)
    if log is not None and sensors is None:
        sensors = _sensors_of(log, model)
    observer = None if sensors is None else _watching(model, sensors, setup, log)
    env = ControlEnv(model, task, setup.dt, setup.substeps, seed=seed)
    others = [] if log is None else _refits(model, log.training, HALVES, "the log")
    actor = Actor(task.n_o, model.signature.n_u, seed=seed)
    try:
        GradientPlanning(env, actor, others=others, seed=seed, **settings).plan()
    except Diverged as error:
        for far in targets_far_off(model, task, log):  # where the equations may well explode
            raise FindingError(far.code, **far.values) from error
        raise
    return Controller(actor.deployed, setup, observer)


def refit_shortage(model: SindyModel, log: Source | None) -> Finding | None:
    """Return that a log keeps too little of itself to fit its model again, so that no forecast can promise anything.

    Args:
        model: Model that was identified from it.
        log: The log; nothing is lacking of none, nor of one that was not to keep anything.
    """
    if log is None or not len(log.validation):
        return None
    samples, functions = len(log.validation) // HALVES, int((model.coefficients != 0).any(-1).sum())
    return wrong("forecast.short_log", samples=samples, functions=functions) if samples < functions else None


def targets_far_off(model: SindyModel, task: Tracking, log: Source | None) -> list[Finding]:
    """Return which targets lie so far beyond a log that the equations are a guess there.

    Args:
        model: The equations.
        task: The task; one without a range of targets names none.
        log: The log of the model; nothing is far from none.
    """
    if log is None or task.ends is None:
        return []
    targets = dict(zip(task.output_names, zip(*task.ends, strict=True), strict=True))
    return targets_beyond_log(model, log.training.x, targets)


def _refits(model: SindyModel, data: Transitions, stretches: int, name: str) -> list[SindyModel]:
    """Refine the functions that a model uses on equal stretches of data, if these have a sample for each function."""
    late, places = delay_inputs(data, model.delay), torch.arange(len(data))
    length, found, rows = len(data) // stretches, [], (model.coefficients != 0).any(-1)
    library, coefficients = model.library.subset(rows.nonzero().flatten().tolist()), model.coefficients[rows]
    used = model.constraints.free[rows] & (coefficients != 0)
    given = torch.where(model.constraints.free, 0.0, model.constraints.offset)[rows]
    if length < len(library) * model.stride:
        return []
    for k in range(stretches):
        member = copy.deepcopy(model)
        member.library, member.coefficients = library, coefficients.clone()
        member.constraints = replace(model.constraints, free=used, offset=given)
        member.initial, member.initial_delay = coefficients.clone(), 0.0
        # A file of an earlier version does not tell how the model was fitted.
        member.refinement = replace(model.refinement or Refinement("auto"), longest_delay=0.0)
        with reporting_as(f"fit to {name}" if stretches == 1 else f"fit to part {k + 1} of {stretches} of {name}"):
            part = (places >= k * length) & (places < (k + 1) * length)
            member.fit(late.select(part).decimate(model.stride))
        member.delay = model.delay
        found.append(member)
    return found


@one_thread()
@checked
def forecast(
    controller: Controller,
    model: SindyModel,
    log: Source | None = None,
    scenario: Scenario | None = None,
    within: float = WITHIN,
) -> Forecast:
    """Predict what a controller will do, on models fitted to data that neither it nor its model has seen.

    This is the verdict of `train.py data=csv`: nothing is promised where the model lacks something, or where flights
    leave what the log tells. Models get their inputs as late as the data say, and the policy has its integral action if
    the controller does. A controller out of a file has forgotten how long episodes are: give it a scenario, or forecast
    it before it is saved.

    Args:
        controller: The controller.
        model: The model that it was planned on, whose functions are fitted again.
        log: The log that the model was identified from; if omitted, or if none of it was kept, the model itself is
            flown, which promises nothing.
        scenario: What to fly; if omitted, 64 steps over the range of the targets, as long as the task's episodes.
        within: Mean absolute error at the end that is asked for, in target ranges.

    Returns:
        Flights of the controller on each model, and their errors.

    Raises:
        ValueError: Log or model are of another plant, or the task has no range of targets and no scenario is given.
    """
    setup = controller.setup
    if scenario is None:  # steps over the whole range of the task, as long as its episodes
        if setup.task.ends is None:
            raise ValueError("the task has no range of targets, low and high, to fly steps in; give a scenario")
        scenario = Scenario("step", step_references(*setup.task.ends, FLOWN), FLOWN, None)
    env, policy = closed_loop(controller, model, setup.task)
    rests = find_task_equilibria(env)
    never = "" if rests is None else unheld(env, rests)
    if log is None or not len(log.validation):
        own = Forecast.of([model], env, policy, scenario, controller.observer, within)
        return replace(own, in_sample=True, no_equilibrium=never)
    log = log.with_states_of(model)
    unseen = "what the plan has not seen"
    models = [fit for parts in (1, HALVES) for fit in _refits(model, log.validation, parts, unseen)]
    pushes = [_pushes(controller, model, part) for part in (log.training, log.validation)]
    known = [each for each in pushes if each is not None]
    moved = torch.cat(known) if known else None
    found = Forecast.of(models or [model], env, policy, scenario, controller.observer, within, moved)
    found = replace(found, in_sample=not models)
    if (made := _with_static_friction((models or [model])[0], controller.dt)) is not None:
        with_friction, steps = made
        env, policy = closed_loop(controller, model, setup.task, steps)
        flights = Forecast.of([with_friction], env, policy, scenario, controller.observer, within, moved).flights
        found = replace(found, static_friction=flights)
    doubts = _doubts(model, log, LONGEST * controller.dt)
    doubts += [short] if (short := refit_shortage(model, log)) else []
    if found.evaluation is not None:
        doubts += inputs_beyond_log(model, log.training.u, found.evaluation.inputs.flatten(0, -2))
    doubts += targets_far_off(model, setup.task, log)
    return replace(found, doubts=tuple(doubts), no_equilibrium=never)


def closed_loop(
    controller: Controller, system: System, task: Tracking, substeps: int = FINE
) -> tuple[ControlEnv, Policy]:
    """Return what `evaluate` needs, beside its observer, to let a controller control a plant or a model.

    Args:
        controller: The controller; it is not changed.
        system: Plant or model.
        task: Task of the controller, with references and starts of its own.
        substeps: Runge-Kutta steps of a control period, at least.

    Returns:
        Environment, and policy with its integral action.

    Raises:
        ValueError: The plant has other states or inputs.
    """
    mine, own = controller.signature, system.signature
    if (mine.state_names, mine.n_u) != (own.state_names, own.n_u):
        raise ValueError(
            f"the plant has the states {', '.join(own.state_names)} and {own.n_u} inputs, the controller "
            f"{', '.join(mine.state_names)} and {mine.n_u}; give a plant or a model with those of the controller"
        )
    setup, policy = controller.setup, controller.policy
    if controller.integral is not None:
        policy = IntegralAction(policy, setup, **controller.integral)
    env = ControlEnv(system, task, setup.dt, max(substeps, setup.substeps), dtype=torch.float64)
    return env, acting(policy, env) if controller.observer is None else policy


def _doubts(model: SindyModel, log: Source, seconds: float) -> list[Finding]:
    """Return why a model promises nothing as far as a plan looks ahead, but that a plant runs away by itself."""
    quiet = low_signal_states(log.training, rate_states(model.library, model.constraints))
    found = forecast_errors(model, log.training, log.validation)
    forecasts = found and found.without(quiet)
    if forecasts is None:
        return []
    short = shortcoming(forecasts, model.signature, min(seconds, forecasts.characteristic))
    lacking = [short] if short and not runs_away(forecasts, model.signature) else []
    lacking += [each for each in linear_better(forecasts, model.signature) if each.severity == "wrong"]
    return [*lacking, *what_to_leave_out(lacking, log, model)]


def tracking_task(model: SindyModel, targets: Mapping[str, tuple[float, float]]) -> Tracking:
    """Return the task to hold outputs at targets within their ranges.

    Args:
        model: Model of the plant; states whose rate is another state are damped.
        targets: Lower and upper end of the targets of each output [unit of the output].

    Raises:
        ValueError: There is no target, or an output does not exist.
    """
    low, high = ([float(ends[k]) for ends in targets.values()] for k in (0, 1))
    rates, reward = damped(list(targets), rates_of(model)), TrackingReward(error_weights=(4.0,))
    return Tracking(model.signature, RandomStep(low, high), list(targets), rates, reward, low=low, high=high)


def damped(outputs: Sequence[str], known: Mapping[str, str]) -> list[str]:
    """Return the rates of the outputs, whose changes cost; none where not every output has one that is known.

    Args:
        outputs: Tracked states.
        known: Equations that are known, by state.
    """
    rates = [known[name] for name in outputs if name in known]
    return rates if len(rates) == len(outputs) else []


def _sensors_of(log: Source, model: SindyModel) -> Sensors | None:
    """Return the sensors that a log shows; None of exact states, unless late inputs ask for an observer."""
    data, names = log.training, log.signature.state_names
    channels, exact, columns = {}, True, samples_of(data)
    told = map(resolution, columns) if model.step is None else resolutions(data, model).tolist()
    for name, column, finest in zip(names, columns, told, strict=True):
        step = sensor_resolution(column)
        seen = not math.isnan(finest)
        exact &= seen and finest < 1e-6 * model.signature.x_scale[names.index(name)]
        if seen:
            channels[name] = Channel(resolution=step) if step else Channel(noise=finest)
    rates = rates_of(model)
    return None if exact and not model.delay else Sensors(channels, rates, disturbance=bool(rates) or not exact)


def _pushes(controller: Controller, model: SindyModel, data: Transitions) -> Tensor | None:
    """Return what moved the plant in a recording and is not in a model, in each control period, `(T, n_x)`.

    It is None where there is no observer, as of exact states, or where too little of the recording is in one piece.
    """
    if controller.observer is None:
        return None
    part = data.longest_stretch()
    part = part.select(torch.arange(len(part)) >= len(part) - MOST_ROWS)
    late, watched, observer = delay_inputs(part, model.delay), copy.copy(model), copy.copy(controller.observer)
    watched.delay = 0.0
    observer.model, observer.dt, observer.substeps = watched, late.dt, watched.substeps(late.dt, STABLE)
    stride = round(controller.dt / late.dt)
    # Of the states that no sensor sees, the first samples tell less than those after as many as there are states.
    begins = torch.arange(late.x.shape[-1], len(late) - stride + 1, stride)
    if not len(begins):
        return None
    with suppress(Diverged):
        u, u_end = late.inputs_of(torch.arange(len(late)))
        x = observer.smooth(torch.cat([late.x[:1], late.x_next]), u if u_end is None else 0.5 * (u + u_end))
        later = begins.unsqueeze(-1) + torch.arange(stride)
        found = x[begins + stride] - predict_from(watched, late, x[begins], later)[:, -1]
        return found if bool(found.isfinite().all()) else None
    return None


def _with_static_friction(model: SindyModel, dt: float) -> tuple[SindyModel, int] | None:
    """Return a model with dry friction as it may be at rest, of which a log of motion tells little, and its steps.

    It may be up to twice as large there as in motion, and holds what a smooth function lets creep. None where there is
    no dry friction, or where it would be another function or take too many steps.
    """
    rows = sorted({k for each in dry_friction(model) for k in each})
    if not rows:
        return None
    features, coefficients = list(model.library.features), model.coefficients.clone()
    coefficients[rows] *= STATIC_FRICTION  # in all equations: what holds one part pulls at another
    steepest = max(f.frequency for k in rows for f in features[k].factors if f.function == "tanh")
    needed = dt * steepest * float(coefficients[rows].abs().sum(0).max()) / STABLE
    sharper = min(max(STEPS / needed, 1.0), SHARPER)
    if (steps := math.ceil(max(needed * sharper, STEPS))) > MOST_STEPS:
        return None
    for k in rows:
        factors = features[k].factors
        features[k] = Feature(
            tuple(replace(f, frequency=sharper * f.frequency) if f.function == "tanh" else f for f in factors)
        )
    found = copy.deepcopy(model)
    found.library, found.coefficients = Library(model.signature, features, step=model.library.step), coefficients
    return (found, steps) if len(found.library) == len(features) else None  # else two have become one


def _watching(model: SindyModel, sensors: Sensors, setup: ControlSetup, log: Source | None) -> Observer:
    """Return an observer that has learnt its process noise from a log."""
    if log is None:
        raise ValueError("sensors need an observer, and it learns its noise levels from a log; give log=")
    data = log.training
    stride = round(setup.dt / data.dt)
    if stride < 1 or abs(stride * data.dt - setup.dt) > 1e-6 * setup.dt:
        raise ValueError(f"dt is {setup.dt} s, no multiple of the log's sampling time {data.dt:.6g} s; give another")
    part = data.longest_stretch()
    periods = part.decimate(stride)
    if len(periods) < 2:
        raise ValueError(f"the longest stretch of the log has {len(part)} samples; give one of two periods or more")
    observer = Observer(model, sensors, setup)
    observer.learn(torch.cat([periods.x[:1], periods.x_next]), periods.mean_inputs)
    return observer


def log_report(model: SindyModel, prediction: Forecast) -> str:
    """Return what a user reads at the end: equations, the table of the flight that is drawn, the prediction."""
    text = ["", "Identified equations", *(f"  {equation}" for equation in model.equations()), ""]
    if prediction.evaluation is not None:
        title = f"{prediction.evaluation.title}, {prediction.place}"
        shown = prediction.evaluation
        table = to_text(shown.summary(), title, shown.state_units, shown.told_steady_seconds)
        text += [table, *lines([*shown.beyond_targets, *shown.restless]), ""]
    return "\n".join([*text, prediction.summary()])
