"""The report script as a user runs it: building, and its one line for mistakes."""

import json
import shutil
import subprocess
from pathlib import Path

import forked
import pytest

REPOSITORY = Path(__file__).parents[2]
SMALL = ("system=xi", "experiment=smoke", "excitation.duration=5", "task.max_steps=100", "scenario.episodes=4")


def report(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked.call("report", *arguments, cwd=cwd)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ablation") / "xi" / "dyna" / "rollouts_800" / "seed_0"
    words = [*SMALL, f"folder={folder}", f"hydra.run.dir={folder}"]
    forked.call("train", *words, cwd=folder.parents[3], check=True)
    return folder


def test_a_run_in_the_folder_of_results_is_shown(trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained, tmp_path / "docs" / "results" / "runs" / "xi_dyna_rollouts_800")
    done = report(cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = " ".join((tmp_path / "docs" / "report" / "report.md").read_text().split())
    command = json.loads((trained / "origin.json").read_text())["command"]
    assert f"`{command}`" in text and "![" in text
    assert "docs/report/report.md" in done.stdout


def test_a_folder_without_anything_saved_is_refused_and_no_page_is_written(tmp_path: Path) -> None:
    done = report(cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: docs/results ") and "results=FOLDER" in done.stderr
    assert not list(tmp_path.iterdir())


def test_the_saved_runs_of_the_repository_name_no_machine() -> None:
    files = list((REPOSITORY / "docs" / "results" / "runs").rglob("*"))
    texts = {file: file.read_text() for file in files if file.is_file()}
    assert not [
        str(file) for file, text in texts.items() if any(word in text for word in ("/tmp", "/root", "/home", "/work"))
    ]
    assert not [str(file) for file in files if file.suffix in (".pt", ".png")]
