"""The commit that a row names, read by git itself in checkouts made for it."""

import subprocess

import pytest
from benchmarks import commit as instrument


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository of one commit, in whose folder the module is taken to lie."""
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    (tmp_path / "code.py").write_text("x = 1\n")
    (tmp_path / "commit.py").write_text("")
    (tmp_path / "docs" / "results").mkdir(parents=True)
    (tmp_path / "docs" / "results" / "table.csv").write_text("a\n")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "one"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    monkeypatch.setattr(instrument, "__file__", str(tmp_path / "commit.py"))
    return tmp_path


def test_a_clean_checkout_names_its_commit_and_a_changed_one_says_so(checkout):
    head = subprocess.run(["git", "-C", str(checkout), "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    clean = instrument.commit()
    assert len(clean) >= 7 and head.stdout.startswith(clean)
    (checkout / "docs" / "results" / "table.csv").write_text("a\n1\n")  # a row of the benchmark itself
    assert instrument.commit() == clean
    (checkout / "code.py").write_text("x = 2\n")
    assert instrument.commit() == f"{clean}-dirty"


def test_a_package_installed_into_a_checkout_of_something_else_is_of_no_commit(checkout, monkeypatch):
    installed = checkout / "venv" / "commit.py"
    installed.parent.mkdir()
    installed.write_text("")
    monkeypatch.setattr(instrument, "__file__", str(installed))
    assert instrument.commit() == "unknown"


def test_outside_of_a_checkout_the_commit_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(instrument, "__file__", str(tmp_path / "commit.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert instrument.commit() == "unknown"
