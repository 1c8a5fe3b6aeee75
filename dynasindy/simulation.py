"""A plant at hand: data of it in one call, `excite`, and a controller on it in one call, `simulate`.

>>> import dynasindy
>>> from dynasindy.systems import Pendulum
>>> log = dynasindy.excite(Pendulum(), amplitude=0.8)
>>> model = dynasindy.identify(log)
>>> controller = dynasindy.plan(model, {"theta": (-0.5, 0.5)}, updates=60)
>>> dynasindy.simulate(controller, Pendulum(), {"theta": 0.4})
Simulation(1 run of 20 s; error at the end: theta ... rad)
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import SkipValidation
from torch import Tensor

from dynasindy.control import Controller
from dynasindy.dyna.simulated import Simulated
from dynasindy.envs import Excitation, Multisine, Sensors, Step
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.identification.source import Source
from dynasindy.safe_io import checked
from dynasindy.systems import System
from dynasindy.text import did_you_mean, format_duration, unit_suffix
from dynasindy.workbench import closed_loop

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Targets = Mapping[str, float | Sequence[float] | Array] | Sequence[float] | Sequence[Sequence[float]] | Array
"""Where outputs are to be: by name, or in their order; several for several runs."""


@dataclass(frozen=True, repr=False)
class Simulation:
    """A controller on a plant or a model, one run for each target; in a notebook it shows its figure.

    Attributes:
        evaluation: What `dynasindy.evaluation.scenarios.evaluate` measured, with metrics and the whole trajectory.
    """

    evaluation: Evaluation

    @property
    def time(self) -> Array:
        """Times at which control periods begin, and the end of the last one, `(T + 1,)` [s]."""
        begins = self.evaluation.time
        return _array(torch.cat([begins, begins[-1:] + begins[1] - begins[0]]))

    @property
    def states(self) -> Array:
        """States of the plant at these times, `(runs, T + 1, n_x)`."""
        rows = self.evaluation.trajectory
        return _array(torch.cat([rows["state"], rows["next", "state"][:, -1:]], 1))

    @property
    def measurements(self) -> Array:
        """What the controller read at the beginning of each control period, `(runs, T, n_x)`; NaN is not measured."""
        rows = self.evaluation.trajectory
        return _array(rows["measurement"] if "measurement" in set(rows.keys()) else rows["state"])

    @property
    def inputs(self) -> Array:
        """Inputs that are held in each control period, `(runs, T, n_u)`, in [-1, 1]."""
        return _array(self.evaluation.inputs)

    @property
    def targets(self) -> Array:
        """Targets of each run, `(runs, n_r)` [units of the outputs]."""
        return _array(self.evaluation.references[:, 0])

    @property
    def steady_error(self) -> Array:
        """Mean absolute error of each output over the end of each run, `(runs, n_r)` [units of the outputs]."""
        return _array(self.evaluation.metrics["steady_state_error"])

    def __repr__(self) -> str:
        runs, worst = len(self.inputs), self.steady_error.max(0)
        errors = [
            f"{name} {e:.2g}{unit_suffix(unit)}"
            for (name, unit), e in zip(self.evaluation.units.items(), worst, strict=True)
        ]
        length = f"{runs} run{'s' if runs > 1 else ''} of {format_duration(self.evaluation.seconds)}"
        return f"Simulation({length}; error at the end: {', '.join(errors)}{' at worst' if runs > 1 else ''})"

    def plot(self, run: int = 0) -> Figure:
        """Return a figure of a run: outputs beside their targets, the other states, and inputs.

        Args:
            run: Which one.
        """
        from dynasindy.viz.response import tracking

        shown, places = self.evaluation, self.evaluation.state_order
        target = np.repeat(self.targets[run : run + 1], len(self.time), 0)
        outputs, inputs = {"controller": self.states[run][:, places]}, {"controller": self.inputs[run]}
        names = [shown.signature.state_names[k] for k in places]
        return tracking(shown.time, target, outputs, inputs, names, shown.signature)

    def _repr_png_(self) -> bytes:
        """Return the figure of the first run, which a notebook shows."""
        picture = io.BytesIO()
        self.plot().savefig(picture, format="png", dpi=72)
        return picture.getvalue()


@checked
def simulate(
    controller: Controller,
    plant: System,
    targets: SkipValidation[Targets],  # arrays of others, too
    seconds: float = 20.0,
    start: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Simulation:
    """Let a controller control a plant or a model, one run for each target, side by side.

    A controller with an observer reads the plant through its sensors, whose noise is drawn. Inputs of a model with a
    delay act as late as it says.

    Args:
        controller: The controller; it is not changed.
        plant: Plant or model, with the states and inputs of the controller.
        targets: Where each output is to be, `{"theta": 0.4}`, or `{"theta": [0.4, -0.2]}` for two runs; or numbers in
            the order of `controller.outputs`, a row for each run [units of the outputs].
        seconds: Length of each run [s].
        start: States in which runs begin; those that are not named are zero. Where the task lets episodes begin if
            omitted.
        seed: Seed of the sensors' noise and of starts that are drawn.

    Returns:
        The runs, with their metrics.

    Raises:
        ValueError: The plant has other states or inputs, a target is missing or of no output, or a start is of no
            state.
        Diverged: The plant moves to no number.
    """
    rows, task = _rows(targets, controller.outputs), controller.setup.task
    if start is not None:
        task = task.with_starts(controller.signature.start_ranges(dict(start), "start")[:1].double())
    env, policy = closed_loop(controller, plant, task)
    env.delay = float(getattr(plant, "delay", 0.0))
    scenario = Scenario("simulation", Step(rows), len(rows), seconds, seed=seed)
    return Simulation(evaluate(env, policy, scenario, controller.observer))


@checked
def excite(
    plant: System,
    duration: float | None = None,
    amplitude: float | Sequence[float] | Array = 0.5,
    offset: float | Sequence[float] | Array = 0.0,
    dt: float = 0.01,
    noise: float | dict[str, float] = 0.0,
    sensors: Sensors | None = None,
    signal: Callable[..., Excitation] = Multisine,
    seed: int = 0,
    start: Mapping[str, float] | None = None,
    **settings: Any,
) -> Source:
    """Move a simulated plant, and return what was measured, as `read` does of a log.

    Behind it the plant is moved by random held inputs for 2000 samples more: data that no fit sees, to judge on. Steps
    of the simulation are as short as the plant needs; `findings` say where none that were tried are.

    Args:
        plant: The plant.
        duration: Length of the experiment [s]; 1000 samples if omitted.
        amplitude: Half range of each input, or one for all, in [-1, 1].
        offset: Mean of each input, or one for all: what holds the plant where it is to be excited.
        dt: Time between two samples [s]; inputs are held for five of them.
        noise: Standard deviation of white noise of the measurements: one number, relative to that of each state, or by
            the name of a state in its unit.
        sensors: What is measured, how finely and how noisily; all states as they are if omitted.
        signal: What moves it: `Multisine`, `Aprbs` or `Chirp` of `dynasindy.envs`, or another `Excitation`.
        seed: Seed of signal and noise.
        start: States in which the plant begins; those that are not named are zero.
        **settings: Settings of the signal, such as `first=0.1` for a plant that may not stay by itself.

    Returns:
        The recording, as `read` returns that of a log.

    Raises:
        ValueError: A setting is not allowed.
    """
    names = [*signature(excite).parameters, "first", *signature(signal).parameters]
    names = [name for name in dict.fromkeys(names) if name not in ("plant", "settings", "common", "n_u")]
    for name, value in settings.items():
        if name not in names:
            raise ValueError(f"excite has {name}={value}; allowed are {', '.join(names)}{did_you_mean(name, names)}")
    data = Simulated(dt=dt, noise=noise, sensors=sensors, seed=seed, start=None if start is None else dict(start))
    found = data.load(plant, partial(signal, duration=duration, amplitude=amplitude, offset=offset, **settings))
    return replace(found, exact=False)  # nothing is known but what was measured, as of a log


def _rows(targets: Targets, outputs: Sequence[str]) -> list[list[float]]:
    with suppress(TypeError, ValueError):  # lists of different lengths, or no numbers
        if isinstance(targets, Mapping) and {*targets} == {*outputs}:
            targets = np.stack(np.broadcast_arrays(*(targets[name] for name in outputs)), -1)
        rows = np.atleast_2d(np.asarray(targets, float))
        if rows.ndim == 2 and rows.shape[1] == len(outputs) and np.isfinite(rows).all():
            return rows.tolist()
    raise ValueError(
        f"targets are {targets}; give a finite number for each of {', '.join(outputs)}, or as many for each run"
    )


def _array(values: Tensor) -> Array:
    found: Array = values.double().numpy()
    return found
