"""The main job as a user runs it."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import forked
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ("excitation", "prediction_first_episode", "step_response")


ASKING = """
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.config_store import ConfigStore

class Asking(BasicSweeper):
    def __init__(self, n_trials):
        super().__init__(None, {"seed": "0,1"})

ConfigStore.instance().store(
    group="hydra/sweeper", name="asking", node={"_target_": "hydra_plugins.asking.Asking", "n_trials": 2}
)
"""
"""A sweeper that wants a score for each of its trials, as Optuna does, which need not be installed."""


def run(*overrides, cwd, **more):
    return forked.run(command(*overrides), cwd=cwd, timeout=300, env=os.environ | more)


def command(*overrides):
    return [sys.executable, str(ROOT / "scripts" / "train.py"), *overrides]


def test_the_smoke_run_leaves_a_complete_folder_and_says_what_came_of_it(tmp_path):
    # A process of its own, which imports all that it needs, as that of a user.
    words = ("experiment=smoke", f"hydra.run.dir={tmp_path / 'run'}")
    done = subprocess.run(command(*words), cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "run"
    files = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert {"config.yaml", "progress.csv", "metrics.json", "policy.pt", "model.json", "identification.txt"} <= files
    assert {f"data/{name}.csv" for name in DATA} <= files
    assert {f"figures/{name}.png" for name in (*DATA, "training_data", "model_error")} <= files
    assert "scalars/scalars/return.csv" in files
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["cost"]["real_steps"] == 600 and metrics["cost"]["plant_seconds"] == pytest.approx(30.0)
    with (folder / "progress.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert int(float(row["real_steps"])) == 600
    for words in (
        "Omega_p' = ",
        "steady-state error",
        "overshoot",
        "settling time",
        "RMSE",
        "which are 600 control periods",
        str(folder),
    ):
        assert words in done.stdout, words


@pytest.mark.slow
def test_a_run_is_the_same_whatever_the_order_of_words_in_a_set(tmp_path):
    kept = []
    for seed in ("1", "2"):
        words = ("experiment=smoke", f"hydra.run.dir={tmp_path / seed}")
        environment = os.environ | {"PYTHONHASHSEED": seed}
        subprocess.run(command(*words), cwd=tmp_path, env=environment, capture_output=True, timeout=300, check=True)
        with (tmp_path / seed / "progress.csv").open() as file:
            rows = [
                {name: cell for name, cell in row.items() if name != "wall_seconds"} for row in csv.DictReader(file)
            ]
        kept.append((rows, (tmp_path / seed / "model.json").read_text()))
    assert kept[0] == kept[1] and len(kept[0][0]) > 0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("planning.rolouts=3", "did you mean 'rollouts'?"),
        ("planning=magic", "'magic' does not exist in 'planning'; allowed are "),
        ("sensors=null", "'null' does not exist in 'sensors'; allowed are bench, bench_delay, exact"),
        ("planning=3", "'3' does not exist in 'planning'; allowed are dyna, "),
        (
            "system=logged",
            "system=logged is no plant to train on, only a log of one; choose one of gymnasium, pendul",
        ),
        ("env.dt=-0.05", "need dt > 0 s"),
        ("plant.outputs=[yaw", "'plant.outputs=[yaw' cannot be read; write key=value, close all brackets"),
        ("task.outputs=[yaw,alpha_p]", "task.outputs names 'yaw', which is no state; the states are alpha_a"),
    ],
)
def test_a_bad_setting_costs_one_line_and_leaves_nothing(tmp_path, override, words):
    done = run("experiment=smoke", override, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert words in done.stderr
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_a_group_without_a_file_is_told_and_not_the_file_of_a_user(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "mine.yaml").write_text((ROOT / "conf" / "system" / "pendulum.yaml").read_text())
    done = run("--config-dir", str(tmp_path), "system=mine", "sensors=null", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.startswith("error: 'null' does not exist in 'sensors'; allowed are ")


@pytest.fixture
def asking(tmp_path):
    """Where Python finds a sweeper of the name `asking`."""
    (tmp_path / "hydra_plugins").mkdir()
    (tmp_path / "hydra_plugins" / "asking.py").write_text(ASKING)
    return os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))


@pytest.mark.parametrize(("sweeper", "task"), [("asking", "random_step"), ("basic", "own")])
def test_a_plain_sweep_needs_no_task_with_a_score_and_each_of_its_jobs_leaves_its_own_line(
    tmp_path, asking, sweeper, task
):
    jobs = tmp_path / "sweep"
    done = run(
        "-m", "experiment=smoke", f"task={task}", "excitation.duration=90", f"hydra/sweeper={sweeper}",
        f"hydra.sweep.dir={jobs}", "seed=0,1", cwd=tmp_path, PYTHONPATH=asking,
    )  # fmt: skip
    lines = [file.read_text() for file in jobs.rglob("error.txt")]
    assert done.returncode == 2 and "2 jobs failed" in done.stderr, done.stderr
    said = "error: an excitation of 90 s does not fit"  # what is found next, before any work
    assert len(lines) == 2 and all(line.startswith(said) and line.count("\n") == 1 for line in lines)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["task=own", "seed=0,1"], "task=own has no targets, so its jobs have no score"),
        (["seed=3"], "nothing is searched; give a range, such as 'planning.lr=interval(0.002,0.03)'"),
    ],
)
def test_a_search_that_cannot_find_anything_costs_one_line_and_leaves_nothing(tmp_path, asking, words, said):
    done = run("-m", "experiment=smoke", "hydra/sweeper=asking", *words, cwd=tmp_path, PYTHONPATH=asking)
    lines = [line for line in done.stderr.splitlines() if not line.startswith("sweep: ")]
    assert done.returncode == 2 and done.stdout == "", done.stderr
    assert len(lines) == 1 and lines[0].startswith(f"error: {said}")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("hydra/launcher=joblib", "hydra/launcher=joblib is for many jobs, and this command is one; add -m, "),
        ("seed=0,1", "seed=0,1 gives several values; add -m for a job with each of them, or write 'seed=[0,1]' for"),
    ],
)
def test_what_is_for_a_sweep_says_how_to_ask_for_one(tmp_path, word, said):
    done = run("experiment=smoke", word, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith(f"error: {said}") and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [["planning.lrr=3", "seed=0,1"], ["-m", "seed=0,1", "planning.lrr=3", "sead=1"]])
def test_a_misspelt_key_is_said_before_that_there_are_several_values_and_before_the_next(tmp_path, words):
    folder = tmp_path / "own" / "system"  # what the words name may lie in a folder of one's own
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text((ROOT / "conf" / "system" / "tras.yaml").read_text())
    done = run(*words, "system=mine", "--config-dir", str(folder.parent), cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: 'lrr' does not exist in 'planning'; allowed are check_every, every, held")
    assert done.stderr.endswith("; did you mean 'lr'?\n") and done.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_sweep_runs_a_job_for_each_setting(tmp_path):
    done = run(
        "-m", "experiment=smoke", "planning.rollouts=0,10", "seed=0,1", "train.updates_per_step=0.01",
        "excitation.duration=2", "task.max_steps=50", "system=xi",
        f"hydra.sweep.dir={tmp_path / 'sweep'}", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    runs = [json.loads(file.read_text()) for file in sorted((tmp_path / "sweep").glob("*/metrics.json"))]
    imagined = sorted((run["seed"], run["cost"]["imagined_transitions"] > 0) for run in runs)
    assert imagined == [(0, False), (0, True), (1, False), (1, True)]
