"""The wheel, unpacked alone in an empty folder: it holds everything, and trains."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import setuptools

ROOT = Path(__file__).resolve().parents[2]
TREES = ("dynasindy", "conf", "scripts")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    if int(setuptools.__version__.partition(".")[0]) < 77:
        pytest.skip("pyproject.toml wants setuptools 77 to build with; this environment has an older one")
    source = tmp_path_factory.mktemp("source")
    for tree in TREES:
        shutil.copytree(ROOT / tree, source / tree, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", "out", "."]
    subprocess.run(build, cwd=source, check=True)
    (file,) = (source / "out").glob("*.whl")
    return file


@pytest.mark.slow
def test_it_holds_every_file_of_the_package_every_config_and_script_and_the_command(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        (entries,) = (archive.read(name).decode() for name in archive.namelist() if name.endswith("entry_points.txt"))
    files = [file for tree in TREES for file in (ROOT / tree).rglob("*") if file.is_file()]
    found = {file.relative_to(ROOT) for file in files if not {"__pycache__", "benchmarks"} & set(file.parts)}
    wanted = {file.as_posix() if file.parts[0] == "dynasindy" else f"dynasindy/{file.as_posix()}" for file in found}
    assert held == wanted
    assert "dynasindy = dynasindy.__main__:main" in entries


@pytest.mark.slow
def test_alone_in_an_empty_folder_it_trains(wheel, tmp_path):
    site, folder = tmp_path / "site", tmp_path / "folder"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    folder.mkdir()
    # A checkout of something else around it is not where the code is from.
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    for words in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "one"]):
        subprocess.run([*git, *words], check=True)

    def dynasindy(*words):
        command = [sys.executable, "-m", "dynasindy", *words]
        environment = {**os.environ, "PYTHONPATH": str(site)}
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, timeout=600)

    done = dynasindy("train", "experiment=smoke", "scenario.episodes=2")
    assert done.returncode == 0, done.stderr
    (run,) = (folder / "runs").iterdir()
    assert (run / "controller.json").is_file() and str(run) in done.stdout
    origin = json.loads((run / "origin.json").read_text())
    assert origin == {"command": "dynasindy train experiment=smoke scenario.episodes=2", "commit": "unknown"}
    assert sorted(path.name for path in folder.iterdir()) == ["runs"]
    assert "dynasindy evaluate run=PATH" in dynasindy("evaluate", "--help").stdout
