"""The report script as a user runs it: saving runs, building, and its one line for mistakes."""

import json
import subprocess
import sys
from pathlib import Path

import forked
import pytest

REPOSITORY = Path(__file__).parents[2]
SMALL = ("system=xi", "experiment=smoke", "excitation.duration=5", "task.max_steps=100", "scenario.episodes=4")


def report(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(REPOSITORY / "scripts" / "report.py"), *arguments]
    return forked.run(command, cwd=cwd, timeout=300)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ablation") / "xi" / "dyna" / "rollouts_800" / "seed_0"
    command = [sys.executable, str(REPOSITORY / "scripts" / "train.py"), *SMALL]
    forked.run([*command, f"folder={folder}", f"hydra.run.dir={folder}"], cwd=folder.parents[3], check=True)
    return folder


def test_a_run_is_evaluated_saved_and_shown(trained: Path, tmp_path: Path) -> None:
    done = report(f"save={trained.parents[3]}", "scenarios=[step]", "any_commit=true", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    kept = tmp_path / "docs" / "results" / "runs" / "xi_dyna_rollouts_800"
    assert (kept / "evaluation" / "step.json").is_file() and not list(kept.rglob("*.pt"))
    origin = json.loads((kept / "origin.json").read_text())
    assert origin["command"] == f"python scripts/train.py {' '.join(SMALL)}"
    assert str(tmp_path) not in (kept / "config.yaml").read_text()
    text = " ".join((tmp_path / "docs" / "report" / "report.md").read_text().split())
    assert f"`{origin['command']}`" in text and "![" in text
    assert "docs/report/report.md" in done.stdout and "note:" not in done.stdout


def test_one_run_is_saved_under_a_name(trained: Path, tmp_path: Path) -> None:
    done = report(f"save={trained}", "name=mine", "scenarios=[]", "any_commit=true", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "docs" / "results" / "runs" / "mine" / "metrics.json").is_file()
    said = next(line for line in done.stdout.splitlines() if line.startswith("note: "))
    assert "mine" in said and "xi_dyna_rollouts_800" in said


def test_a_folder_without_anything_saved_is_refused_and_no_page_is_written(tmp_path: Path) -> None:
    done = report(cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: docs/results ") and "save=RUN" in done.stderr
    assert not list(tmp_path.iterdir())
