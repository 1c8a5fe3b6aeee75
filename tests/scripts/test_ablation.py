"""The ablation as a user runs it: interrupted, it goes on where it was."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "ablation.py"
SMALL = (
    "experiment=smoke", "system=xi", "train.episodes=1", "train.updates_per_step=0.02", "scenario.episodes=2",
    "excitation.duration=2", "task.max_steps=50", "setting=direct,rollouts_400", "planning.rollouts=10", "seed=1",
    "results=results",
)  # fmt: skip


def run(*overrides, cwd):
    command = [sys.executable, str(SCRIPT), *overrides]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def jobs(folder):
    return sorted((folder / "runs" / "ablation" / "xi" / "smoke").rglob("metrics.json"))


def rows(folder):
    with (folder / "results" / "ablation.csv").open() as file:
        return sorted((row["setting"].partition(",")[0], row["seed"]) for row in csv.DictReader(file))


@pytest.mark.slow
def test_an_interrupted_ablation_goes_on_and_ends_with_tables_and_figures(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    run(*SMALL, "hydra/launcher=joblib", cwd=tmp_path)
    interrupted, other = jobs(tmp_path)
    interrupted.unlink()
    before = other.stat().st_mtime_ns
    run(*SMALL, "hydra/launcher=basic", cwd=tmp_path)
    assert other.stat().st_mtime_ns == before
    assert json.loads(interrupted.read_text())["seed"] == 1
    with (interrupted.parent / "scalars" / "scalars" / "return.csv").open() as file:
        assert len(file.readlines()) == 1  # the interrupted run's log did not stay
    assert rows(tmp_path) == [("direct", "1"), ("rollouts_400", "1")]
    assert (tmp_path / "results" / "average_rewards_xi_smoke.png").is_file()
    assert "| xi | smoke | direct" in (tmp_path / "results" / "ablation.md").read_text()


@pytest.mark.slow
def test_the_jobs_of_a_cluster_are_gathered_too(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    run(*SMALL, "hydra/launcher=submitit_local", cwd=tmp_path)
    assert len(jobs(tmp_path)) == 2
    assert rows(tmp_path) == [("direct", "1"), ("rollouts_400", "1")]
