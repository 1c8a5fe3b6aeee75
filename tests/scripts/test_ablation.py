"""The ablation as a user runs it: interrupted, it goes on where it was."""

import csv
import re

import forked
import pytest

SMALL = (
    "experiment=smoke", "system=xi", "train.episodes=1", "train.updates_per_step=0.02", "scenario.episodes=2",
    "excitation.duration=2", "task.max_steps=50", "setting=direct", "planning.rollouts=10", "seed=1",
    "results=results",
)  # fmt: skip


def start(*overrides, cwd):
    return forked.call("ablation", *overrides, cwd=cwd, timeout=600)


def run(*overrides, cwd):
    done = start(*overrides, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def jobs(folder):
    return sorted((folder / "runs" / "ablation" / "xi" / "smoke").rglob("metrics.json"))


def rows(folder):
    with (folder / "results" / "ablation.csv").open() as file:
        return sorted((row["setting"].partition(",")[0], row["seed"]) for row in csv.DictReader(file))


@pytest.mark.slow
def test_the_jobs_of_a_cluster_are_gathered_too(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    run(*SMALL, "hydra/launcher=submitit_local", cwd=tmp_path)
    assert len(jobs(tmp_path)) == 1 and rows(tmp_path) == [("direct", "1")]


def test_only_jobs_of_the_present_command_are_counted(tmp_path):
    earlier = tmp_path / "runs" / "ablation" / "xi" / "smoke" / "direct"
    for name in ("other", "agent.critics-0"):
        (earlier / name / "seed_1").mkdir(parents=True)
        (earlier / name / "seed_1" / "error.txt").write_text("error: earlier\n")
    words = ("experiment=smoke", "system=xi", "setting=direct", "seed=1", "results=results", "agent.critics=1,0")
    done = start(*words, "hydra/launcher=basic", cwd=tmp_path)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2 and last.startswith("error: 2 ")
    assert re.findall(r"direct/(\S+?)/seed_1", last) == ["agent.critics-0", "agent.critics-1"]
    assert (earlier / "other" / "seed_1" / "error.txt").read_text() == "error: earlier\n"
