"""Logs of real plants: models chosen on the training log alone, the test log scored once.

The logs are not part of the project; `--data` names the folder that holds them. Where they come from, and what was
measured, stands in docs/results/README.md. Our models and the published physics are those of rigs.yaml. Beside them
stand a linear model fitted in the same way, PySINDy with the same functions at its best threshold (of the tanks with
functions of the reading and its rate, as it takes no hidden state), and the last value held.
"""

from __future__ import annotations

import argparse
import copy
import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from scipy.optimize import least_squares
from torch import Tensor

from benchmarks.common import EquationSystem, add_choices, add_output, append, commit
from benchmarks.pysindy_regression import pysindy_of
from dynasindy.safe_io import Row, read_rows, write_rows
from dynasindy.sensing import Observer, Sensors
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature, System
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions
from dynasindy.workbench import identify, read

Array = NDArray[np.float64]
Result = tuple[list[Row], list[Row]]
"""Scores, and errors over the test log."""
COLUMNS = ("rig", "model", "metric", "value", "unit", "coefficients", "delay_seconds", "cpu_seconds", "commit")
COURSES = ("rig", "model", "seconds", "error", "unit", "commit")
POINTS = 250
"""Errors of each model over the test log that are kept, evenly spread."""
FACTS = yaml.safe_load(Path(__file__).with_name("rigs.yaml").read_text())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the logs")
    add_choices(parser, "--rigs", RIGS)
    add_output(parser, "rigs")


def main(arguments: argparse.Namespace) -> None:
    """Fit and score rigs, and append a row per rig, model and metric."""
    torch.set_num_threads(1)
    for rig in arguments.rigs:
        rows, courses = RIGS[rig](arguments.data)
        append(arguments.out, COLUMNS, [{"rig": rig, **row} for row in rows])
        if courses:
            path = arguments.out.with_name(f"{arguments.out.stem}_over_time.csv")
            others = [row for row in read_rows(path) if row["rig"] != rig] if path.exists() else []
            write_rows(path, COURSES, [*others, *({"rig": rig, **row, "commit": commit()} for row in courses)])


def signature_of(facts: Mapping[str, Any]) -> Signature:
    """Return names, units and ranges that stand in rigs.yaml; the input is `u`."""
    return Signature(tuple(facts["states"]), tuple(facts["states"].values()), ("u",), tuple(facts["scale"]))


def build_model(rig: str, name: str) -> SindyModel:
    """Return a model of rigs.yaml, which is not fitted yet."""
    facts = FACTS[rig] | FACTS[rig]["models"][name]
    more = {name: facts[name] for name in ("known", "allowed", "fixed", "initial") if name in facts}
    refinement = Refinement("trajectory", **facts["refinement"])
    return SindyModel(signature_of(facts), facts["functions"], Regression("bic"), refinement, **more)


def published_physics(rig: str) -> EquationSystem:
    """Return the published physics of a rig."""
    return EquationSystem(signature_of(FACTS[rig]), **FACTS[rig]["published"])


@dataclass(frozen=True)
class Log:
    """A log as it was measured, at its own rate.

    Attributes:
        y: Measured states, `(N, n_x)`, NaN where not measured.
        u: Inputs, `(N, n_u)`.
        dt: Sampling time [s].
    """

    y: Array
    u: Array
    dt: float

    def thinned(self, by: int) -> Transitions:
        """Keep every n-th sample; of the inputs in between the mean."""
        n = (len(self.y) - 1) // by
        held = self.u[: n * by].reshape(n, by, -1).mean(1)
        return Transitions.from_trajectory(
            torch.from_numpy(self.y[: n * by + 1 : by].copy()), torch.from_numpy(held), self.dt * by
        )


def read_log_columns(path: Path) -> Mapping[str, Array]:
    """Return the columns of a log by the names in its first line."""
    with path.open(encoding="utf-8") as file:
        names = [name.split(" [")[0].strip() for name in file.readline().split(",")]
    values = np.loadtxt(path, delimiter=",", skiprows=1)
    return dict(zip(names, values.T, strict=True))


def read_log(
    path: Path, states: Mapping[int, str], n_x: int, u: Callable[[Mapping[str, Array]], Array], dt: float
) -> Log:
    """Return a log of `n_x` states, of which those at some places are columns of the file."""
    columns = read_log_columns(path)
    inputs = u(columns)
    y = np.full((len(inputs), n_x), np.nan)
    for place, name in states.items():
        y[:, place] = columns[name]
    return Log(y, inputs[:, None], dt)


def simulate(model: System, x0: Tensor, data: Transitions, substeps: int) -> Tensor:
    """Return the states of an open-loop simulation, `(N + 1, n_x)`, under the inputs as they take effect.

    Args:
        model: What is simulated, with the delay of its inputs if it has one.
        x0: State at the beginning, `(n_x,)`.
        data: Recording whose inputs and sampling time are read.
        substeps: Runge-Kutta steps in a sample.
    """
    late = delay_inputs(data, float(getattr(model, "delay", 0.0)))
    states = [x0]
    with torch.no_grad():
        for u in late.u:
            states.append(moved(model, states[-1], u, data.dt, substeps))
    return torch.stack(states)


def rms(errors: Array) -> float:
    """Return the root-mean-square of errors; infinite where one is not finite."""
    found = float(np.sqrt(np.mean(errors**2)))
    return found if np.isfinite(found) else float("inf")


def fitted(model: SindyModel, data: Transitions) -> tuple[SindyModel, Row]:
    """Fit a model, and return it with what it cost."""
    start = time.process_time()
    model.fit(data)
    return model, _facts(model, start)


def _facts(model: SindyModel, start: float) -> Row:
    print(*model.equations(), sep="\n", flush=True)
    return {
        "coefficients": int((model.coefficients[model.constraints.free] != 0).sum()),
        "delay_seconds": round(model.delay, 6),
        "cpu_seconds": round(time.process_time() - start, 1),
    }


def _row(model: str, metric: str, value: float, unit: str) -> Row:
    return {"model": model, "metric": metric, "value": _round(value), "unit": unit}


def _round(value: float) -> float:
    return float(f"{value:.4g}")


def course(model: str, errors: Array, dt: float, unit: str) -> list[Row]:
    """Return rows of errors over a log, evenly spread; one that is not finite, and those behind it, are left out.

    Args:
        model: What made them.
        errors: `(N,)`, in `unit`.
        dt: Time between two of them [s].
        unit: Of the errors.
    """
    kept = np.linspace(0, len(errors) - 1, min(len(errors), POINTS)).round().astype(int)
    kept = kept[np.isfinite(errors).cumprod().astype(bool)[kept]]
    return [
        {"model": model, "seconds": _round(dt * int(k)), "error": _round(float(errors[k])), "unit": unit} for k in kept
    ]


FIRST = 20
"""Samples at the beginning of a log from which its start state is read."""
FORCE = 100.0
"""Force of a full input of the EMPS axis [N]."""


def emps(folder: Path) -> Result:
    """Measure the EMPS axis: position over the whole test log, simulated open loop from its start [mm]."""
    logs = {
        name: read_log(folder / f"emps_{name}.csv", {0: "q"}, 2, lambda columns: columns["u_force"] / FORCE, 1e-3)
        for name in ("train", "test")
    }
    data, q, metric = logs["train"].thinned(5), logs["test"].y[:, 0], "{} simulated, RMSE"
    models: dict[str, System] = {}
    rows: list[Row] = []

    def _score(name: str, among: Sequence[str], facts: Row) -> None:
        for log in among:
            error = rms(axis_errors(models[name], logs[log]))
            rows.append(_row(name, metric.format(log), error, "mm") | facts)

    for name in FACTS["emps"]["models"]:
        models[name], facts = fitted(build_model("emps", name), data)
        _score(name, ("train", "test"), facts)
    models["pysindy"] = pysindy_of(
        build_model("emps", "ours"), data, lambda model: rms(axis_errors(model, logs["train"]))
    )
    models["published physics"] = published_physics("emps")
    for name in ("pysindy", "published physics"):
        _score(name, ("train", "test"), {})
    drawn = [name for name in models if name != "ours, held by a spring"]
    # With everything scored: what the same functions make of the test log tells whether the axis rubs as before.
    again = "ours, fitted to the test log"
    models[again], _ = fitted(build_model("emps", "ours"), logs["test"].thinned(5))
    _score(again, ("test",), {})
    for name, speed in itertools.product(("ours", again), (0.125, -0.125)):
        rows.append(_row(name, f"force at {speed} m/s", steady_force(models[name], speed), "N"))
    held = 1e3 * (q[0] - q)
    rows.append(
        _row("training log replayed", metric.format("test"), replay_rmse(logs["train"].y[:, 0], q), "mm"),
    )
    rows.append(_row("last value held", metric.format("test"), rms(held), "mm"))
    courses = [course(name, axis_errors(models[name], logs["test"]), 2 * logs["test"].dt, "mm") for name in drawn]
    return rows, [*itertools.chain(*courses), *course("last value held", held, logs["test"].dt, "mm")]


def axis_errors(model: System, log: Log) -> Array:
    """Return the errors of a simulation of the axis from its start [mm], at every second sample."""
    q = log.y[:, 0]
    # A cubic, as the axis gathers speed there: a line would find the mean speed of the samples, not the first one.
    slope, place = np.polyfit(log.dt * np.arange(FIRST), q[:FIRST], 3)[2:]
    path = simulate(model, torch.tensor([place, slope]), log.thinned(2), 2)[:, 0].numpy()
    errors: Array = 1e3 * (path - q[::2][: len(path)])
    return errors


def steady_force(model: System, speed: float) -> float:
    """Return the force [N] at which a model keeps a speed [m/s] in the middle of the axis, at 0.125 m.

    Args:
        model: States are the place [m] and the speed [m/s], the input is the force in 100 N.
        speed: What is kept.
    """
    x = torch.tensor([0.125, speed], dtype=torch.float64)
    with torch.no_grad():
        none, full = (float(model(x, torch.tensor([u], dtype=torch.float64))[1]) for u in (0.0, 1.0))
    return FORCE * none / (none - full)


def replay_rmse(before: Array, q: Array) -> float:
    """Return the RMSE [mm] if another log, in which the axis moves alike, is taken as the prediction of a log.

    Args:
        before: Places of the axis in the other log [m], `(M,)`.
        q: Places that are forecast [m], `(N,)`; they are compared as far as both logs go.
    """
    both = min(len(before), len(q))
    return 1e3 * float(np.sqrt(np.mean((before[:both] - q[:both]) ** 2)))


STEP = 2 * math.pi / 2048
"""Resolution of both encoders of the QUBE [rad]."""
HORIZONS = (20, 50)
"""Samples of 10 ms ahead: 0.2 and 0.5 s; over 1 s an error of the start state grows a million times."""
LAST = 100
"""Samples at the end of a log from which nothing is predicted."""


def qube(folder: Path) -> Result:
    """Measure the QUBE pendulum: both angles 0.2 and 0.5 s ahead, from every 0.1 s of the test log [mrad]."""
    files = {name: folder / f"qube_{name}.csv" for name in ("train_1", "train_2", "test")}
    logs = {
        name: read_log(
            file, {0: "theta", 1: "alpha"}, 4, lambda columns: np.clip(columns["u_voltage"], -10, 10) / 10, 2e-3
        ).thinned(5)
        for name, file in files.items()
    }
    train = Transitions.cat([logs["train_1"], logs["train_2"]])

    def _score(model: System) -> float:
        return _both(ahead(model, logs["train_1"], logs["train_2"])[0][0])

    models: dict[str, tuple[System, Row]] = {
        name: fitted(build_model("qube", name), train) for name in FACTS["qube"]["models"]
    }
    # What a user gets who knows nothing of the plant; the order of its states is that of the logs, rates last.
    start = time.process_time()
    default = identify(read([str(files[name]) for name in ("train_1", "train_2")]))
    print(*default.findings, sep="\n")
    models["ours by default"] = (default, _facts(default, start))
    models["published physics"] = (published_physics("qube"), {})
    models["pysindy"] = (pysindy_of(build_model("qube", "ours"), train, _score), {})
    rows: list[Row] = []
    for name, (model, facts) in models.items():
        errors, held = ahead(model, logs["train_1"], logs["test"])
        rows += [row | facts for row in ahead_rows(name, errors)]
        if name == "ours":
            rows += ahead_rows("last value held", held)
    return rows, []


def ahead(model: System, train: Transitions, test: Transitions) -> tuple[Tensor, Tensor]:
    """Return the errors of a model and of the last value held, each `(horizons, 2)` for theta and alpha, RMSE [rad].

    The states from which a prediction starts are those of a Kalman filter on the same model, which reads the angles up
    to that moment; its process noise is the one that suits the training log.

    Args:
        model: What predicts; its states are both angles and their rates, in this order.
        train: Log on which the filter is set.
        test: Log to predict, from every 0.1 s after the first half second.
    """
    names = model.signature.state_names
    channels: Any = {name: {"resolution": STEP} for name in names[:2]}
    sensors = Sensors(channels=channels, rates=dict(zip(names[:2], names[2:], strict=True)))
    delay = float(getattr(model, "delay", 0.0))
    env = cast(Any, SimpleNamespace(dt=train.dt, substeps=2, stops=None))
    if delay:
        model = copy.copy(model)
        cast(Any, model).delay = 0.0  # the filter reads inputs as they take effect
    observer = Observer(model, sensors, env)
    known, late = delay_inputs(train, delay), delay_inputs(test, delay)
    observer.learn(torch.cat([known.x, known.x_next[-1:]]), known.u)
    y = torch.cat([late.x, late.x_next[-1:]])
    with torch.no_grad():
        states = observer.follow(y, late.u)[0]
        starts = torch.arange(50, len(late) - LAST, 10)
        x, errors, held = states[starts], [], []
        for k in range(max(HORIZONS)):
            x = moved(model, x, late.u[starts + k], late.dt, 2)
            if k + 1 in HORIZONS:
                after = y[starts + k + 1, :2]
                errors.append((x[:, :2] - after).square().mean(0).sqrt())
                held.append((y[starts, :2] - after).square().mean(0).sqrt())
    return torch.stack(errors), torch.stack(held)


def ahead_rows(model: str, errors: Tensor) -> list[Row]:
    """Return a row per horizon, of both angles together and of each."""
    rows = []
    for seconds, error in zip((0.2, 0.5), errors, strict=True):
        each = {"both angles": _both(error), "theta": float(error[0]), "alpha": float(error[1])}
        rows += [_row(model, f"{of} {seconds:g} s ahead, RMSE", 1e3 * value, "mrad") for of, value in each.items()]
    return rows


def _both(error: Tensor) -> float:
    return float(error.square().mean().sqrt())


FINE = 8
"""Runge-Kutta steps in a sample of the tanks, whose sensor follows within a second."""
RIM = 10.0
"""Reading at which the sensor of the tanks ends [V]."""
FAR = 1e3
"""Reading at which a model that runs away is stopped [V]."""


def tanks(folder: Path) -> Result:
    """Measure the cascaded tanks: reading of the lower level over the whole test log, simulated from its start [V]."""
    logs = {
        name: read_log(folder / f"tanks_{name}.csv", {3: "level_2"}, 4, lambda columns: columns["u"], 4.0)
        for name in ("train", "test")
    }
    data, level = (
        {name: log.thinned(1) for name, log in logs.items()},
        {name: log.y[:, 3] for name, log in logs.items()},
    )
    models = {
        "ours": fitted(build_model("tanks", "ours"), data["train"]),
        "linear": fitted(build_model("tanks", "linear"), states_of(data["train"], [0, -1])),
        "pysindy": (pysindy_tanks(data["train"], level["train"], FACTS["tanks"]["pysindy"]), {}),
    }
    rows: list[Row] = []
    courses: list[Row] = []
    for name, (model, facts) in models.items():
        for log in logs:
            errors = reading_errors(model, data[log], level[log])
            rows.append(_row(name, f"{log} simulated, RMSE", rms(errors), "V") | facts)
        courses += course(name, errors, 4.0, "V")
    held = level["test"][0] - level["test"]
    rows.append(_row("last value held", "test simulated, RMSE", rms(held), "V"))
    return rows, [*courses, *course("last value held", held, 4.0, "V")]


def pysindy_tanks(data: Transitions, level: Array, sets: Sequence[Sequence[str]]) -> SindyModel:
    """Return PySINDy's model of the tanks: it takes no hidden state, so the rate of the reading is the second one.

    Of several sets of functions that one is taken whose error on the training log is the least.

    Args:
        data: Training log; its last state is the reading.
        level: The reading as it was measured [V], `(N + 1,)`.
        sets: Sets of functions that are tried.
    """
    signature = Signature(("reading", "rate"), ("V", "V/s"), ("u",), (10.0, 0.1))

    def _score(model: SindyModel) -> float:
        return rms(reading_errors(model, data, level))

    def _model(words: Sequence[str]) -> SindyModel:
        return SindyModel(signature, words, Regression("bic"), Refinement(), known={"reading": "rate"})

    return min((pysindy_of(_model(words), states_of(data, [-1, 0]), _score) for words in sets), key=_score)


def states_of(data: Transitions, places: list[int]) -> Transitions:
    """Return a recording of some of the states; of the tanks the last one was measured, and no other.

    Args:
        data: The recording.
        places: Columns of the states that are kept, in this order.
    """
    return replace(data, x=data.x[:, places], x_next=data.x_next[:, places])


def reading_errors(model: SindyModel, data: Transitions, level: Array) -> Array:
    """Return the errors of a simulation of the reading [V], `(N + 1,)`; its hidden states fit the first samples.

    Args:
        model: Its states are the `reading`, `float`, what the sensor makes of the lower level, and hidden ones.
        data: Recording whose inputs are read.
        level: Reading as it was measured [V], `(N + 1,)`.
    """
    names = model.signature.state_names
    reading = names.index("reading")

    def _path(start: Array, n: int) -> Array:
        part = data.select(torch.arange(len(data)) < n)
        # Of the tanks and the reading that their sensor makes of them, the latter begins where it was measured.
        seen = {"float": level[0], "reading": level[0]}
        hidden = iter(start.tolist())
        x0 = torch.tensor([seen[name] if name in seen else next(hidden) for name in names], dtype=torch.float64)
        readings: Array = simulate(model, x0, part, FINE)[:, reading].clamp_max(RIM).numpy()
        return np.clip(np.nan_to_num(readings, nan=FAR), -FAR, FAR)

    def _error(start: Array) -> Array:
        error: Array = _path(start, FIRST) - level[: FIRST + 1]
        return error

    # Within the play the reading does not move with the level: the fit begins from several places below the rim.
    lower = [level[0] - 5] if "level_2" in names else []
    starts = [[0.0]] if "rate" in names else [[upper, *lower] for upper in (2.0, 4.0, 6.0)]
    fits = (least_squares(_error, np.array(start), diff_step=1e-3) for start in starts)
    found = min(fits, key=lambda fit: float(fit.cost)).x
    errors: Array = _path(found, len(data)) - level
    return errors


RIGS: dict[str, Callable[[Path], Result]] = {"emps": emps, "qube": qube, "tanks": tanks}
"""The rigs by name."""
