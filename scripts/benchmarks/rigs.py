"""Logs of real plants: models chosen on the training log alone, the test log scored once.

The logs are not part of the project; `--data` names the folder that holds them. Where they come from, and what was
measured, stands in docs/results/README.md. Beside our models stand a linear model fitted in the same way, PySINDy with
the same functions at its best threshold (of the tanks with functions of the reading and its rate, as it takes no hidden
state), the last value held and, where there is one, the published physics.
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
from numpy.typing import NDArray
from scipy.optimize import least_squares
from torch import Tensor

from benchmarks.common import add_choices, add_output, commit, simulate
from benchmarks.pysindy_regression import pysindy_of
from dynasindy.safe_io import Row, append_rows, read_rows, write_rows
from dynasindy.sensing import Observer, Sensors
from dynasindy.sindy.delay import delay_inputs
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature, System
from dynasindy.systems.integrators import rk4
from dynasindy.systems.transitions import Transitions
from dynasindy.workbench import identify, read

MASS, VISCOUS, DRY, PUSH = 95.1089, 203.5034, 20.3935, -3.1648
"""Mass [kg], friction [N s/m] and [N], and push against the axis [N]: Janot, Gautier and Brunot, EMPS, 2019."""
FORCE = 100.0
"""Force of a full input [N]."""


def published_axis(signature: Signature) -> SindyModel:
    """Return `M v' = F - 203.5 v - 20.4 sign(v) + 3.2`, the sign as steep as that of a fitted model.

    Args:
        signature: the place q [m], the speed v [m/s] and the input u [100 N].
    """
    model = SindyModel(signature, ["1", "u", "v", "tanh(1000 v)"])
    forces = torch.tensor([-PUSH, FORCE, -VISCOUS, -DRY], dtype=torch.float64)
    place = torch.tensor([0.0, 0.0, 1.0, 0.0], dtype=torch.float64)
    model.set_coefficients(torch.stack([place, forces / MASS], 1))
    return model


def steady_force(model: System, speed: float) -> float:
    """Return the force [N] at which a model keeps a speed [m/s] in the middle of the axis, at 0.125 m.

    Args:
        model: states are the place [m] and the speed [m/s], the input is the force in 100 N.
        speed: what is kept.
    """
    x = torch.tensor([0.125, speed], dtype=torch.float64)
    with torch.no_grad():
        none, full = (float(model(x, torch.tensor([u], dtype=torch.float64))[1]) for u in (0.0, 1.0))
    return FORCE * none / (none - full)


STEP = 2 * math.pi / 2048
"""Resolution of both encoders [rad]."""
ARM, ROD, ARM_LENGTH, ROD_LENGTH = 0.095, 0.024, 0.085, 0.129
"""Masses [kg] and lengths [m] of the rotor arm and the pendulum; companion data of arXiv 2303.15318."""
MOTOR, OHMS, VOLTS, GRAVITY = 0.042, 8.4, 10.0, 9.81
"""Constant of the motor [V s/rad, N m/A], its resistance [ohm], full input [V], and gravity [m/s^2]."""
HORIZONS = (20, 50)
"""Samples of 10 ms ahead: 0.2 and 0.5 s; over 1 s an error of the start state grows a million times."""
LAST = 100
"""Samples at the end of a log from which nothing is predicted."""


class PublishedQube(System):
    """Rotary inverted pendulum by Lagrange's equations, without friction, `alpha = 0` upright.

    Args:
        signature: theta, alpha, dtheta, dalpha and u.
    """

    def __init__(self, signature: Signature) -> None:
        super().__init__(signature)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 4)`, of states `(*batch, 4)` under inputs `(*batch, 1)` in [-1, 1]."""
        _, alpha, dtheta, dalpha = x.unbind(-1)
        s, c = alpha.sin(), alpha.cos()
        torque = MOTOR * (VOLTS * u[..., 0] - MOTOR * dtheta) / OHMS
        rod = ROD * ROD_LENGTH**2
        across = 0.5 * ROD * ROD_LENGTH * ARM_LENGTH
        m11 = ARM * ARM_LENGTH**2 / 3 + ROD * ARM_LENGTH**2 + rod / 3 * s.square()
        m12, m22 = across * c, rod / 3
        b1 = torque - 2 / 3 * rod * s * c * dtheta * dalpha + across * s * dalpha.square()
        b2 = rod / 3 * s * c * dtheta.square() + 0.5 * ROD * ROD_LENGTH * GRAVITY * s
        det = m11 * m22 - m12.square()
        return torch.stack((dtheta, dalpha, (m22 * b1 - m12 * b2) / det, (m11 * b2 - m12 * b1) / det), -1)


def ahead(model: System, train: Transitions, test: Transitions) -> tuple[Tensor, Tensor]:
    """Return the errors of a model and of the last value held, each `(horizons, 2)` for theta and alpha, RMSE [rad].

    The states from which a prediction starts are those of a Kalman filter on the same model, which reads the angles up
    to that moment; its process noise is the one that suits the training log.

    Args:
        model: what predicts; its states are both angles and their rates, in this order.
        train: log on which the filter is set.
        test: log to predict, from every 0.1 s after the first half second.
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
            for _ in range(2):
                x = rk4(model, x, late.u[starts + k], late.dt / 2)
            if k + 1 in HORIZONS:
                after = y[starts + k + 1, :2]
                errors.append((x[:, :2] - after).square().mean(0).sqrt())
                held.append((y[starts, :2] - after).square().mean(0).sqrt())
    return torch.stack(errors), torch.stack(held)


Array = NDArray[np.float64]
FIRST = 20
"""Samples at the beginning of a log from which its start state is read."""
FINE = 8
"""Runge-Kutta steps in a sample of the tanks, whose sensor follows within a second."""
RIM = 10.0
"""Reading at which the sensor of the tanks ends [V]."""
FAR = 1e3
"""Reading at which a model that runs away is stopped [V]."""
LINEAR = ("1", "u", "reading", "rate")
ROOTS = ("sqrt(reading)", "rate sqrt(reading)", "u sqrt(reading)")
QUADRATIC = (*LINEAR, "u^2", "u reading", "u rate", "reading^2", "reading rate", "rate^2")
SETS = (LINEAR, (*LINEAR, ROOTS[0]), (*LINEAR, *ROOTS), QUADRATIC, (*QUADRATIC, *ROOTS, "reading^3"))
"""Sets of functions of the reading and its rate that PySINDy is tried with."""


def linear_tanks() -> SindyModel:
    """Return a linear model of the tanks, of the order of theirs; the upper level's unit is held by its flow."""
    signature = Signature(("level_1", "reading"), ("V", "V"), ("u",), (10.0, 10.0))
    return SindyModel(
        signature,
        ["1", "u", "level_1", "reading"],
        Regression("bic"),
        Refinement("trajectory", window=20, error="simulation"),
        allowed={"level_1": ["1", "u", "level_1"], "reading": ["1", "reading"]},
        fixed={"reading": {"level_1": 0.04}},
        initial={"level_1": {"u": 0.04, "level_1": -0.02}, "reading": {"reading": -0.02}},
    )


def pysindy_tanks(data: Transitions, level: Array, sets: Sequence[Sequence[str]] = SETS) -> SindyModel:
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


def rms(errors: Array) -> float:
    """Return the root-mean-square of errors; infinite where one is not finite."""
    found = float(np.sqrt(np.mean(errors**2)))
    return found if np.isfinite(found) else float("inf")


COLUMNS = ("rig", "model", "metric", "value", "unit", "coefficients", "delay_seconds", "cpu_seconds", "commit")
COURSES = ("rig", "model", "seconds", "error", "unit", "commit")
POINTS = 250
"""Errors of each model over the test log that are kept, evenly spread."""
Found = tuple[list[Row], list[Row]]
"""Scores, and errors over the test log."""
SPRING = 0.5
"""Spring that holds the EMPS axis in a simulation [1/s^2]: pieces of the training log that were held out chose it."""


@dataclass(frozen=True)
class Log:
    """A log as it was measured, at its own rate.

    Attributes:
        y: measured states, `(N, n_x)`, NaN where not measured.
        u: inputs, `(N, n_u)`.
        dt: sampling time [s].
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


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the logs")
    add_choices(parser, "--rigs", tuple(RIGS))
    add_output(parser, "rigs")


def main(arguments: argparse.Namespace) -> None:
    """Fit and score rigs, and append a row per rig, model and metric."""
    torch.set_num_threads(1)
    for rig in arguments.rigs:
        rows, courses = RIGS[rig](arguments.data)
        append_rows(arguments.out, COLUMNS, [{"rig": rig, **row, "commit": commit()} for row in rows])
        for row in rows:
            print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
        if courses:
            path = arguments.out.with_name(f"{arguments.out.stem}_over_time.csv")
            others = [row for row in read_rows(path) if row["rig"] != rig] if path.exists() else []
            write_rows(path, COURSES, [*others, *({"rig": rig, **row, "commit": commit()} for row in courses)])


def _columns(path: Path) -> Mapping[str, Array]:
    with path.open(encoding="utf-8") as file:
        names = [name.split(" [")[0].strip() for name in file.readline().split(",")]
    values = np.loadtxt(path, delimiter=",", skiprows=1)
    return dict(zip(names, values.T, strict=True))


def _fitted(model: SindyModel, data: Transitions) -> tuple[SindyModel, Row]:
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


def _by_default(paths: Sequence[Path]) -> tuple[SindyModel, Row]:
    """Return what a user gets who knows nothing of a plant, its order of states that of the logs, rates last."""
    start = time.process_time()
    model = identify(read([str(path) for path in paths]), tell=print)
    return model, _facts(model, start)


def emps(folder: Path) -> Found:
    """Measure the EMPS axis: position over the whole test log, simulated open loop from its start [mm]."""
    signature = Signature(("q", "v"), ("m", "m/s"), ("u",), (0.25, 0.15))
    # Friction grows with the speed otherwise forth than back. Powers of the speed are left out: beyond the speeds of
    # the training log they turn.
    # What rubs rubs more at one end of the screw than at the other: of parts of the training log that were simulated
    # by models of other parts, the error fell with this from 3.5 to 3.2 mm in the mean.
    words = ["1", "u", "v", "|v|", "tanh(1000 v)", "q", "q tanh(1000 v)"]
    # Ripple of the screw and friction push the axis at random: of a trajectory through the whole log they leave a
    # drift, which gain and friction would be bent to. Predictions are over 1 s.
    refinement = Refinement("trajectory", window=200, error="prediction")
    logs = {name: _axis_log(folder / f"emps_{name}.csv") for name in ("train", "test")}

    def _error(model: System, name: str) -> float:
        return rms(_axis_errors(model, logs[name]))

    def _model(functions: Sequence[str]) -> SindyModel:
        return SindyModel(signature, functions, Regression("bic"), refinement, known={"q": "v"})

    rows: list[Row] = []
    data = logs["train"].thinned(5)
    fits: dict[str, SindyModel] = {}
    tried = {"ours": _model(words), "linear": _model(["1", "u", "v", "q"]), "ours, held by a spring": _held(signature)}
    for name, model in tried.items():
        fits[name], facts = _fitted(model, data)
        rows += [
            {"model": name, "metric": f"{log} simulated, RMSE", "value": _round(_error(fits[name], log)), "unit": "mm"}
            | facts
            for log in ("train", "test")
        ]
    others = {"pysindy": pysindy_of(_model(words), data, lambda model: _error(model, "train"))}
    others["published physics"] = published_axis(signature)
    for name, other in others.items():
        rows += [_row(name, f"{log} simulated, RMSE", _error(other, log), "mm") for log in ("train", "test")]
    rivals = dict(others)
    # With everything scored: what the same functions make of the test log tells whether the axis rubs as before.
    again = "ours, fitted to the test log"
    others[again], _ = _fitted(_model(words), logs["test"].thinned(5))
    rows.append(_row(again, "test simulated, RMSE", _error(others[again], "test"), "mm"))
    for name, speed in itertools.product(("ours", again), (0.125, -0.125)):
        force = steady_force(fits["ours"] if name == "ours" else others[again], speed)
        rows.append(_row(name, f"force at {speed} m/s", force, "N"))
    q = logs["test"].y[:, 0]
    held = 1e3 * (q[0] - q)
    drawn = {"ours": fits["ours"], "linear": fits["linear"], **rivals}
    courses = [
        row
        for name, model in drawn.items()
        for row in course(name, _axis_errors(model, logs["test"]), 2 * logs["test"].dt, "mm")
    ]
    return [
        *rows,
        _row("training log replayed", "test simulated, RMSE", replay_error(logs["train"].y[:, 0], q), "mm"),
        _row("last value held", "test simulated, RMSE", rms(held), "mm"),
    ], [*courses, *course("last value held", held, logs["test"].dt, "mm")]


def _axis_log(path: Path) -> Log:
    """Return a log of the EMPS axis: its place [m], and the force in 100 N."""
    columns = _columns(path)
    y = np.full((len(columns["q"]), 2), np.nan)
    y[:, 0] = columns["q"]
    return Log(y, columns["u_force"][:, None] / 100, 1e-3)


def _axis_errors(model: System, log: Log) -> Array:
    """Return the errors of a simulation of the axis from its start [mm], at every second sample."""
    q = log.y[:, 0]
    # A cubic, as the axis gathers speed there: a line would find the mean speed of the samples, not the first one.
    slope, place = np.polyfit(log.dt * np.arange(FIRST), q[:FIRST], 3)[2:]
    data = log.thinned(2)
    path = simulate(model, torch.tensor([place, slope]), data, 2)[:, 0].numpy()
    errors: Array = 1e3 * (path - q[::2][: len(path)])
    return errors


def _held(signature: Signature) -> SindyModel:
    """Return a model whose axis a spring holds in the middle, for a simulation through the whole log.

    No such spring is in the axis. The loop in which the log was taken keeps the axis where it should be; a simulation
    has no loop, and what rubs on another day moves it ever further away, unless something holds it.
    """
    words = ["1", "u", "v", "|v|", "tanh(1000 v)", "q"]
    refinement = Refinement("trajectory", window=200, error="simulation")
    fixed = {"v": {"q": -SPRING}}
    return SindyModel(signature, words, Regression("bic"), refinement, known={"q": "v"}, fixed=fixed)


def replay_error(before: Array, q: Array) -> float:
    """Return the RMSE [mm] if another log, in which the axis moves alike, is taken as the prediction of a log.

    Args:
        before: Places of the axis in the other log [m], `(M,)`.
        q: Places that are forecast [m], `(N,)`; they are compared as far as both logs go.
    """
    both = min(len(before), len(q))
    return 1e3 * float(np.sqrt(np.mean((before[:both] - q[:both]) ** 2)))


def qube(folder: Path) -> Found:
    """Measure the QUBE pendulum: both angles 0.2 and 0.5 s ahead, from every 0.1 s of the test log [mrad]."""
    signature = Signature(
        ("theta", "alpha", "dtheta", "dalpha"), ("rad", "rad", "rad/s", "rad/s"), ("u",), (1, 0.2, 3, 3)
    )
    # What turns the arm: motor, friction, and the cable, which pulls unevenly. It moves the pendulum by cos(alpha).
    arm = ["1", "u", "theta", "theta^2", "dtheta", "tanh(20 dtheta)"]
    rod = ["cos(alpha)", *(f"{word} cos(alpha)" for word in arm[1:]), "sin(alpha)"]
    own = {"dtheta": [*arm, "sin(alpha) cos(alpha)"], "dalpha": rod}
    linear = ["1", "u", "theta", "alpha", "dtheta", "dalpha"]
    logs = {}
    for name in ("train_1", "train_2", "test"):
        columns = _columns(folder / f"qube_{name}.csv")
        y = np.full((len(columns["theta"]), 4), np.nan)
        y[:, 0], y[:, 1] = columns["theta"], columns["alpha"]
        logs[name] = Log(y, np.clip(columns["u_voltage"], -10, 10)[:, None] / 10, 2e-3).thinned(5)
    train = Transitions.cat([logs["train_1"], logs["train_2"]])

    def _model(allowed: Mapping[str, Sequence[str]]) -> SindyModel:
        # Windows of 0.1 s predict the last third of the training logs best, of both models, out of 0.08 to 0.12 s.
        refinement = Refinement("trajectory", window=10, longest_delay=0.02, error="prediction")
        words = list(dict.fromkeys(["dtheta", "dalpha", *(word for of in allowed.values() for word in of)]))
        known = {"theta": "dtheta", "alpha": "dalpha"}
        return SindyModel(signature, words, Regression("bic"), refinement, known=known, allowed=allowed)

    models: dict[str, tuple[System, Row]] = {}
    for name, allowed in (("ours", own), ("linear", {"dtheta": linear, "dalpha": linear})):
        models[name] = _fitted(_model(allowed), train)
    models["ours by default"] = _by_default([folder / f"qube_{name}.csv" for name in ("train_1", "train_2")])
    models["published physics"] = (PublishedQube(signature), {})
    models["pysindy"] = (
        pysindy_of(_model(own), train, lambda model: _together(ahead(model, logs["train_1"], logs["train_2"])[0][0])),
        {},
    )
    rows: list[Row] = []
    for name, (model, facts) in models.items():
        errors, held = ahead(model, logs["train_1"], logs["test"])
        for found, who in ((errors, name), (held, "last value held")):
            if who == name or name == "ours":
                rows += [row | (facts if who == name else {}) for row in _ahead_rows(who, found)]
    return rows, []


def _ahead_rows(model: str, errors: Tensor) -> list[Row]:
    """Return a row per horizon, of both angles together and of each."""
    rows = []
    for seconds, error in zip((0.2, 0.5), errors, strict=True):
        each = {"both angles": _together(error), "theta": float(error[0]), "alpha": float(error[1])}
        rows += [_row(model, f"{of} {seconds:g} s ahead, RMSE", 1e3 * value, "mrad") for of, value in each.items()]
    return rows


def _together(error: Tensor) -> float:
    return float(error.square().mean().sqrt())


def tanks(folder: Path) -> Found:
    """Measure the cascaded tanks: reading of the lower level over the whole test log, simulated from its start [V]."""
    # Level 2 from 5 V, the middle of what its sensor shows; `float` is what the sensor makes of it.
    signature = Signature(("level_1", "level_2", "float", "reading"), ("V",) * 4, ("u",), (10.0, 5.0, 10.0, 10.0))
    # Below some voltage the pump gives nothing; what leaves a tank goes as the root of its level; both tanks have a
    # rim, the lower one where its sensor ends, at 10 V; the sensor is curved and has two bends, as if it took a step,
    # and its reading stands still wherever the level turns, until that is beyond its play.
    pump, over, brim = "max(0, u - 0.9)", "max(0, level_1 - 7.5)", "max(0, float - 10)"
    bends = ["max(0, level_2 - -0.2)", "max(0, level_2 - 1.2)"]
    out, root, play = "sqrt(level_1)", "sqrt(level_2 - -5)", "slack(float, reading; 0.08)"
    words = ["1", "hinge(~0.9 u)", "hinge(~7.5 level_1)", out, "root(-5 level_2)", "level_2", "hinge(10 float)"]
    words += ["level_2^2", "level_2^3", "hinge(~-0.2 level_2)", "hinge(~1.2 level_2)", "float"]
    words += ["slack(float, reading; ~0.08)", "hinge(10 reading)"]
    logs = {}
    for name in ("train", "test"):
        columns = _columns(folder / f"tanks_{name}.csv")
        y = np.full((len(columns["u"]), 4), np.nan)
        y[:, 3] = columns["level_2"]
        logs[name] = (Log(y, columns["u"][:, None], 4.0).thinned(1), columns["level_2"])
    model, facts = _fitted(
        SindyModel(
            signature,
            words,
            Regression("bic"),
            Refinement("trajectory", window=20, rounds=0, error="coloured", correlated=True),
            allowed={
                "level_1": [pump, out],
                "level_2": [over, root],
                "float": ["level_2^2", "level_2^3", *bends],
                "reading": [],
            },
            # Level 1 has no unit of its own: what leaves it fills level 2, and this number sets its scale. What stands
            # above a rim is gone within a sample, and so is what the sensor is behind.
            fixed={
                "level_1": {over: -2.0},
                "level_2": {out: 0.04, brim: -1.0},
                "float": {"1": 5.0, "level_2": 1.0, "float": -1.0},
                "reading": {play: 1.0, "max(0, reading - 10)": -1.0},
            },
            initial={
                "level_1": {pump: 0.04, out: -0.036},
                "level_2": {root: -0.037, over: 1.7},
                "float": {"level_2^2": 0.12, "level_2^3": 0.01, bends[0]: 0.26, bends[1]: -0.8},
            },
        ),
        logs["train"][0],
    )
    others = {"ours": (model, facts), "linear": _fitted(linear_tanks(), states_of(logs["train"][0], [0, -1]))}
    others["pysindy"] = (pysindy_tanks(*logs["train"]), {})
    rows: list[Row] = []
    courses: list[Row] = []
    for who, (found, told) in others.items():
        for name, (data, level) in logs.items():
            errors = reading_errors(found, data, level)
            rows.append(_row(who, f"{name} simulated, RMSE", rms(errors), "V") | told)
        courses += course(who, errors, data.dt, "V")
    held = level[0] - level
    rows.append(_row("last value held", "test simulated, RMSE", rms(held), "V"))
    return rows, [*courses, *course("last value held", held, data.dt, "V")]


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


def _row(model: str, metric: str, value: float, unit: str) -> Row:
    return {"model": model, "metric": metric, "value": _round(value), "unit": unit}


def _round(value: float) -> float:
    return float(f"{value:.4g}")


RIGS: dict[str, Callable[[Path], Found]] = {"emps": emps, "qube": qube, "tanks": tanks}
"""The rigs by name."""
