"""A sweep and an ablation: a job for each setting, nothing done twice, and a code that says whether all went well."""

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TINY = (
    "system=xi", "env.dt=0.1", "task.max_steps=25", "excitation.duration=2.5",
    "scenario.episodes=2", "scenario.seconds=5", "train.episodes=1",
)  # fmt: skip
SWEEP = ("-m", *TINY, "planning.updates=10", "planning.more_updates=10", "planning.window=20", "planning.rollouts=-5,4")
ABLATION = (
    "experiment=smoke", *TINY, "train.updates_per_step=0.02", "setting=direct,rollouts_400", "planning.rollouts=10",
    "results=results",
)  # fmt: skip
CODES = {"SIGKILL": -9, "SIGTERM": 143}


def jobs(folder):
    return sorted((folder / "runs").rglob("metrics.json"))


def rows(folder):
    with (folder / "results" / "ablation.csv").open() as file:
        return sorted((row["setting"].partition(",")[0], row["seed"]) for row in csv.DictReader(file))


def test_a_job_that_fails_ends_no_sweep_and_what_is_finished_is_not_repeated(command, tmp_path):
    times = []
    for figures, again in ((False, False), (True, False), (True, True)):  # first as if stopped before its figures
        done = command("train", *SWEEP, cwd=tmp_path, figures=figures)
        last = done.err.splitlines()[-1]
        assert done.code == 2 and last.startswith("error: 1 ") and "Traceback" not in done.err
        (metrics,) = (tmp_path / "runs").glob("*/*/metrics.json")
        (failed,) = (tmp_path / "runs").glob("*/*/error.txt")
        assert "rollouts=-5" in failed.read_text() and "rollouts-4" in metrics.parent.name
        assert failed.parent.name in last
        times.append(metrics.stat().st_mtime_ns)
        assert ("finished before" in done.out) == again and str(metrics.parent) in done.out
    assert len(set(times)) == 1 and (metrics.parent / "figures" / "step_response.png").is_file()


def test_what_all_jobs_share_is_checked_before_the_first(refused, tmp_path):
    box = ("plant.outputs=[alpha_a,omega_a]", "plant.low=[-1,-1]", "plant.high=[1,1]", "plant.rates=[Omega_a]")
    assert "null" in refused("train", "-m", "seed=1,2", "system=tras", *box, cwd=tmp_path)
    assert "threads" in refused("ablation", *ABLATION, "hydra/launcher=basic", "threads=1000000", cwd=tmp_path)
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "ablation.csv").write_text("\n")
    assert "ablation.csv" in refused("ablation", *ABLATION, "hydra/launcher=basic", cwd=tmp_path)
    assert (tmp_path / "results" / "ablation.csv").read_text() == "\n"


def test_jobs_that_all_fail_leave_no_tables(command, tmp_path):
    words = ("hydra/launcher=basic", "agent.critics=1,0", "setting=direct", "seed=1,2")
    done = command("ablation", *ABLATION, *words, cwd=tmp_path)
    assert done.code == 2 and done.err.splitlines()[-1].startswith("error: 4 ")
    assert len(list(tmp_path.rglob("error.txt"))) == 4 and not list((tmp_path / "results").iterdir())


@pytest.mark.slow
def test_an_interrupted_ablation_goes_on_and_ends_with_tables_and_figures(command, tmp_path):
    words = (*ABLATION, "seed=1", "hydra/launcher=basic")
    assert command("ablation", *words, cwd=tmp_path).code == 0
    interrupted, other = jobs(tmp_path)
    interrupted.unlink()
    before = other.stat().st_mtime_ns
    done = command("ablation", *words, cwd=tmp_path, figures=True)
    assert done.code == 0 and other.stat().st_mtime_ns == before
    assert json.loads(interrupted.read_text())["seed"] == 1
    with (interrupted.parent / "progress.csv").open() as file:
        assert len(file.readlines()) == 2  # the interrupted run's log did not stay
    assert rows(tmp_path) == [("direct", "1"), ("rollouts_400", "1")]
    assert (tmp_path / "results" / "average_rewards_xi_smoke.png").is_file()
    assert (tmp_path / "results" / "ablation.md").is_file()


def workers(folder):
    """Return the processes that work below a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder) in str((process / "cwd").resolve()) and b"python" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except OSError:
            continue
    return found


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGKILL", "SIGTERM"])
def test_an_ablation_that_is_stopped_leaves_no_workers_and_goes_on(command, tmp_path, how):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    words = (*ABLATION, "seed=1,2")
    program = [sys.executable, str(ROOT / "scripts" / "ablation.py"), *words]
    program += ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    child = subprocess.Popen(program, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    while not (done := jobs(tmp_path)) and child.poll() is None:
        time.sleep(0.1)
    child.send_signal(getattr(signal, how))
    _, error = child.communicate(timeout=60)
    assert child.returncode == CODES[how], error
    deadline = time.monotonic() + 30
    while workers(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not workers(tmp_path)
    before = done[0].stat().st_mtime_ns
    again = command("ablation", *words, "hydra/launcher=basic", cwd=tmp_path)
    assert again.code == 0 and done[0].stat().st_mtime_ns == before, again
    assert len(jobs(tmp_path)) == 4 and (tmp_path / "results" / "ablation.md").is_file()
