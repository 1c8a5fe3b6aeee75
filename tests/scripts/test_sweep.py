"""What the jobs of a sweep differ in and what is said at its end, in a process that listens to signals."""

import os
import sys
from pathlib import Path

import forked
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
COUNT = """
import sys
sys.path.insert(0, sys.argv[1])
from command import swept_keys
from omegaconf import OmegaConf
config = OmegaConf.create({"hydra": OmegaConf.create(sys.argv[2])})
print(*sorted(swept_keys(config)))
"""

END = """
import sys
sys.path.insert(0, sys.argv[1])
from command import end_sweep
from omegaconf import OmegaConf
try:
    end_sweep(OmegaConf.create({"hydra": {"sweep": {"dir": sys.argv[2]}, "job": {}}}), 1e6)
except ValueError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("config", "names"),
    [
        ("{sweeper: {params: {seed: range(5)}}, overrides: {task: ['setting=a,b', system=xi]}}", "seed setting"),
        ("{sweeper: {params: {seed: range(5)}}, overrides: {task: ['+x=a,b', seed=3]}}", "x"),  # the last counts
        ("{sweeper: {params: null}, overrides: {task: ['data.path=[1,2]']}}", ""),  # a list is one value
    ],
)
def test_what_the_jobs_of_a_sweep_differ_in_is_named(config, names):
    done = forked.run([sys.executable, "-c", COUNT, SCRIPTS, config])
    assert (done.stdout, done.stderr) == (f"{names}\n", "")


def test_the_end_of_a_sweep_knows_the_failed_jobs(tmp_path):
    for job in "12":
        (tmp_path / job).mkdir()
        (tmp_path / job / "error.txt").touch()
    os.utime(tmp_path / "2" / "error.txt", (1e5, 1e5))  # of an earlier sweep
    done = forked.run([sys.executable, "-c", END, SCRIPTS, tmp_path])
    first, last = done.stdout.splitlines()
    assert (first, done.stderr) == (f"Sweep: {tmp_path}", "")
    assert last.startswith("1 jobs failed") and f"{tmp_path}/1/error.txt" in last
