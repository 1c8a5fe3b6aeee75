"""The report script as a user runs it: building, and its one line for mistakes."""

import subprocess
from pathlib import Path

import forked

REPOSITORY = Path(__file__).parents[2]


def report(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked.call("report", *arguments, cwd=cwd)


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
