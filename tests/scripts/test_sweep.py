"""What is said at the end of a sweep, in a process of its own, as a command listens to signals."""

import os
import sys
from pathlib import Path

import forked

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
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


def test_the_end_of_a_sweep_knows_the_failed_jobs(tmp_path):
    for job in "12":
        (tmp_path / job).mkdir()
        (tmp_path / job / "error.txt").touch()
    os.utime(tmp_path / "2" / "error.txt", (1e5, 1e5))  # of an earlier sweep
    done = forked.run([sys.executable, "-c", END, SCRIPTS, tmp_path])
    first, *_, last = done.stdout.splitlines()
    assert (first, done.stderr) == (f"Sweep: {tmp_path}", "")
    assert last.startswith("1 jobs failed") and f"{tmp_path}/1/error.txt" in last
