"""Plants that are known by a log alone, all settings at their defaults: what is foretold, and what the plant then does.

Each log is made behind sensors, without rates. `train.py data=csv` identifies, plans and forecasts; the controller that
it leaves is flown on the true plant, behind the same sensors, to targets drawn within their range.
"""

from __future__ import annotations

import copy
import json
import math
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import dynasindy
from benchmarks import logged, unseen_plants
from benchmarks.commit import commit
from benchmarks.logged import SUBSTEPS, Case, Input
from benchmarks.training import called, over_seeds
from dynasindy import Controller
from dynasindy.data.units import in_radians
from dynasindy.safe_io import Row, write_csv
from dynasindy.sensing import Sensors
from dynasindy.sindy import SindyModel
from dynasindy.systems import integrate

COLUMNS = (
    *("plant", "seed", "foretold", "foretold_percent", "output", "error_percent", "worst_percent"),
    *("terms", "cpu_seconds", "commit"),
)
CASES = {**logged.CASES, **unseen_plants.CASES}
TARGETS, LAST = 8, 0.25
"""Targets that are flown to, and the part at the end of a flight over which errors are averaged."""
FAR = 1e6
"""State beyond which a flight has run away."""


def main(arguments: Namespace) -> None:
    """Log, plan and fly, and append a row per output."""
    torch.set_num_threads(1)
    over_seeds(arguments, COLUMNS, measure)


def measure(name: str, seed: int) -> list[Row]:
    """Return a row per output of one plant and seed.

    Raises:
        RuntimeError: The command left no model.
    """
    case = CASES[name]
    with tempfile.TemporaryDirectory() as folder:
        log, place = Path(folder) / "log.csv", Path(folder) / "run"
        write_log(case, log, seed)
        given = [*words(case, log), f"seed={seed}", f"folder={place}"]
        spent, complaint = called("train", given, Path(folder))
        if not (place / "model.json").is_file():
            raise RuntimeError(f"train.py left no model for {name}, seed {seed}: {complaint}")
        terms = terms_of(place / "model.json")
        found, errors = None, np.full((1, len(case.targets)), math.inf)
        if (place / "metrics.json").is_file():
            found = json.loads((place / "metrics.json").read_text())
            errors = flown(case, dynasindy.load(place), seed)
    return rows_of(name, seed, found, errors, terms, spent)


def terms_of(path: Path) -> int:
    """Count the terms of a saved model: signs in its equations are also those inside functions and quotients."""
    return int(SindyModel.load(path).coefficients.count_nonzero())


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
        columns = (_column(name, of) for name, of in case.inputs.items())
        given.append(f"data.inputs={{{','.join(columns)}}}")
    return ["data=csv", f"data.path={log}", *(word.replace(" ", "") for word in given), *case.words]


def _column(name: str, given: Input) -> str:
    """Return the column of an input, with the ends of its actuator if the user tells them."""
    return f"{name}:{{name:{name},low:{given.low:g},high:{given.high:g}}}" if given.told else f"{name}:{name}"


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


def flown(case: Case, controller: Controller, seed: int) -> NDArray[np.float64]:
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
    ranges, sizes = torch.where(high > low, high - low, ranges.double()), sizes_of(case, controller)
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
                acts[i], away[i] = _act(pilot, *given)
        u = torch.from_numpy(controller.signature.in_own_units(acts)).clamp(least, most)
        x = integrate(plant, x, u, controller.dt, substeps)[0][..., -1, :]
        away |= ~(x.abs() < FAR).all(-1, keepdim=True)
        x = torch.where(away, case.begins, x)  # what has run away is lost; where it goes on does not matter
        if k >= last:
            errors += (x[:, outputs] - targets).abs() / (periods - last)
    return torch.where(away, math.inf, errors / ranges).numpy()


def sizes_of(case: Case, controller: Controller) -> dict[str, float]:
    """Return what 1 of each sensor's unit is in the unit that a controller reads: a log in degrees is read in radians.

    Args:
        case: The plant.
        controller: Flies it.
    """
    own = dict(zip(controller.signature.state_names, controller.signature.state_units, strict=True))
    units = {name: case.states[name] for name in case.sensors}
    return {name: 1.0 if own.get(name, unit) == unit else in_radians(unit)[1] for name, unit in units.items()}


def _act(pilot: Controller, seen: dict[str, float], target: list[float]) -> tuple[NDArray[np.float64] | float, bool]:
    """Return the inputs, and whether none follow as the numbers of the controller have grown beyond all limits.

    Raises:
        ValueError: A name or a number is missing in what the controller was given, or does not exist.
    """
    try:
        return pilot.act(seen, target), False
    except ValueError as error:
        if error.__cause__ is None:  # then it is no number beyond all limits, but a name that does not fit
            raise
        return 0.0, True


def rows_of(
    name: str, seed: int, metrics: dict[str, Any] | None, errors: NDArray[np.float64], terms: int, seconds: float
) -> list[Row]:
    """Return a row per output.

    Args:
        name: Name of the plant.
        seed: Seed of log, plan and flights.
        metrics: What `metrics.json` holds; None if the command ended without a controller.
        errors: What `flown` returned.
        terms: How many terms the equations have.
        seconds: CPU time of the command [s].
    """
    prediction: dict[str, Any] = metrics["prediction"] if metrics else {"controlled": False, "score": None}
    score = prediction["score"]
    foretold = "CONTROLLED" if prediction["controlled"] else "NOT promised"
    return [
        {
            **{"plant": name, "seed": seed, "foretold": foretold if metrics else "no controller"},
            "foretold_percent": "inf" if score is None else f"{100 * score:.3g}",
            **{"output": output, "error_percent": f"{100 * errors[:, k].mean():.3g}"},
            "worst_percent": f"{100 * errors[:, k].max():.3g}",
            "terms": terms,
            **{"cpu_seconds": round(seconds, 1), "commit": commit()},
        }
        for k, output in enumerate(CASES[name].targets)
    ]
