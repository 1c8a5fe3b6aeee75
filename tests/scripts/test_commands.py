"""The commands of `dynasindy`: which there are, and what they say of themselves."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import forked
import pytest

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"torch", "torchrl", "tensordict", "pysindy", "scipy", "sympy", "matplotlib"}


@pytest.fixture
def cli(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    import cli

    return cli


def dynasindy(*words, cwd, **environment):
    command = [sys.executable, "-m", "dynasindy", *words]
    return forked.run(command, cwd=cwd, env={**os.environ, **environment})


def test_every_command_is_a_script_with_a_main_and_every_config_belongs_to_one(cli):
    for name in cli.COMMANDS:
        text = (ROOT / "scripts" / f"{name}.py").read_text()
        assert re.search(r"^(def main\(|main = command\()", text, re.M), name
        assert 'if __name__ == "__main__":\n    main()\n' in text, name
        assert f"`python scripts/{name}.py " in text  # what the help and the manual show
    assert {file.stem for file in (ROOT / "conf").glob("*.yaml")} <= set(cli.COMMANDS)


@pytest.mark.parametrize("words", [[], ["--help"]])
def test_without_a_command_all_of_them_are_listed(cli, words, tmp_path):
    done = dynasindy(*words, cwd=tmp_path)
    listed = re.findall(r"^  (\w+)  +\S", done.stdout, re.M)
    assert done.returncode == 0 and tuple(listed) == cli.COMMANDS


EVERY_HELP = """
import contextlib, io, runpy, sys
for name in {names}:
    sys.argv = [f"{scripts}/{{name}}.py", "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as page, contextlib.suppress(SystemExit):
        runpy.run_path(sys.argv[0], run_name="__main__")
    assert f"python {scripts}/{{name}}.py" in page.getvalue(), name  # which runs from here, too
print(*sys.modules)
"""


def test_no_help_imports_what_takes_seconds(cli, tmp_path):
    code = EVERY_HELP.format(names=cli.COMMANDS, scripts=ROOT / "scripts")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'scripts'}"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert not {"hydra", "numpy", *HEAVY} & set(done.stdout.split())
    assert not list(tmp_path.iterdir())


def test_a_wrong_key_is_found_before_torch_is_imported(tmp_path):
    code = "import sys; sys.argv = ['train', 'sed=1']\nimport train\ntry: train.main()\nfinally: print(*sys.modules)"
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'scripts'}"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 2 and "'seed'" in done.stderr
    assert not HEAVY & set(done.stdout.split())


@pytest.mark.slow
def test_each_command_has_all_that_it_imports_in_a_process_of_its_own(tmp_path):
    """But for `train` and `identify`, whose whole runs in a process of their own are tests of other files."""
    short = ("scenario.episodes=2", "task.max_steps=60", "excitation.duration=3", "folder=run")
    made = dynasindy("train", "experiment=gradient_smoke", "system=pendulum", *short, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    shutil.copytree(tmp_path / "run", tmp_path / "results" / "runs" / "mine")
    calls = (
        ("evaluate", "run=run", "scenarios=[step]", "formats=[svg]", "animate=true"),
        ("check", "run=run", "points=1", "grid=2", "draws=1", "seconds=1"),
        ("export", "run=run", "formats=[c,model]"),
        ("report", "results=results"),
        ("rig", "system=pendulum", "controller=run/controller.json", "sensors=exact", "seconds=0.2", "guard.late=100"),
    )
    for words in calls:
        command = [sys.executable, "-m", "dynasindy", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode in ((0, 1) if words[0] == "check" else (0,)), (words, done.stderr)
        assert "Traceback" not in done.stderr, (words, done.stderr)
