"""What is said to do next: commands that a shell takes as they are, and that fit what came of a run."""

import shlex
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    monkeypatch.setattr(sys, "argv", ["scripts/train.py"])
    import cli

    return cli


@pytest.fixture
def improvements(steps):
    import saved_run

    return saved_run.improvements


def read(line):
    """Return what a shell makes of a command."""
    return shlex.split(line, comments=True)


@pytest.mark.parametrize(
    ("words", "keys", "kept"),
    [
        (["data=csv", "data.path=my log.csv", "folder=x"], ["folder"], ["data=csv", "data.path=my log.csv"]),
        (["excitation=aprbs", "data.noise=0.1", "formats=[pdf]"], ["data", "formats"], ["excitation=aprbs"]),
        (["+plant.bounds={z: 1}", "hydra/launcher=basic"], ["hydra"], ["+plant.bounds={z: 1}"]),
        (["plant.known={q: w}", "+plant.start={q: 1}"], ["plant.known"], ["+plant.start={q: 1}"]),
    ],
)
def test_words_are_left_out_by_key_or_group_and_a_shell_gives_the_others_back(steps, words, keys, kept):
    assert steps.without(words, *keys) == kept
    assert read(steps.command_line("identify", kept, "does it")) == ["python", "scripts/identify.py", *kept]


def test_a_command_has_the_folder_of_the_users_settings(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/rig.py", "--config-dir", "my rig", "system=arm"])
    assert read(steps.command_line("rig", ["system=arm"]))[1:] == [
        "scripts/rig.py",
        "--config-dir",
        "my rig",
        "system=arm",
    ]
    evaluate, check = steps.run_steps("a run", "evaluate", "check")
    assert read(evaluate)[1:] == ["scripts/evaluate.py", "--config-dir", "my rig", "run=a run"]
    assert read(check)[1] == "scripts/check.py"


def test_a_plant_that_is_not_controlled_is_offered_a_look_and_more_episodes_but_no_export(improvements):
    words = ["system=xi", "train.episodes=2", "folder=runs/a b", "hydra.run.dir=x"]
    head, check, more = improvements("runs/a b", words, 2).split("\n")
    assert head == "next:" and read(check) == ["python", "scripts/check.py", "run=runs/a b"]
    assert read(more)[2:] == ["system=xi", "hydra.run.dir=x", "train.episodes=4"]
    for smoke in ("experiment=smoke", "experiment=gradient_smoke"):
        tried = improvements("a", ["system=xi", smoke, "train.episodes=2", "seed=3"], 2).split("\n")
        assert read(tried[2])[2:] == ["system=xi", "seed=3", "train.episodes=4"]
    assert improvements("a", ["resume=a"], 2).count("\n") == 1  # a run that goes on takes no other settings
    (_, more) = improvements("a", ["system=xi"], 1, checked=False, imagined=0.02).split("\n")
    assert "system=xi planning.updates=" in more and "train.episodes" not in more  # the model is not what fails
    (_, more) = improvements("a", [], 1, checked=False).split("\n")
    assert read(more)[2:] == ["train.episodes=3"]


def test_a_plan_from_a_log_that_does_not_hold_is_offered_what_the_log_lacks(improvements):
    words = ["data=csv", "data.path=my log.csv", "plant.outputs=[angle]", "system=tras", "planning.lr=1"]
    words.append("plant.known={angle: rate}")
    _, check, identify = improvements("a", words).split("\n")
    assert "check.py run=a" in check
    assert read(identify) == ["python", "scripts/identify.py", *(w for w in words if not w.startswith("planning"))]
    assert "identify" not in improvements("a", ["model=model.json"])
    (_, alone) = improvements("a", words, lacking=True).split("\n")  # a check would ask the model that lacks something
    assert read(alone) == read(identify)
    (_, alone) = improvements("a", ["system=xi", "seed=3"], 1, lacking=True).split("\n")
    assert read(alone) == ["python", "scripts/identify.py", "system=xi"]
