"""What suits a plant: settings of planning by gradient that follow from the model's linearisation.

| setting        | follows                                                                                    |
| -------------- | ------------------------------------------------------------------------------------------ |
| window         | the slowest mode of the closed loop that a linear-quadratic regulator makes                |
| lr             | whether deviations grow without control: then smaller steps, from a held plant             |
| warm_start     | likewise, and whether the task lets an input use little of its range                       |
| patience       | whether deviations grow without control                                                    |
| substeps       | the fastest mode of the model                                                              |

Times are counted in control periods and lengths in ranges, so that a tank sampled every 2 s and a beam sampled every
0.05 s are treated alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

from dynasindy.envs import ControlEnv, Tracking
from dynasindy.planning.regulator import Regulator
from dynasindy.sindy.shooting import MOST_STEPS, substeps_for
from dynasindy.systems.equilibria import Equilibria, find_equilibria, growth, modes
from dynasindy.text import format_duration

GROWN = 30.0
"""Growth of a deviation within an episode beyond which a plant has to be held. Of the twin rotor it is 5."""
DOUBLED = math.log(2)
"""Exponent by which a deviation has doubled in an episode, from which on a plant is unstable; minus it, stable."""
REFERENCES = 64
"""References at which rests are looked for."""
LOOKED_AT = 8
"""Rests at which the growth of deviations is computed."""
TIME_CONSTANTS = 7.0
"""Time constants of the regulated plant in a window."""
WINDOW = 20
"""Windows are multiples of so many control periods, or that much shorter than an episode."""
LONGEST = 80
"""Longest window that a phase begins with; where that gains nothing, a longer one follows."""
UNTOLD = 100
"""Window where nothing tells how long what is done now matters; Pendulum-v1 is swung up by its own reward with it, and
not with 60."""
STEP = 1.0
"""Largest product of a Runge-Kutta step and a mode's rate where `substeps_for` allows so many steps; else what is
stable has to do, for a mode that fast is over within the period."""
MARGIN = 0.3
"""Share by which inputs are weaker or stronger in imagined episodes. Fits to encoders miss the strength of inputs by
some hundredths; so much beside that gives controllers a gain margin."""
NARROW = 0.25
"""Part of an input's range below which the task lets it use little."""


@dataclass(frozen=True)
class PlanSettings:
    """Settings of planning by gradient that suit a plant; the defaults are those of the twin rotor.

    Attributes:
        window: Control periods that a gradient reaches back.
        longest: Window in which the slowest motion of the regulated plant dies out, nearly an episode at most; 0 where
            nothing tells it.
        lr: Learning rate of the first phase.
        updates: Gradient updates of the first phase.
        patience: Tests in a row without improvement after which a phase ends.
        substeps: Runge-Kutta steps per imagined control period.
        warm_start: Whether the policy begins as a regulator that holds the plant.
        why: What of the plant they follow, in words.
        afar: Whether it begins by imitating ways to the rest from afar, as a swing-up.
        gain_range: Share by which inputs are weaker or stronger in imagined episodes, at most.
    """

    window: int = 60
    lr: float = 1e-2
    updates: int = 280
    patience: int = 3
    substeps: int = 1
    warm_start: bool = False
    why: str = "as for the twin rotor"
    afar: bool = False
    gain_range: float = MARGIN
    longest: int = 0


def find_task_equilibria(env: ControlEnv) -> Equilibria | None:
    """Return the rests of a model over the references of its task; None of a task that tracks none."""
    task = env.task
    if not isinstance(task, Tracking):
        return None
    generator = torch.Generator().manual_seed(0)
    start = task.initial_state(torch.Size((16,)), generator).double().mean(0)
    # References that fill the task's, which are those that it draws at the start of an episode.
    drawn = task.sample(torch.Size((8 * REFERENCES,)), generator)
    values = task.reference(drawn, torch.zeros(len(drawn), 1)).double()
    low, high = values.amin(0), values.amax(0)
    # The ends are among them: it is there that a policy knows least of what is around.
    share = (1.2 * SobolEngine(len(low), scramble=True, seed=0).draw(REFERENCES).double() - 0.1).clamp(0, 1)
    targets = low + (high - low) * share
    return find_equilibria(env.system, task.outputs, targets, start, env.dt, task.input_limits)


def choose_plan_settings(env: ControlEnv, rests: Equilibria | None, finest: int = 1) -> PlanSettings:
    """Return the settings that suit a model.

    Args:
        env: Imagined environment.
        rests: Equilibria of the model; None where its task tracks no reference, and so tells no place to linearise at.
        finest: Runge-Kutta steps of the plant per control period, which then serve the model, too.
    """
    if rests is None:
        window, substeps = min(UNTOLD, env.task.max_steps), min(finest, MOST_STEPS)
        return PlanSettings(window, 3e-3, 400, 8, substeps, why="the task has no references")
    never = unheld(env, rests)
    if not len(rests):
        return PlanSettings(why=never)
    moved, seconds, step = rests.moved, env.task.max_steps * env.dt, env.system.step
    scale = torch.tensor(env.system.signature.x_scale, dtype=torch.float64)[moved]
    places = torch.linspace(0, len(rests) - 1, min(LOOKED_AT, len(rests))).long()
    slopes = [rests.a[k][moved][:, moved] for k in places.tolist()]
    grown = max(growth(a, scale, seconds, step) for a in slopes)
    fastest = max(float(modes(a).abs().max()) for a in slopes)
    substeps = substeps_for(fastest * env.dt, STEP) if step is None else 1
    regulator, window, longest, loop = Regulator.of(env, rests), 60, 0, "no linear regulator holds it"
    if regulator is not None:
        slowest = regulator.slowest
        over = max(2 * WINDOW, WINDOW * round(TIME_CONSTANTS * min(slowest, env.task.max_steps) / WINDOW))
        # Shorter than an episode, so that every second one begins where the plant has come to.
        window, longest = min(over, LONGEST), min(over, env.task.max_steps - WINDOW)
        loop = f"under a linear regulator its slowest motion has a time constant of {slowest:.3g} control periods"
    grows, narrow = grown > GROWN, ""
    if regulator is not None and not grows:  # answers of a policy beyond what an input may use teach nothing
        limits, task = regulator.task.input_limits, regulator.task
        ends = torch.tensor(task.signature.input_limits or ((-1.0, 1.0),) * task.signature.n_u)
        share = float(((limits[1] - limits[0]) / (ends[:, 1] - ends[:, 0])).min())
        narrow = f"an input may use {100 * share:.2g} % of its range only" if share < NARROW else ""
    why = "; ".join(filter(None, (_fate(slopes, grown, seconds, step), loop, never, narrow)))
    settings = PlanSettings(window=window, substeps=substeps, warm_start=bool(narrow), why=why, longest=longest)
    return replace(settings, lr=3e-3, updates=200, warm_start=regulator is not None) if grows else settings


def unheld(env: ControlEnv, rests: Equilibria) -> str:
    """Say how many targets no input in its range holds in the model, and what one would take; empty if all are held.

    Args:
        env: Imagined environment, whose task tracks references.
        rests: Equilibria of its model.
    """
    if not len(rests.unheld):
        return ""
    signature, task = env.system.signature, env.task
    assert isinstance(task, Tracking)
    names = [signature.state_names[i] for i in task.outputs]
    would = ~rests.needed.isnan().any(-1)
    k = int(would.int().argmax())
    target = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, rests.unheld[k].tolist(), strict=True))
    inputs = zip(signature.input_names, rests.needed[k].tolist(), strict=True)
    needs = ", ".join(f"{name} = {value:.3g}" for name, value in inputs)
    such = f"such as {target}" + (f", which would take {needs}" if bool(would.any()) else "")
    held = ""
    if len(rests):
        ends = zip(names, rests.targets.amin(0).tolist(), rests.targets.amax(0).tolist(), strict=True)
        spans = ", ".join(f"{name} from {low:.4g} to {high:.4g}" for name, low, high in ends)
        held = f"; those that one holds have {spans}"
    n = len(rests.unheld)
    within = "within its limits" if task.limited else "within [-1, 1]"
    return f"in the model no input {within} was found that holds {n} of {n + len(rests)} targets, {such}{held}"


def _fate(slopes: list[Tensor], grown: float, seconds: float, step: float | None) -> str:
    """Say what becomes of a deviation that nothing controls; slopes are df/dx at some rests, `(n_x, n_x)` [1/s]."""
    fastest = max(float(modes(a, step).real.max()) for a in slopes)
    if fastest * seconds > DOUBLED:
        doubling = format_duration(math.log(2) / fastest, digits=2)
        return f"the plant is unstable, without control a deviation doubles every {doubling}"
    if grown > 2.0:
        return f"without control a deviation grows {grown:.2g} times at most in an episode"
    if fastest * seconds < -DOUBLED:
        halving = format_duration(-math.log(2) / fastest, digits=2)
        return f"the plant is stable, without control a deviation decays, at the slowest by half every {halving}"
    return "without control a deviation hardly changes in an episode"
