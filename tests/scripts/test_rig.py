"""The command that flies a rig finds mistakes before anything moves, and says how it was stopped."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def command(*words):
    return [sys.executable, str(ROOT / "scripts" / "rig.py"), "system=pendulum", *words]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("targets=[[1,2,3]]", "targets has [1, 2, 3]; give one number for each of theta"),
        ("targets=[[30.0]]", "within plant.low="),
        ("seconds=-1", "fly nothing; give seconds > 0"),
        ("flights=0", "fly nothing; give seconds > 0"),
        ("guard.late=-1", "give numbers >= 0"),
    ],
)
def test_a_mistake_costs_one_line_and_nothing_moves(tmp_path, word, message):
    done = subprocess.run(
        command(word, f"folder={tmp_path}/run"),
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        timeout=200,
        check=False,
    )
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.rglob("*.csv"))


@pytest.mark.slow
def test_ctrl_c_says_that_the_rig_rests_and_where_its_logs_are(tmp_path):
    words = command(f"folder={tmp_path}/run", "guard.late=50")
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT) as flying:
        assert "excitation" in flying.stdout.readline()
        while not list(tmp_path.rglob("excitation.csv")):
            pass
        flying.send_signal(signal.SIGINT)
        _, said = flying.communicate(timeout=100)
    assert flying.returncode == 130
    assert "the rig was asked for its safe input, its logs are in" in said
