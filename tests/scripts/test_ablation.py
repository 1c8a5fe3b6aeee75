"""The ablation as a user runs it: interrupted, it goes on where it was."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import forked
import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "ablation.py"
SMALL = (
    "experiment=smoke", "system=xi", "train.episodes=1", "train.updates_per_step=0.02", "scenario.episodes=2",
    "excitation.duration=2", "task.max_steps=50", "setting=direct,rollouts_400", "planning.rollouts=10", "seed=1",
    "results=results",
)  # fmt: skip


def start(*overrides, cwd):
    command = [sys.executable, str(SCRIPT), *overrides]
    return forked.run(command, cwd=cwd, timeout=600)


def run(*overrides, cwd):
    done = start(*overrides, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def jobs(folder):
    return sorted((folder / "runs" / "ablation" / "xi" / "smoke").rglob("metrics.json"))


def rows(folder):
    with (folder / "results" / "ablation.csv").open() as file:
        return sorted((row["setting"].partition(",")[0], row["seed"]) for row in csv.DictReader(file))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["setting=direct,oracle", "planning.updatez=3", "planning.rollouts=0,400"],
            "'updatez' does not exist in 'planning'; allowed are bounds, every, generations, horizon, recent_steps, "
            "rollouts",
        ),
        (
            ["planning.rolouts=0,400", "planning.updatez=3", "seed=0,1"],
            "'rolouts' does not exist in 'planning'; allowed are bounds, every, generations, horizon, recent_steps, "
            "rollouts; did you mean 'rollouts'?",
        ),
        (
            ["experiment=nothing", "seed=0,1"],
            "'nothing' does not exist in 'experiment'; allowed are dyna, gradient, gradient_smoke, paper, smoke, tune",
        ),
    ],
)
def test_of_a_mistake_beside_several_values_the_mistake_is_said(tmp_path, words, said):
    done = start("system=tras", *words, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr == f"error: {said}\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_an_interrupted_ablation_goes_on_and_ends_with_tables_and_figures(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    run(*SMALL, "hydra/launcher=joblib", cwd=tmp_path)
    interrupted, other = jobs(tmp_path)
    interrupted.unlink()
    before = other.stat().st_mtime_ns
    run(*SMALL, "hydra/launcher=basic", cwd=tmp_path)
    assert other.stat().st_mtime_ns == before
    assert json.loads(interrupted.read_text())["seed"] == 1
    with (interrupted.parent / "scalars" / "scalars" / "return.csv").open() as file:
        assert len(file.readlines()) == 1  # the interrupted run's log did not stay
    assert rows(tmp_path) == [("direct", "1"), ("rollouts_400", "1")]
    assert (tmp_path / "results" / "average_rewards_xi_smoke.png").is_file()
    assert "| xi | smoke | direct" in (tmp_path / "results" / "ablation.md").read_text()


@pytest.mark.slow
def test_the_jobs_of_a_cluster_are_gathered_too(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    run(*SMALL, "hydra/launcher=submitit_local", cwd=tmp_path)
    assert len(jobs(tmp_path)) == 2
    assert rows(tmp_path) == [("direct", "1"), ("rollouts_400", "1")]


GATHER = """
import sys
sys.path.insert(0, sys.argv[1])
from ablation import Gathering
from command import Sweep
from omegaconf import OmegaConf
config = {"hydra": {"sweep": {"dir": "runs"}}, "results": "results"}
config["level"] = {"_target_": "dynasindy.evaluation.ablation.Level"}
Gathering().on_multirun_end(OmegaConf.create(config))
print(Sweep.wrong)
"""


def test_jobs_that_all_fail_leave_no_tables_and_each_is_named_by_what_it_has_of_its_own(tmp_path):
    words = ("hydra/launcher=basic", "agent.critics=1,0", "setting=direct", "seed=1,2")
    command = [sys.executable, str(SCRIPT), *SMALL, *words]
    done = forked.run(command, cwd=tmp_path, timeout=600)
    assert done.returncode == 2 and "Warning" not in done.stderr
    assert done.stderr.strip().splitlines()[-1].startswith("error: 4 jobs failed; error.txt says why in ")
    own = [(critics, seed) for seed in (1, 2) for critics in (1, 0)]
    named = {line.partition(": ")[2] for line in done.stdout.splitlines() if line.startswith("Job ")}
    assert named == {f"seed={seed} agent.critics={critics}" for critics, seed in own}
    assert "No run in runs/ablation has finished" in done.stdout
    assert not list((tmp_path / "results").iterdir())


def test_only_jobs_of_the_present_command_are_counted(tmp_path):
    earlier = tmp_path / "runs" / "ablation" / "xi" / "smoke" / "direct"
    for name in ("other", "agent.critics-0"):
        (earlier / name / "seed_1").mkdir(parents=True)
        (earlier / name / "seed_1" / "error.txt").write_text("error: earlier\n")
    words = ("experiment=smoke", "system=xi", "setting=direct", "seed=1", "results=results", "agent.critics=1,0")
    command = [sys.executable, str(SCRIPT), *words, "hydra/launcher=basic"]
    done = forked.run(command, cwd=tmp_path, timeout=600)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2 and last == (
        "error: 2 jobs failed; error.txt says why in runs/ablation/xi/smoke/direct/agent.critics-0/seed_1, "
        "runs/ablation/xi/smoke/direct/agent.critics-1/seed_1"
    )
    assert (earlier / "other" / "seed_1" / "error.txt").read_text() == "error: earlier\n"


@pytest.mark.slow
def test_a_finished_run_of_other_settings_stays_untouched_and_the_refusal_lies_beside_it(tmp_path):
    folder = tmp_path / "runs" / "ablation" / "xi" / "smoke" / "direct" / "seed_1"
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text("system:\n  mass: 25.0\n")
    (folder / "metrics.json").write_text('{"seed": 1}')
    words = ("experiment=smoke", "system=xi", "setting=direct", "seed=1", "results=results", "hydra/launcher=basic")
    before = {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.iterdir()}
    for _ in range(2):  # the line of an earlier command does not hide that of the next
        command = [sys.executable, str(SCRIPT), *words]
        done = forked.run(command, cwd=tmp_path, timeout=600)
        assert {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.iterdir()} == before
        assert done.returncode == 2
        (line,) = [line for line in done.stderr.splitlines() if "refused" in line]
        assert line.startswith("error: 1 jobs were refused") and line.endswith("direct/seed_1.error.txt")
    assert "holds a run of other settings" in folder.with_name("seed_1.error.txt").read_text()


def test_a_table_that_cannot_be_read_is_one_line_before_the_first_job(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "ablation.csv").write_text("\n")
    command = [sys.executable, str(SCRIPT), *SMALL, "hydra/launcher=basic"]
    done = forked.run(command, cwd=tmp_path, timeout=600)
    assert done.returncode == 2 and "Job 1" not in done.stdout
    (line,) = [line for line in done.stderr.splitlines() if not line.startswith("sweep: ")]
    assert line.startswith("error: results/ablation.csv is damaged") and "To make it again" in line
    assert (tmp_path / "results" / "ablation.csv").read_text() == "\n"
    assert not jobs(tmp_path)


def test_a_run_that_cannot_be_read_at_the_end_is_a_line_and_no_warning(tmp_path):
    folder = tmp_path / "runs" / "xi" / "dyna" / "s" / "seed_0"
    folder.mkdir(parents=True)
    (folder / "metrics.json").write_text("{")
    done = subprocess.run([sys.executable, "-c", GATHER, SCRIPT.parent], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert done.stdout.startswith("['runs/xi/dyna/s/seed_0/metrics.json is damaged") and done.stdout.count("\n") == 1
    assert not (tmp_path / "results").exists()


def test_a_device_that_is_not_there_costs_one_line_and_leaves_nothing(tmp_path):
    command = [sys.executable, str(SCRIPT), *SMALL, "hydra/launcher=basic", "device=tpu"]
    done = forked.run(command, cwd=tmp_path, timeout=600)
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if not line.startswith("sweep: ")]
    assert line.startswith("error: device=tpu is not to be had; on this machine there is")
    assert not list(tmp_path.iterdir())
