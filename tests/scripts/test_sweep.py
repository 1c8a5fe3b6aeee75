"""How many jobs a sweep has, counted in a process of its own, as a command listens to signals."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
COUNT = """
import sys
sys.path.insert(0, sys.argv[1])
from command import number_of_jobs
from omegaconf import OmegaConf
print(number_of_jobs(OmegaConf.create(sys.argv[2])))
"""


@pytest.mark.parametrize(
    ("config", "jobs"),
    [
        ("{sweeper: {params: {seed: range(5)}}, overrides: {task: ['setting=a,b', system=xi]}}", 10),
        ("{sweeper: {params: null}, overrides: {task: ['data.path=[1,2]']}}", 1),  # a list is one value
        ("{sweeper: {n_trials: 7}, overrides: {task: ['seed=1,2']}}", 7),
    ],
)
def test_the_jobs_of_a_sweep_are_counted(config, jobs):
    done = subprocess.run([sys.executable, "-c", COUNT, SCRIPTS, config], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"{jobs}\n", "")
