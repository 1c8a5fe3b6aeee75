"""A folder of results written by hand: three settings of one experiment on xi, and what was measured over seeds."""

import csv
import json
import math
import shutil
from pathlib import Path

import pytest
import torch

from dynasindy.sindy import SindyModel
from dynasindy.systems import Xi
from dynasindy.systems.twin_rotor import SIGNATURE

STATES, INPUTS = SIGNATURE.state_names, SIGNATURE.input_names
ERRORS = {"rollouts_0": 0.2, "rollouts_400": 0.05, "rollouts_800": 0.01}
EPISODES = {"rollouts_0": "", "rollouts_400": "6", "rollouts_800": "4"}
REFERENCES = ("reference_alpha_a", "reference_alpha_p")
SETTINGS = {"env": {"substeps": 5, "dt": 0.05}, "gate": {"open_below": 0.2}, "train": {"episodes": 6}, "seed": 0}


def table(path: Path, header, rows) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def wave(time: float) -> list[float]:
    return [0.35 * math.sin(0.3 * time), 0.25 * math.sin(0.3 * time)]


def write_run(folder: Path, error: float) -> None:
    times = [round(0.05 * k, 2) for k in range(200)]
    x = [[0.1 * math.sin(t + k) for k in range(6)] for t in times]
    table(
        folder / "data/excitation.csv", ["time", *STATES, *INPUTS], [[t, *row, 0.1, t / 10] for t, row in zip(times, x)]
    )
    predicted = [f"predicted_{name}" for name in STATES]
    for when, off in (("first", 0.1), ("last", 0.0)):
        rows = [[t, *row, *(v + off * (k < 4) for k, v in enumerate(row))] for t, row in zip(times, x)]
        table(folder / f"data/prediction_{when}_episode.csv", ["time", *STATES, *predicted], rows)
    rows = [[t, 0.4 - error, 0.3 - error, 0.1, 0.2, 0.4, 0.3] for t in times]
    header = ["time", "alpha_a", "alpha_p", *INPUTS, *REFERENCES]
    table(folder / "data/step_response.csv", header, rows)
    for shape, y in (("sine", wave), ("square", lambda t: [0.4, -0.5] if t % 10 < 5 else [-0.4, 0.5])):
        rows = [[t, y(t)[0] + error, y(t)[1] + error, *y(t)] for t in (0.1 * k for k in range(300))]
        table(folder / f"evaluation/{shape}.csv", ["time", "alpha_a", "alpha_p", *REFERENCES], rows)
    columns = ["episode", "reward_error", "judged_reward_error", "open_below", "close_above", "open"]
    columns += ["held_out_error_before", "held_out_error_after", "refit_kept"]
    table(
        folder / "gate.csv",
        columns,
        [[k, 5.0 * 0.1**k, 0.1**k, 0.2, 0.5, int(k > 1), 0.1, 0.01, 1] for k in range(1, 7)],
    )
    scores = {f"steady_state_error/{name}": error for name in STATES[:2]} | {
        "overshoot/alpha_a": 5.0,
        "overshoot/alpha_p": None,
    }
    (folder / "metrics.json").write_text(json.dumps({"evaluation": scores, "cost": {"plant_seconds": 30.0}}))
    model = SindyModel(SIGNATURE, "paper_table")
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(200, 6, generator=generator, dtype=torch.float64)
    u = torch.rand(200, 2, generator=generator, dtype=torch.float64)
    x = 2 * (x - 0.5) * torch.tensor(SIGNATURE.x_scale)
    functions = model.library(x, u)
    size = functions.abs().amax(0)  # columns of one size: those of no weight are then small beside all others
    found = torch.linalg.lstsq(functions / size, Xi()(x, u)).solution  # what the plant is made of
    model.set_coefficients(found.where(found.abs() > 1e-4, 0.0) / size[:, None])
    model.save(folder / "model.json")
    (folder / "config.yaml").write_text(json.dumps(SETTINGS))
    (folder / "origin.json").write_text(json.dumps({"command": "python scripts/x.py", "commit": "abc1234"}))


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("docs") / "results"
    for name, error in ERRORS.items():
        write_run(folder / "runs" / f"xi_dyna_{name}", error)
    key = ["system", "experiment", "setting", "seed"]
    made = {0: "abc1234", 1: "def5678", 2: "abc1234"}
    rows = [["xi", "dyna", name, seed, 6, steps, made[seed]] for name, steps in EPISODES.items() for seed in made]
    table(folder / "ablation.csv", [*key, "episodes", "episodes_to_level", "commit"], rows)
    rows = [
        ["xi", "dyna", name, seed, k, -1000 * error / k + seed]
        for name, error in ERRORS.items()
        for seed in made
        for k in range(1, 7)
    ]
    # Seeds spread by a tenth of a per cent, settings by a factor.
    ends = [f"evaluated_steady_state_error/{name}" for name in STATES[:2]]
    rows = [[*row, ERRORS[row[2]] * (1 + 0.001 * row[3]), 0.5 * ERRORS[row[2]]] for row in rows]
    table(folder / "ablation_curves.csv", [*key, "episode", "evaluated_return", *ends], rows)
    return folder


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    return tmp_path


@pytest.fixture
def copied(results: Path, tmp_path: Path) -> Path:
    """The results in a folder of the test's own, to change what is there."""
    return shutil.copytree(results, tmp_path / "results")
