"""Logs of real plants: models chosen on the training log alone, beside simple ones, the test log scored once.

The logs are not part of the project; `--data` names the folder that holds them. Where they come from, and what was
measured, stands in docs/results/README.md. A rig is an entry of rigs.yaml: what is kept to score on, the horizons, and
columns where the file does not say them. `ours` is what `identify` makes of `read` by default; simple models are those
of opponents.py.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import yaml
from torch import Tensor

from benchmarks.common import add_choices, add_output, append
from benchmarks.opponents import (
    FIRST,
    KEPT,
    Array,
    Arx,
    Fit,
    HeatedBodies,
    Held,
    InverseDynamics,
    Log,
    Places,
    Predictor,
    StateSpace,
    choose,
)
from benchmarks.pysindy_regression import pysindy_of
from benchmarks.surrogate_rig import DRY, DT, Rig, record_closed_loop
from dynasindy.data.headings import CLOCKS, SECONDS, in_radians, plain_heading, split_unit
from dynasindy.identification.forecast_errors import predict_ahead
from dynasindy.identification.identify import identify, read
from dynasindy.identification.source import Source
from dynasindy.safe_io import Row, write_csv
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.named_libraries import polynomial
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import WHOLE, Signature
from dynasindy.systems.transitions import Transitions

COLUMNS = ("rig", "model", "metric", "value", "unit", "coefficients", "cpu_seconds", "commit")
STARTS, TRIED = 200, 40
"""Samples from which predictions are scored, and from which models are chosen, at most."""
FACTS: dict[str, dict[str, Any]] = yaml.safe_load(Path(__file__).with_name("rigs.yaml").read_text())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the logs")
    add_choices(parser, "--rigs", FACTS)
    add_choices(parser, "--models", MODELS)
    add_output(parser, "rigs")


def main(arguments: argparse.Namespace) -> None:
    """Fit and score models of rigs, and append a row per rig, model and metric."""
    torch.set_num_threads(1)
    for rig in arguments.rigs:
        with tempfile.TemporaryDirectory() as folder:
            case = Case.of(rig, arguments.data, Path(folder))
            for model in case.models(arguments.models):
                append(arguments.out, COLUMNS, score(case, model))


@dataclass(frozen=True)
class Case:
    """A rig, its logs, and what is scored.

    Attributes:
        rig: Its name.
        facts: Its entry in rigs.yaml.
        files: Of the training log, or the one of which the last part is kept.
        states: What is measured, by name, with the unit of the file.
        training: Logs to fit, of every n-th sample.
        test: Log to score.
        begin: Sample of it from which on it is scored.
    """

    rig: str
    facts: Mapping[str, Any]
    files: Sequence[Path]
    states: Mapping[str, str]
    training: Sequence[Log]
    test: Log
    begin: int

    @classmethod
    def of(cls, rig: str, data: Path, made: Path) -> Case:
        """Read the logs of a rig from the folder of the data, or make them in another folder."""
        facts = FACTS[rig]
        if "made" in facts:
            data = made
            write_surrogate(made / f"{rig}.csv", **facts["made"])
        by, kept = facts.get("thin", 1), facts.get("kept")
        files = [data / f"{rig}.csv"] if kept else sorted(data.glob(f"{rig}_train*.csv"))
        logs, states = zip(*(read_log(file, facts.get("columns", {})) for file in files), strict=True)
        thin = [log.thinned(by) for log in logs]
        if kept:
            begin = round((1 - kept) * len(thin[0]))
            return cls(rig, facts, files, states[0], [thin[0].part(0, 1 - kept)], thin[0], begin)
        test = read_log(data / f"{rig}_test.csv", facts.get("columns", {}))[0].thinned(by)
        return cls(rig, facts, files, states[0], thin, test, 0)

    def models(self, wanted: Sequence[str]) -> list[str]:
        """Return which of the models it has; some are of one rig alone."""
        return [name for name in wanted if name not in SPECIAL or name in self.facts.get("models", ())]

    def steps(self, seconds: float) -> int:
        """Return a horizon in samples."""
        return max(1, round(seconds / self.test.dt))

    def cost(self, model: Predictor) -> float:
        """Return the mean logarithm of a model's errors on the last quarter of the training logs, in their spreads."""
        found = []
        for log in self.training:
            begin, spread = round((1 - KEPT) * len(log)), log.y.std(0)
            found += [errors_ahead(model, log, begin, self.steps(h), TRIED)[:, -1] for h in self.facts["horizons"]]
            found += [errors_simulated(model, log, begin)] if self.facts.get("simulated") else []
        sizes = [rms(errors / spread) for errors in found if len(errors)]
        return float(np.mean(np.log(np.clip(sizes, 1e-9, 1e3)))) if sizes else math.inf


def read_log(path: Path, columns: Mapping[str, Any]) -> tuple[Log, dict[str, str]]:
    """Return a log at even times, and the units of what is measured by its name.

    Args:
        path: The file.
        columns: Names of `time`, `states` and `inputs`, as far as the headings do not say them.
    """
    table = pd.read_csv(path, skipinitialspace=True)
    split = [split_unit(plain_heading(heading.strip())) for heading in table.columns]
    units, table.columns = dict(split), [name for name, _ in split]
    clock = columns.get("time") or next(name for name in units if name.lower() in CLOCKS)
    inputs = columns.get("inputs") or [name for name in units if name.split("_")[0] in ("u", "input")]
    states = columns.get("states") or [name for name in units if name not in (clock, *inputs)]
    seconds = SECONDS.get(units[clock] or clock.rpartition("_")[2], 1.0)
    t = seconds * table[clock].to_numpy(np.float64)
    y, u = table[states].to_numpy(np.float64), table[inputs].to_numpy(np.float64)
    dt, apart = float(t[-1] - t[0]) / (len(t) - 1), np.diff(t)
    if np.abs(apart - dt).max() > 0.1 * dt:  # not even
        dt = float(np.median(apart))
        even = t[0] + dt * np.arange(round((t[-1] - t[0]) / dt) + 1)
        y = np.stack([np.interp(even, t, column) for column in y.T], -1)
        u = u[np.searchsorted(t, even + 0.5 * dt, "right") - 1]
    return Log(y, u, dt), {name: units[name] for name in states}


def errors_ahead(model: Predictor, log: Log, begin: int, steps: int, most: int = STARTS) -> Array:
    """Return errors up to some samples ahead, `(S, steps, n_y)`, NaN before `begin`.

    Predictions start behind it; where that leaves them less than their own length, their last samples lie behind it.
    """
    last = len(log) - 1 - steps
    first = max(FIRST, begin if last >= begin + steps else begin - steps)
    starts = np.unique(np.linspace(first, last, most).round().astype(np.int64)) if last >= first else np.zeros(0, int)
    if not len(starts):
        return np.zeros((0, steps, log.y.shape[1]))
    later = starts[:, None] + np.arange(1, steps + 1)
    errors = np.nan_to_num(model.predict(log, starts, steps), nan=np.inf) - log.y[later]
    errors[later < begin] = np.nan
    return errors


def errors_simulated(model: Predictor, log: Log, begin: int) -> Array:
    """Return the errors of a simulation to the end of a log, `(T, n_y)`; its first samples tell the states."""
    first = max(FIRST, begin)
    path = model.predict(log, np.array([first]), len(log) - 1 - first)[0]
    return np.nan_to_num(path, nan=np.inf) - log.y[first + 1 :]


def rms(errors: Array) -> float:
    """Return the root-mean-square of errors, NaN left out; infinite where one is."""
    found = float(np.sqrt(np.nanmean(errors**2)))
    return found if np.isfinite(found) else float("inf")


def score(case: Case, name: str) -> list[Row]:
    """Fit a model and return its scores on the test log."""
    start = time.process_time()
    with np.errstate(all="ignore"):
        model = MODELS[name](case)
        spent = round(time.process_time() - start, 1)
        found: dict[str, Array] = {}
        for h in case.facts["horizons"]:
            errors = errors_ahead(model, case.test, case.begin, case.steps(h))
            found |= {f"{h:g} s ahead": errors[:, -1], f"over {h:g} s": errors}
        if case.facts.get("simulated"):
            found["test simulated"] = errors_simulated(model, case.test, case.begin)
        facts = {"rig": case.rig, "model": name, "coefficients": model.coefficients, "cpu_seconds": spent}
        rows = []
        found = {metric: errors for metric, errors in found.items() if len(errors)}  # the log may be too short
        for (metric, errors), (group, of) in product(found.items(), case.facts["scores"].items()):
            places = [list(case.states).index(state) for state in of.get("states", case.states)]
            mine = of.get("scale", 1.0) * errors[..., places]
            label = metric if metric == "test simulated" else f"{group} {metric}"
            rows.append({**facts, "metric": f"{label}, RMSE", "value": float(f"{rms(mine):.4g}"), "unit": of["unit"]})
    return rows


@dataclass(frozen=True)
class Equations:
    """A model in equations, which predicts from states that are estimated on the samples before.

    Attributes:
        model: The model.
        source: What it was fitted to, with what is measured of its states first known by `outputs`.
        outputs: States that are measured, in the order of the log.
        factors: From the units of the log to those of the model, of each output.
        whole: Whether it is of all samples where the others have every n-th.
    """

    model: SindyModel
    source: Source
    outputs: Sequence[str]
    factors: Array
    whole: bool = False

    @property
    def coefficients(self) -> int:
        """How many numbers were fitted."""
        return int((self.model.coefficients[self.model.constraints.free] != 0).sum())

    def predict(self, log: Log, starts: Places, steps: int) -> Array:
        """Return what is predicted for the samples after each start."""
        by = round(log.dt / log.whole.dt) if self.whole and log.whole else 1
        data = transitions(
            log.whole if by > 1 and log.whole else log, self.source.signature, self.outputs, self.factors
        )
        training = self.source.with_states_of(self.model).training
        test = replace(self.source, training=data, validation=_none(data)).with_states_of(self.model).training
        places = [self.model.signature.state_index(name) for name in self.outputs]
        path = predict_ahead(self.model, training, test, by * torch.from_numpy(starts), by * steps)
        return path[:, by - 1 :: by, places].numpy() / self.factors


def transitions(log: Log, signature: Signature, outputs: Sequence[str], factors: Array) -> Transitions:
    """Return a log as states and inputs of a signature, NaN where a state is not measured."""
    low, high = np.array(signature.input_ends or (WHOLE,) * signature.n_u).T
    x = np.full((len(log), signature.n_x), np.nan)
    x[:, [signature.state_index(name) for name in outputs]] = factors * log.y
    u = (log.u - 0.5 * (low + high)) / (0.5 * (high - low))
    return Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u), log.dt)


def _none(data: Transitions) -> Transitions:
    return data.select(torch.zeros(len(data), dtype=torch.bool))


def ours(case: Case) -> Predictor:
    """Read and identify with all settings at their defaults; what is scored is a log of its own, or the part kept."""
    share, columns = case.facts.get("kept", 0.0), case.facts.get("columns", {})
    source = read([str(file) for file in case.files], **columns, validation_share=share)
    names = source.signature.state_names
    units = zip(source.signature.state_units, case.states.values(), strict=True)
    factors = np.array([1.0 if mine == unit else in_radians(unit)[1] for mine, unit in units])
    model = identify(source, **case.facts.get("identify", {}))
    print(*model.equations(), *model.findings, sep="\n", flush=True)
    return Equations(model, source, names, factors, whole=True)


def structure(case: Case) -> Predictor:
    """Fit equations whose functions rigs.yaml has."""
    facts = case.facts["structure"]
    signature = Signature(
        tuple(facts["states"]),
        tuple(facts["states"].values()),
        ("u",),
        tuple(facts["scale"]),
        input_ends=tuple(map(tuple, facts.get("ends", ()))),
    )
    more = {name: facts[name] for name in ("known", "allowed", "fixed", "initial") if name in facts}
    refinement = Refinement("trajectory", **facts["refinement"])
    model = SindyModel(signature, facts["functions"], Regression("bic"), refinement, **more)
    outputs = facts.get("measured", list(case.states))
    ones = np.ones(len(outputs))
    data = Transitions.cat([transitions(log, signature, outputs, ones) for log in case.training])
    model.fit(data)
    print(*model.equations(), sep="\n", flush=True)
    return Equations(model, Source(signature, data, _none(data)), outputs, ones)


def pysindy(case: Case) -> Predictor:
    """Return PySINDy's model of monomials of what is measured, and of differentiated rates where they help."""
    names = [f"x{i}" for i in range(len(case.states))]
    units = zip(names, case.states.values(), strict=True)
    known = {name: f"{name}_rate" for name, unit in units if unit != "rpm" and "/" not in unit}
    ones, reach = np.ones(len(names)), np.abs(np.vstack([log.u for log in case.training])).max(0)

    def _fit(logs: Sequence[Log], degree: int, rates: Mapping[str, str], threshold: float) -> Predictor:
        signature = Signature(
            (*names, *rates.values()),
            ("-",) * (len(names) + len(rates)),
            tuple(f"u{i}" for i in range(len(reach))),
            (*np.abs(np.vstack([log.y for log in logs])).max(0), *ones[: len(rates)]),
            input_ends=tuple((-size, size) for size in reach),
        )
        data = Transitions.cat([transitions(log, signature, names, ones) for log in logs])
        model = SindyModel(signature, partial(polynomial, degree=degree), Regression(), Refinement(), known=rates)
        model = pysindy_of(model, data, threshold)
        return Equations(model, Source(signature, data, _none(data)), names, ones)

    degrees = (1, 2, 3) if len(names) + len(reach) < 5 else (1, 2)
    grid = product(degrees, (known, {}), (1e-3, 1e-2, 0.1))
    ways: list[Fit] = [partial(_fit, degree=degree, rates=rates, threshold=size) for degree, rates, size in grid]
    return choose(ways, case.training, case.cost)


def _chosen(ways: Callable[[Sequence[Log]], list[Fit]], case: Case) -> Predictor:
    return choose(ways(case.training), case.training, case.cost)


MODELS: dict[str, Callable[[Case], Predictor]] = {
    "ours": ours,
    "ours with structure": structure,
    "ARX": partial(_chosen, Arx.ways),
    "ARX with a cubic": partial(_chosen, partial(Arx.ways, cubic=True)),
    "subspace": partial(_chosen, StateSpace.ways),
    "pysindy": pysindy,
    "inverse dynamics": partial(_chosen, InverseDynamics.ways),
    "second-order linear": lambda case: HeatedBodies.fit(case.training),
    "last value held": lambda case: Held(),
}
SPECIAL = ("ours with structure", "ARX with a cubic", "inverse dynamics", "second-order linear")
"""Models of those rigs alone whose entries name them."""


class HarderRig(Rig):
    """The bench surrogate with a cable that stiffens and with friction that peaks before it slips."""

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return dx/dt, `(*batch, 6)`, of states `(*batch, 6)` under inputs `(*batch, 2)` in [-1, 1]."""
        dx, k = super().forward(x, u), self.constants
        azimuth, pitch, rate_a, rate_p, *_ = x.unbind(-1)
        inertia_a = k.inertia_a[0] * pitch.cos().square() + k.inertia_a[1]
        peak_a, peak_p = (
            DRY * torch.tanh(rate / 0.02) * torch.exp(-(rate / 0.1).square()) for rate in (rate_a, rate_p)
        )
        zero = torch.zeros_like(azimuth)
        stiff = 0.03 * azimuth * azimuth * azimuth
        return dx + torch.stack((zero, zero, -(stiff + peak_a) / inertia_a, -peak_p / k.inertia_p, zero, zero), -1)


def write_surrogate(path: Path, columns: Sequence[str], harder: bool = False, seconds: float = 90.0) -> None:
    """Write a log of the bench surrogate in closed loop: angles by encoders, rotor speeds with noise, no rates."""
    hard: dict[str, Any] = {"gust": 0.03, "drift": 0.05, "plant": HarderRig()} if harder else {}
    measured, commands = record_closed_loop(seconds, 1, noise=(20.0, 20.0), **hard)
    t = DT * torch.arange(len(measured), dtype=torch.float64).unsqueeze(-1)
    write_csv(path, ["time [s]", *columns], torch.cat([t, measured[:, 0, [0, 1, 4, 5]], commands[:, 0]], -1).tolist())
