"""Plants that are known by a log alone, all settings at their defaults: what is foretold, and what the plant then does.

Each log is made behind sensors, without rates. `train.py data=csv` identifies, plans and forecasts; the controller that
it leaves is flown on the true plant, behind the same sensors, to targets drawn within their range.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from torch import Tensor

import dynasindy
from benchmarks.common import NAMES, EquationSystem, add_choices, add_output, add_seeds, measure_plants, run_command
from dynasindy import Controller
from dynasindy.data.headings import in_radians
from dynasindy.envs import Channel, Sensors
from dynasindy.safe_io import Row, write_csv
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, integrate

SUBSTEPS = 5
"""Runge-Kutta steps of a plant between two samples of its log."""
SMOOTH = 0.8
"""Part of a difference that the loop keeps of the one before."""
Loop = Mapping[str, tuple[float, float]]
"""Measured states, and what an input is changed by per state and per rate of it."""


@dataclass(frozen=True)
class Input:
    """An input in the unit of its actuator.

    Attributes:
        unit: Its unit.
        low: Lower end of the actuator.
        high: Upper end.
        stated: Whether the user of the plant states the ends.
    """

    unit: str = "-"
    low: float = -1.0
    high: float = 1.0
    stated: bool = True


@dataclass(frozen=True)
class Case:
    """A plant, how it is logged, and what is wanted of it.

    Attributes:
        title: What it is, and what is measured of it.
        states: Name to unit; all states of the plant, measured or not.
        rates: Formula of the rate of change of each state.
        sensors: Measured states.
        targets: Outputs, and the ends of their targets.
        known: States whose rate is another state.
        dt: Sampling time of the log [s].
        seconds: Length of the log [s].
        amplitude: Half range of the levels of each input, around `offset` [half ranges of the actuator].
        holds: Shortest and longest time for which a level is held [s].
        flight: Length of a flight [s].
        offset: Mean of each input, from the middle of its actuator [half ranges of the actuator].
        start: States that are not zero where log and flights begin.
        loop: Of each input, what it is changed by per state and per rate of it [half ranges of the actuator].
        words: Settings besides, which the user of such a plant would give.
        inputs: Inputs by name.
        let: Formulas that the rates share.
        columns: States that are logged in another unit than their own, which is it, and its size in their own.
    """

    title: str
    states: Mapping[str, str]
    rates: Mapping[str, str]
    sensors: Mapping[str, Channel]
    targets: Mapping[str, tuple[float, float]]
    dt: float
    seconds: float
    amplitude: float
    holds: tuple[float, float]
    flight: float = 10.0
    known: Mapping[str, str] = field(default_factory=dict)
    offset: float = 0.0
    start: Mapping[str, float] = field(default_factory=dict)
    loop: tuple[Loop, ...] = ()
    words: tuple[str, ...] = ()
    inputs: Mapping[str, Input] = field(default_factory=lambda: {"u": Input()})
    columns: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    let: Mapping[str, str] = field(default_factory=dict)

    @property
    def plant(self) -> EquationSystem:
        """The plant itself."""
        names, units = tuple(self.states), tuple(self.states.values())
        return EquationSystem(Signature(names, units, tuple(self.inputs), (1.0,) * len(names)), self.let, self.rates)

    @property
    def begins(self) -> Tensor:
        """State in which log and flights begin, `(n_x,)`."""
        return torch.tensor([self.start.get(name, 0.0) for name in self.states], dtype=torch.float64)

    @property
    def ends(self) -> tuple[Tensor, Tensor]:
        """Lower and upper ends of the actuators, `(n_u,)` each."""
        pairs = [(given.low, given.high) for given in self.inputs.values()]
        low, high = torch.tensor(pairs, dtype=torch.float64).unbind(-1)
        return low, high

    def record(self, seed: int) -> tuple[Tensor, Tensor]:
        """Return measurements `(T, n_x)`, NaN where there is no sensor, and inputs in their own units `(T, n_u)`.

        Args:
            seed: Seed of the inputs' levels and of the sensors' noise.
        """
        plant, rng, x = self.plant, torch.Generator().manual_seed(seed), self.begins
        sensors, (low, high), n_u = Sensors(self.sensors), self.ends, len(self.inputs)
        fed = [_Loop(loop, list(self.states), self.dt) for loop in (*self.loop, *[{}] * (n_u - len(self.loop)))]
        seen, inputs, until, level = [], [], [0] * n_u, [0.0] * n_u
        for k in range(round(self.seconds / self.dt)):
            y = sensors.read(x, plant.signature, rng)
            for i in range(n_u):
                if k >= until[i]:
                    drawn, share = torch.rand(2, generator=rng).tolist()
                    shortest, longest = self.holds
                    level[i] = 2 * drawn - 1
                    until[i] = k + max(1, round((shortest + share * (longest - shortest)) / self.dt))
            given = [self.offset + self.amplitude * level[i] + fed[i](y) for i in range(n_u)]
            share_of_range = torch.tensor(given, dtype=torch.float64).clamp(-1.0, 1.0)
            u = 0.5 * (low + high) + 0.5 * (high - low) * share_of_range
            seen.append(y)
            inputs.append(u)
            x = integrate(plant, x, u, self.dt, SUBSTEPS)[0][-1]
        return torch.stack(seen), torch.stack(inputs)


class _Loop:
    """What a simple loop of proportions and smoothed differences adds to an input.

    Args:
        loop: Its gains.
        names: Names of the states.
        dt: Sampling time [s].
    """

    def __init__(self, loop: Loop, names: list[str], dt: float) -> None:
        self.gains = torch.tensor(list(loop.values()), dtype=torch.float64).reshape(-1, 2)
        self.places, self.dt = [names.index(name) for name in loop], dt
        self.speeds = torch.zeros(len(loop), dtype=torch.float64)
        self.last: Tensor | None = None

    def __call__(self, y: Tensor) -> float:
        now = y[self.places]
        slopes = 0.0 if self.last is None else (now - self.last) / self.dt
        self.speeds, self.last = SMOOTH * self.speeds + (1 - SMOOTH) * slopes, now
        return float((self.gains * torch.stack([now, self.speeds], -1)).sum())


def read_cases(path: Path) -> dict[str, Case]:
    """Return the plants of a file, by name; numbers may be formulas of `NAMES`."""

    def _number(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: _number(of) for name, of in value.items()}
        if isinstance(value, list):
            return tuple(_number(of) for of in value)
        return float(eval(value, dict(NAMES))) if isinstance(value, str) else value

    def _case(facts: dict[str, Any]) -> Case:
        given = facts | {name: _number(facts[name]) for name in ("targets", "start", "loop") if name in facts}
        given |= _number(given.pop("log"))
        given["sensors"] = {name: Channel(**_number(of)) for name, of in facts["sensors"].items()}
        given["columns"] = {name: (unit, _number(size)) for name, (unit, size) in facts.get("columns", {}).items()}
        given["inputs"] = {name: Input(**of) for name, of in facts.get("inputs", {"u": {}}).items()}
        return Case(**given)

    return {name: _case(facts) for name, facts in yaml.safe_load(path.read_text()).items()}


CASES = read_cases(Path(__file__).with_name("logged_plants.yaml"))

COLUMNS = (
    *("plant", "seed", "foretold", "foretold_percent", "output", "error_percent", "worst_percent"),
    *("terms", "cpu_seconds", "commit"),
)
TARGETS, LAST = 8, 0.25
"""Targets that are flown to, and the part at the end of a flight over which errors are averaged."""
FAR = 1e6
"""State beyond which a flight has run away."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--plants", CASES)
    add_seeds(parser, 3)
    add_output(parser, "logs")


def main(arguments: argparse.Namespace) -> None:
    """Log, plan and fly, and append a row per output."""
    torch.set_num_threads(1)
    measure_plants(arguments, COLUMNS, measure)


def measure(name: str, seed: int) -> list[Row]:
    """Return a row per output of one plant and seed."""
    case = CASES[name]
    with tempfile.TemporaryDirectory() as folder:
        log, run = Path(folder) / "log.csv", Path(folder) / "run"
        write_log(case, log, seed)
        given = [*words(case, log), f"seed={seed}", f"folder={run}"]
        spent = run_command("train", given, Path(folder), run / "model.json")
        # Signs in the equations of a model are also those inside functions and quotients.
        terms = int(SindyModel.load(run / "model.json").coefficients.count_nonzero())
        forecast, errors = None, np.full((1, len(case.targets)), math.inf)
        if (run / "metrics.json").is_file():
            forecast = json.loads((run / "metrics.json").read_text())["prediction"]
            errors = simulate_targets(case, dynasindy.load(run), seed)
    controlled = {None: "no controller", True: "CONTROLLED", False: "NOT promised"}
    ends = [max(flight["share"].values()) if flight else math.inf for flight in (forecast or {}).get("flights", ())]
    head = {"plant": name, "seed": seed, "foretold": controlled[forecast and forecast["controlled"]]}
    head["foretold_percent"] = f"{100 * max(ends, default=math.inf):.3g}"
    worst, mean = errors.max(0), errors.mean(0)
    return [
        {
            **head,
            **{"output": output, "error_percent": f"{100 * mean[k]:.3g}", "worst_percent": f"{100 * worst[k]:.3g}"},
            **{"terms": terms, "cpu_seconds": round(spent, 1)},
        }
        for k, output in enumerate(case.targets)
    ]


def words(case: Case, log: Path) -> list[str]:
    """Return what the user of such a plant gives on the command line."""
    ends = list(zip(*case.targets.values(), strict=True))
    given = [
        f"plant.outputs=[{','.join(case.targets)}]",
        *(f"plant.{k}={list(v)}" for k, v in zip(("low", "high"), ends)),
    ]
    if case.known:
        given.append(f"plant.known={{{','.join(f'{state}:{rate}' for state, rate in case.known.items())}}}")
    if list(case.inputs) != ["u"]:
        limited = {name: f"{{name:{name},low:{of.low:g},high:{of.high:g}}}" for name, of in case.inputs.items()}
        columns = (f"{name}:{limited[name] if of.stated else name}" for name, of in case.inputs.items())
        given.append(f"data.inputs={{{','.join(columns)}}}")
    return ["data=csv", f"data.path={log}", *(word.replace(" ", "") for word in given), *case.words]


def write_log(case: Case, path: Path, seed: int) -> None:
    """Write the log of a plant: time, what its sensors measure, the input."""
    y, u = case.record(seed)
    seen = list(case.sensors)
    units = [case.columns.get(name, (case.states[name], 1.0)) for name in seen]
    sizes = torch.tensor([size for _, size in units], dtype=torch.float64)
    columns = y[:, [list(case.states).index(name) for name in seen]] / sizes
    time = case.dt * torch.arange(len(u), dtype=torch.float64).unsqueeze(-1)
    heads = ["time [s]", *(f"{name} [{unit}]" for name, (unit, _) in zip(seen, units, strict=True))]
    heads += [f"{name} [{given.unit}]" for name, given in case.inputs.items()]
    write_csv(path, heads, torch.cat([time, columns, u], -1).tolist())


def simulate_targets(case: Case, controller: Controller, seed: int) -> NDArray[np.float64]:
    """Return the errors at the end of each flight [target ranges], infinite where it was lost, `(TARGETS, n_outputs)`.

    A flight is lost where the plant runs away, and where the numbers of the controller grow beyond all limits.
    An output that is held at one value has the range of the state in the controller's log.

    Args:
        case: The plant.
        controller: Flies it.
        seed: Seed of targets and of the sensors' noise.

    Raises:
        ValueError: The controller does not fit the plant's names.
    """
    plant, sensors, (least, most) = case.plant, Sensors(case.sensors), case.ends
    rng = torch.Generator().manual_seed(1000 + seed)
    low, high = torch.tensor(list(case.targets.values()), dtype=torch.float64).unbind(-1)
    outputs = [list(case.states).index(name) for name in case.targets]
    ranges = torch.tensor([controller.signature.x_scale[controller.signature.state_index(n)] for n in case.targets])
    ranges = torch.where(high > low, high - low, ranges.double())
    # A log in degrees is read in radians.
    own = dict(zip(controller.signature.state_names, controller.signature.state_units, strict=True))
    units = {name: case.states[name] for name in case.sensors}
    sizes = {name: 1.0 if own.get(name, unit) == unit else in_radians(unit)[1] for name, unit in units.items()}
    targets = low + (high - low) * torch.rand(TARGETS, len(low), generator=rng, dtype=torch.float64)
    # Side by side, as a plant in torch moves eight states at the cost of one.
    pilots = [copy.deepcopy(controller) for _ in range(TARGETS)]
    for pilot in pilots:
        pilot.reset()
    x, errors = case.begins.expand(TARGETS, -1), torch.zeros_like(targets)
    away = torch.zeros(TARGETS, 1, dtype=torch.bool)
    periods = round(case.flight / controller.dt)
    substeps = SUBSTEPS * max(1, round(controller.dt / case.dt))
    last = math.ceil((1 - LAST) * periods)
    for k in range(periods):
        y = sensors.read(x, plant.signature, rng)
        seen = [{name: size * float(row[list(case.states).index(name)]) for name, size in sizes.items()} for row in y]
        acts = np.zeros((TARGETS, len(case.inputs)))
        for i, (pilot, *given) in enumerate(zip(pilots, seen, targets.tolist(), strict=True)):
            if not away[i]:
                try:
                    acts[i] = pilot.act(*given)
                except ValueError as error:
                    if error.__cause__ is None:  # then it is no number beyond all limits, but a name that does not fit
                        raise
                    away[i] = True
        u = torch.from_numpy(controller.signature.in_own_units(acts)).clamp(least, most)
        x = integrate(plant, x, u, controller.dt, substeps)[0][..., -1, :]
        away |= ~(x.abs() < FAR).all(-1, keepdim=True)
        x = torch.where(away, case.begins, x)  # what has run away is lost; where it goes on does not matter
        if k >= last:
            errors += (x[:, outputs] - targets).abs() / (periods - last)
    return torch.where(away, math.inf, errors / ranges).numpy()
