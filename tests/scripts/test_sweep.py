"""How many jobs a sweep has and what is said at its end, in a process of its own, as a command listens to signals."""

import sys
from pathlib import Path

import forked
import pytest

from dynasindy.dyna.folder import claimed

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
COUNT = """
import sys
sys.path.insert(0, sys.argv[1])
from command import number_of_jobs, swept
from omegaconf import OmegaConf
config = OmegaConf.create(sys.argv[2])
print(number_of_jobs(config), *swept(config))
"""

END = """
import sys
sys.path.insert(0, sys.argv[1])
from command import Sweep
from omegaconf import OmegaConf
try:
    Sweep().on_multirun_end(OmegaConf.create({"hydra": {"sweep": {"dir": sys.argv[2]}}}))
except Exception:
    print("it failed")
print(Sweep.failed)
"""


CAME = """
import os, sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from command import Sweep
folder = Path(sys.argv[2])
Sweep.earlier = {file: file.stat().st_mtime_ns for file in folder.rglob("error.txt")}
again = folder / "again" / "error.txt"
os.utime(again, ns=(0, Sweep.earlier[again] + 1))
for Sweep.jobs in (None, {folder / name for name in ("again", "kept", "done", "unbegun")}):
    print(*("/".join(job.name for job in jobs) for jobs in Sweep.came(folder)))
"""


BEGIN = """
import sys
sys.path.insert(0, sys.argv[1])
from command import Sweep
from omegaconf import OmegaConf
hydra = {"sweep": {"dir": sys.argv[2]}, "sweeper": {"params": None}, "overrides": {"task": ["seed=1,2"]}}
Sweep().on_multirun_start(OmegaConf.create({"hydra": hydra}))
print("begun")
"""


@pytest.mark.parametrize(
    ("config", "jobs"),
    [
        ("{sweeper: {params: {seed: range(5)}}, overrides: {task: ['setting=a,b', system=xi]}}", "10 seed setting"),
        ("{sweeper: {params: {seed: range(5)}}, overrides: {task: ['+x=a,b', seed=3]}}", "2 +x"),  # the last counts
        ("{sweeper: {params: null}, overrides: {task: ['data.path=[1,2]']}}", "1"),  # a list is one value
        ("{sweeper: {n_trials: 7, params: {lr: 'interval(0,1)'}}, overrides: {task: ['seed=1,2']}}", "7 lr seed"),
    ],
)
def test_the_jobs_of_a_sweep_are_counted_and_what_they_differ_in_is_named(config, jobs):
    done = forked.run([sys.executable, "-c", COUNT, SCRIPTS, config])
    assert (done.stdout, done.stderr) == (f"{jobs}\n", "")


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (
            "{best_params: {planning.lr: 0.0123456, planning.width: 12345, agent: td3}, best_value: 0.0456789}",
            "Best trial: planning.lr=0.01235 planning.width=12345 agent=td3, score 0.04568; plan with these words, "
            "and judge on another log\n",
        ),
        ("{solutions: [{params: {seed: 1}, values: [0.1, 0.2]}]}", ""),  # two objectives
        ("{best_params: {seed: 1}}", "it failed\n"),
        ("", ""),  # nothing was found
    ],
)
def test_the_end_of_a_sweep_tells_the_best_trial_and_knows_the_failed_jobs(tmp_path, found, said):
    (tmp_path / "optimization_results.yaml").write_text(found)
    (tmp_path / "1").mkdir()
    (tmp_path / "1" / "error.txt").write_text("error: a job\n")
    done = forked.run([sys.executable, "-c", END, SCRIPTS, tmp_path])
    assert (done.stdout, done.stderr) == (f"Sweep: {tmp_path}\n{said}['{tmp_path / '1'}']\n", "")


def test_a_job_counts_as_failed_only_by_a_line_of_this_command_and_as_done_only_if_it_is_one_of_it(tmp_path):
    files = ("again/error.txt", "again/metrics.json", "kept/error.txt", "done/metrics.json", "other/metrics.json")
    for file in files:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("error: a job\n")
    done = forked.run([sys.executable, "-c", CAME, SCRIPTS, tmp_path])
    assert (done.stdout, done.stderr) == ("done/other again\ndone again\n", "")


def test_a_second_sweep_in_a_folder_where_one_has_just_begun_is_refused_in_one_line(tmp_path):
    """As long as there is no result, neither could tell its jobs from those of the other one."""
    folder = tmp_path / "sweep"
    command = [sys.executable, "-c", BEGIN, SCRIPTS, folder]
    with claimed(folder):
        done = forked.run(command)
    assert done.returncode == 2 and "begun" not in done.stdout
    assert done.stderr.splitlines()[-1].startswith(f"error: another process works in {folder}")
    done = forked.run(command)
    assert done.returncode == 0 and done.stdout == "begun\n"
