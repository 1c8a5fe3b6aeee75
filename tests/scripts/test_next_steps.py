"""What is said to do next: commands that a shell takes as they are, and that fit what came of a run."""

import re
import shlex
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    monkeypatch.setattr("dynasindy.sentences._words_of_commands", True)
    import next_steps

    return next_steps


@pytest.mark.parametrize(
    ("words", "logged", "plant", "lacking", "expected"),
    [
        (
            ["data=csv", "data.path=my log.csv"],
            True,
            "logged",
            {"outputs": ["y"], "low": ["-0.5"]},
            "data=csv 'data.path=my log.csv' ",
        ),
        (
            ["system=tras", "data=csv", "data.path=a.csv", "folder=x"],
            True,
            "tras",
            {},
            "system=tras data=csv data.path",
        ),
        (["plant.library=['1',u]", "longest_delay=0.2", "data=csv"], True, "logged", {}, "longest_delay=0.2 data=csv"),
        (["excitation=prbs", "data.noise=0.1", "formats=[pdf]"], False, "tras", {}, "system=tras excitation=prbs"),
        (["system=xi", "+plant.bounds={z: 1}", "hydra/launcher=basic"], False, "xi", {}, "system=xi '+plant.bounds={z"),
    ],
)
def test_the_next_step_has_the_words_that_were_given(steps, monkeypatch, words, logged, plant, lacking, expected):
    monkeypatch.setattr(sys, "argv", ["scripts/identify.py", *words])
    line = steps.planning(words, logged, plant, lacking)
    assert expected in line and line.startswith("python scripts/train.py ")
    for word in ("folder", "formats", "data.noise", "launcher"):
        assert word not in line
    read = shlex.split(line)
    assert read[2:] == [word for word in read[2:] if word.count("=") >= 1]  # a shell gives them back, word by word
    assert [word for word in read if re.match(r"plant\.(outputs|low)", word)] == [
        {"outputs": "plant.outputs=[y]", "low": "plant.low=[-0.5]"}[key] for key in lacking
    ]


def test_after_a_session_on_a_rig_its_controller_is_looked_at_taken_away_and_flown_again(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/rig.py", "--config-dir", "my_rig"])
    lines = steps.after_flights("runs/a b", ["system=arm", "rig=udp", "folder=runs/old", "targets=[[0.4]]"]).split("\n")
    assert lines[0] == "next:"
    assert [shlex.split(line, comments=True)[1:] for line in lines[1:]] == [
        [
            "scripts/identify.py",
            "--config-dir",
            "my_rig",
            "system=arm",
            "data=csv",
            "data.path=runs/a b/excitation.csv",
        ],
        ["scripts/check.py", "run=runs/a b"],
        ["scripts/export.py", "run=runs/a b"],
        ["scripts/rig.py", "--config-dir", "my_rig", "system=arm", "rig=udp", "targets=[[0.4]]", "folder=runs/a b"],
    ]


def test_a_plant_that_is_not_controlled_is_offered_a_look_and_more_episodes_but_no_export(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/train.py"])
    words = ["system=xi", "train.episodes=2", "folder=runs/a b", "hydra.run.dir=x"]
    head, check, more = steps.mending("runs/a b", words, 2).split("\n")
    assert head == "next:" and shlex.split(check)[:3] == ["python", "scripts/check.py", "run=runs/a b"]
    assert shlex.split(more, comments=True)[2:] == ["system=xi", "hydra.run.dir=x", "train.episodes=4"]
    for smoke in ("experiment=smoke", "experiment=gradient_smoke"):
        tried = steps.mending("a", ["system=xi", smoke, "train.episodes=2", "seed=3"], 2).split("\n")
        assert len(tried) == 2 and shlex.split(tried[1], comments=True)[2:] == ["system=xi", "seed=3"]
    assert steps.mending("a", ["resume=a"], 2).count("\n") == 1  # a run that goes on takes no other settings
    (_, more) = steps.mending("a", [], 1, checked=False).split("\n")
    assert shlex.split(more, comments=True)[2:] == ["train.episodes=3"]


def test_a_plan_from_a_log_that_does_not_hold_is_offered_what_the_log_lacks(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/train.py"])
    words = ["data=csv", "data.path=my log.csv", "plant.outputs=[angle]", "system=tras", "planning.lr=1"]
    words.append("plant.known={angle: rate}")
    _, check, identify = steps.mending("a", words).split("\n")
    assert "check.py run=a" in check
    given = [word for word in words if not word.startswith("planning")]
    assert shlex.split(identify, comments=True) == ["python", "scripts/identify.py", *given]
    assert "identify" not in steps.mending("a", ["model=model.json"])


def test_a_log_of_a_known_plant_is_offered_its_library(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/identify.py"])
    line = steps.with_plant(["data=csv", "data.path=a.csv", "folder=x"], "tras")
    assert shlex.split(line)[1:] == ["scripts/identify.py", "system=tras", "data=csv", "data.path=a.csv"]


def test_a_log_that_lacks_rates_is_identified_again_with_them(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/identify.py"])
    words = ["data=csv", "data.path=a.csv", "plant.known={q: w}", "+plant.start={q: 1}", "folder=x"]
    line = steps.with_rates(words, {"q": "w", "p": "p_rate"})
    expected = ["data=csv", "data.path=a.csv", "+plant.start={q: 1}", "plant.known={q: w, p: p_rate}"]
    assert shlex.split(line) == ["python", "scripts/identify.py", *expected]


def test_ends_of_actuators_that_were_guessed_take_the_place_of_the_inputs_that_were_named(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/identify.py"])
    words = ["data=csv", "data.path=a.csv", "data.inputs=[valve]", "longest_delay=0", "folder=x"]
    line = steps.with_ends(words, {"valve": {"name": "valve", "low": 0.0, "high": 87.0}})
    expected = [*words[:2], "longest_delay=0", "data.inputs={valve: {name: valve, low: 0, high: 87}}"]
    assert shlex.split(line, comments=True) == ["python", "scripts/identify.py", *expected]


def test_the_command_that_builds_parts_of_the_user_s_own_names_their_packages(steps):
    evaluate, check = steps.following("a run", "evaluate", "check", trusting=("plugins=[wheel,mine]",)).splitlines()[1:]
    assert shlex.split(evaluate, comments=True)[-2:] == ["run=a run", "plugins=[wheel,mine]"]
    assert shlex.split(check, comments=True)[-1] == "run=a run"
