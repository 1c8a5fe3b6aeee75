"""Sweeps of tasks of any kind, and words that are of a sweep alone."""

import os
from pathlib import Path

import forked

ROOT = Path(__file__).resolve().parents[2]


def run(*overrides, cwd, **more):
    return forked.call("train", *overrides, cwd=cwd, env=os.environ | more)


def test_a_group_without_a_file_is_told_and_not_the_file_of_a_user(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "mine.yaml").write_text((ROOT / "conf" / "system" / "pendulum.yaml").read_text())
    done = run("--config-dir", str(tmp_path), "system=mine", "sensors=null", cwd=tmp_path)
    assert done.returncode == 2 and "'null'" in done.stderr and "'sensors'" in done.stderr


def test_several_values_without_a_sweep_say_how_to_ask_for_one(tmp_path):
    done = run("experiment=smoke", "seed=0,1", cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert "'seed=0,1'" in done.stderr and "--multirun" in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
