"""The way from the installed command to the scripts."""

import subprocess
import sys

import pytest

import dynasindy
from dynasindy import __main__ as entry


def test_the_scripts_lie_inside_an_installed_package_and_beside_that_of_a_clone(tmp_path, monkeypatch):
    monkeypatch.setattr(entry, "PACKAGE", tmp_path / "dynasindy")
    with pytest.raises(FileNotFoundError, match="install dynasindy again"):
        entry.scripts()
    for folder in (tmp_path / "scripts", tmp_path / "dynasindy" / "scripts"):  # the second one hides the first
        folder.mkdir(parents=True)
        (folder / "cli.py").touch()
        assert entry.scripts() == folder


def test_python_m_is_the_command(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "dynasindy", "--version"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, dynasindy.__version__, "")
