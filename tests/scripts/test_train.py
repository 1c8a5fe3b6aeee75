"""Sweeps of any sweeper, and words that are of a sweep alone."""

import os
import sys
from pathlib import Path

import forked
import pytest

ROOT = Path(__file__).resolve().parents[2]
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


def test_a_group_without_a_file_is_told_and_not_the_file_of_a_user(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "mine.yaml").write_text((ROOT / "conf" / "system" / "pendulum.yaml").read_text())
    done = run("--config-dir", str(tmp_path), "system=mine", "sensors=null", cwd=tmp_path)
    assert done.returncode == 2 and "'null'" in done.stderr and "'sensors'" in done.stderr


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
        (["task=own", "seed=0,1"], "the task has no targets, so its jobs have no score"),
        (["seed=3"], "nothing is searched; give a range, such as 'planning.lr=interval(0.002,0.03)'"),
    ],
)
def test_a_search_that_cannot_find_anything_costs_one_line_and_leaves_nothing(tmp_path, asking, words, said):
    done = run("-m", "experiment=smoke", "hydra/sweeper=asking", *words, cwd=tmp_path, PYTHONPATH=asking)
    lines = [line for line in done.stderr.splitlines() if not line.startswith("sweep: ")]
    assert done.returncode == 2 and done.stdout == "", done.stderr
    assert len(lines) == 1 and lines[0].startswith(f"error: {said}")
    assert not (tmp_path / "runs").exists()


def test_several_values_without_a_sweep_say_how_to_ask_for_one(tmp_path):
    done = run("experiment=smoke", "seed=0,1", cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert "'seed=0,1'" in done.stderr and "--multirun" in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
