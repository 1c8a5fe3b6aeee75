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
    "setting=direct,rollouts_400", "planning.rollouts=10", "seed=0,1", "results=results",
)  # fmt: skip


def run(*overrides, cwd):
    command = [sys.executable, str(SCRIPT), *overrides]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_an_interrupted_ablation_goes_on_and_ends_with_tables_and_figures(tmp_path, launcher):
    pytest.importorskip(f"hydra_plugins.hydra_{launcher.removesuffix('_local')}_launcher")
    run(*SMALL, f"hydra/launcher={launcher}", cwd=tmp_path)
    jobs = sorted((tmp_path / "runs" / "ablation" / "xi" / "smoke").rglob("metrics.json"))
    assert len(jobs) == 4
    interrupted, *others = jobs
    interrupted.unlink()
    before = [job.stat().st_mtime_ns for job in others]
    run(*SMALL, "hydra/launcher=basic", cwd=tmp_path)
    assert [job.stat().st_mtime_ns for job in others] == before
    assert json.loads(interrupted.read_text())["seed"] == 0
    with (interrupted.parent / "scalars" / "scalars" / "return.csv").open() as file:
        assert len(file.readlines()) == 1  # the interrupted run's log did not stay

    results = tmp_path / "results"
    with (results / "ablation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sorted((row["setting"].partition(",")[0], row["seed"]) for row in rows) == [
        (setting, seed) for setting in ("direct", "rollouts_400") for seed in ("0", "1")
    ]
    assert (results / "average_rewards_xi_smoke.png").is_file()
    assert "| xi | smoke | direct" in (results / "ablation.md").read_text()
