"""The files that docs/plant.md and docs/extending.md show are written where they say, and run."""

import os
import re
import shutil
import sys
from pathlib import Path

import forked
import pytest

REPOSITORY = Path(__file__).parents[1]
PAGE = "".join((REPOSITORY / "docs" / name).read_text() for name in ("plant.md", "extending.md"))
BLOCKS = dict(re.findall(r"^`(\S+/\S+)`\n\n```(?:python|yaml)\n(.*?)```", PAGE, re.S | re.M))
LINES = re.sub(r" \\\n +", " ", PAGE)
COMMANDS = re.findall(r"^    python (scripts/train\.py system=servo task=.*)$", LINES, re.M)


@pytest.fixture(scope="module")
def extended(tmp_path_factory):
    """A copy of the repository with the files of the page in their places."""
    root = tmp_path_factory.mktemp("extended")
    for folder in ("dynasindy", "conf", "scripts"):
        shutil.copytree(REPOSITORY / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(REPOSITORY / "pyproject.toml", root)
    for name, text in BLOCKS.items():
        path = root / name
        assert not path.exists() or path.read_text() == text, f"{name} exists already; the page would overwrite it"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def run(root: Path, *arguments: str) -> str:
    """Run Python on the copied package and return what it printed."""
    environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
    done = forked.run([sys.executable, *arguments], cwd=root, env=environment, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_page_shows_one_file_of_each_kind_with_its_test():
    folders = {str(Path(name).parent) for name in BLOCKS}
    kinds = {"systems", "envs", "sindy"}
    assert {f"dynasindy/{kind}" for kind in kinds} | {f"tests/{kind}" for kind in kinds} <= folders
    assert {f"conf/{kind}" for kind in ("system", "task", "excitation", "world_model", "agent")} <= folders


def test_tests_of_the_page_pass(extended):
    printed = run(extended, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests")
    assert re.search(r"^7 passed", printed, re.M)


def test_the_command_that_tests_a_plant_of_ones_own_passes(extended, tmp_path):
    (words,) = re.findall(r"^    (pytest tests/systems/test_servo\.py .*)$", PAGE, re.M)
    # The tests of the configuration read the page on Gymnasium, and examples of plants.
    for folder in ("dynasindy", "conf", "docs", "scripts", "tests"):
        ignored = shutil.ignore_patterns("__pycache__", "results", "report", "figures")
        shutil.copytree(REPOSITORY / folder, tmp_path / folder, ignore=ignored)
    shutil.copy(REPOSITORY / "pyproject.toml", tmp_path)
    for name in ("dynasindy/systems/servo.py", "conf/system/servo.yaml", "tests/systems/test_servo.py"):
        (tmp_path / name).write_text(BLOCKS[name])
    printed = run(tmp_path, "-m", *words.replace("-k", "-q -p no:cacheprovider -k").split())
    assert re.search(r"^\d+ passed(?!, \d+ skipped)", printed, re.M)


@pytest.mark.slow
@pytest.mark.parametrize("experiment", ["smoke", "gradient_smoke"])
def test_a_task_without_references_trains_and_is_judged_by_its_return(extended, experiment):
    folder = extended / experiment
    short = ["excitation.duration=2.0", "task.max_steps=40", "scenario.episodes=4"]
    short += [f"experiment={experiment}", f"hydra.run.dir={folder}"]
    if experiment == "gradient_smoke":
        short += ["planning.updates=20", "planning.more_updates=5", "planning.rollouts=8", "planning.window=20"]
        short += ["planning.searches=0"]
    printed = run(extended, *COMMANDS[1].split(), *short)
    assert "NOT JUDGED: the task names no targets, so nothing is said of control" in printed
    assert "RMSE" not in printed and "return  " in printed
    # What is named as the next step works: there is no controller to check or to export.
    assert "evaluate.py run=" in printed and "check.py" not in printed and "export.py" not in printed
    assert (folder / "figures" / "step_response.png").is_file()
    assert not (folder / "controller.json").exists()
    printed = run(extended, "scripts/evaluate.py", f"run={folder}", "scenarios=[task]")
    assert "Scenario 'task' (64 episodes, 2 s)" in printed  # as long as the episodes of training
