"""One C file made from a log alone, flown on the plant that the log is of.

The log is 10 s of `tras` under a multisine, sampled every 0.01 s behind the sensors of a bench. It is read, identified
and planned on by `dynasindy.read`, `identify` and `plan`; the controller is written as C, compiled by the system's
compiler and flown on the true plant behind the same sensors. Nothing but the log is known of the plant, besides the
names of its states, the library of its equations and which state is the rate of which.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import dynasindy
from benchmarks.common import add_output, add_seeds, commit
from benchmarks.gradient import BENCH, KNOWN, PLANTS
from dynasindy import Controller
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import step_references
from dynasindy.evaluation.summary import column_headings
from dynasindy.excitation import Multisine
from dynasindy.export import controller_sources
from dynasindy.export.compiler import Native
from dynasindy.safe_io import Row, append_rows, read_rows, write_csv
from dynasindy.systems import Tras, integrate

COLUMNS = ("seed", "metric", "azimuth", "pitch", "azimuth_worst", "pitch_worst", "cpu_seconds", "commit")
TARGETS, SECONDS, LAST = 64, 20.0, 5.0
"""Steps that are flown, length of a flight, and its end over which errors are averaged [s]."""
DT = 0.01
"""Sampling time of the log [s]."""
SUBSTEPS = 10
"""Runge-Kutta steps of the plant between two samples."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_seeds(parser, 10)
    add_output(parser, "from_log")


def main(arguments: argparse.Namespace) -> None:
    """Make a log, a controller and a flight of each seed, and append a row."""
    torch.set_num_threads(1)
    done = {int(row["seed"]) for row in read_rows(arguments.out)}
    for seed in [seed for seed in arguments.seeds if seed not in done]:
        row = measure(seed)
        append_rows(arguments.out, COLUMNS, [row])
        print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)


def measure(seed: int) -> Row:
    """Return the errors of one seed, worst reference included [rad]."""
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write_log(path, seed)
        controller = make_controller(path, seed)
    sources = controller_sources(controller)
    spent = time.process_time() - start
    errors = simulate_targets(controller, [Native(sources) for _ in range(TARGETS)], seed)
    numbers = dict(zip(COLUMNS[2:6], [*errors.mean(0).tolist(), *errors.max(0).tolist()], strict=True))
    head = {"seed": seed, "metric": "mean_abs_error_last_5s", **{key: round(v, 5) for key, v in numbers.items()}}
    return {**head, "cpu_seconds": round(spent, 1), "commit": commit()}


def write_log(path: Path, seed: int) -> None:
    """Excite the plant and write what its bench measures, at its stops too: time, angles, speeds of the rotors, inputs.

    Args:
        path: File to write.
        seed: Seed of the signal's phases and of the sensors' noise.
    """
    plant, facts = Tras(), PLANTS["tras"]
    signature = plant.signature
    signal = Multisine(2, amplitude=facts.amplitude, offset=facts.offset, seed=seed)
    inputs, x = signal.samples(DT).double(), torch.zeros(signature.n_x, dtype=torch.float64)
    states = [x]
    for u in inputs:
        states.append(integrate(plant, states[-1], u, DT, SUBSTEPS, plant.stops)[0][-1])
    y = BENCH.read(torch.stack(states[:-1]), signature, torch.Generator().manual_seed(seed))
    seen = [i for i in range(signature.n_x) if not bool(y[:, i].isnan().any())]
    names = ["time", *(signature.state_names[i] for i in seen), *signature.input_names]
    time = DT * torch.arange(len(inputs), dtype=torch.float64).unsqueeze(-1)
    write_csv(path, column_headings(names, signature), torch.cat([time, y[:, seen], inputs], -1).tolist())


def make_controller(path: Path, seed: int) -> Controller:
    """Return the controller that the log gives."""
    signature, facts = Tras().signature, PLANTS["tras"]
    rates = set(KNOWN.values())
    states = {
        name: {"unit": unit} if name in rates else {"name": name, "unit": unit}
        for name, unit in zip(signature.state_names, signature.state_units, strict=True)
    }
    inputs = {name: name for name in signature.input_names}
    log = dynasindy.read(path, states, inputs, validation_share=0)  # nothing is forecast: the plant itself is flown
    model = dynasindy.identify(log, facts.library, KNOWN)
    targets = {name: (low, high) for name, low, high in zip(KNOWN, facts.low, facts.high, strict=True)}
    return dynasindy.plan(model, targets, log, seed=seed)


def simulate_targets(controller: Controller, natives: list[Native], seed: int) -> NDArray[np.float64]:
    """Return the errors at the end of a flight to each target, `(TARGETS, 2)` [rad].

    Args:
        controller: Tells task and control period; it does not fly.
        natives: The compiled controller, one for each target.
        seed: Seed of the sensors' noise.
    """
    plant, facts = Tras(), PLANTS["tras"]
    env = ControlEnv(plant, controller.setup.task, controller.dt, dtype=torch.float64)
    targets = step_references(facts.low, facts.high, TARGETS).targets.double().numpy()
    noise, x = torch.Generator().manual_seed(1000 + seed), torch.zeros(TARGETS, 6, dtype=torch.float64)
    periods, errors = round(SECONDS / controller.dt), []
    for k in range(periods):
        y = BENCH.read(x, plant.signature, noise).numpy()
        inputs = [native.act(y[i].tolist(), targets[i].tolist()) for i, native in enumerate(natives)]
        x = env.advance(x, torch.from_numpy(np.stack(inputs)))[0][:, -1]
        if (k + 1) * controller.dt > SECONDS - LAST + 1e-9:
            errors.append(np.abs(x[:, [plant.signature.state_index(n) for n in KNOWN]].numpy() - targets))
    found: NDArray[np.float64] = np.mean(errors, 0)
    return found
