"""A run that is killed, terminated or interrupted at any moment goes on, and ends bit for bit as if it never was.

DYNASINDY_MOMENTS=50 tries as many moments of each experiment; DYNASINDY_MOMENTS_CSV names a file for the rows.
"""

import csv
import os
import random
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import forked
import pytest
from leftovers import left_by

ROOT = Path(__file__).resolve().parents[2]
MOMENTS = int(os.environ.get("DYNASINDY_MOMENTS", 1))
SMALL = (
    "system=xi", "env.dt=0.1", "env.substeps=3", "task.max_steps=25", "excitation.duration=2.5",
    "scenario.episodes=2", "scenario.seconds=5", "evaluation.every=2",
)  # fmt: skip
EXPERIMENTS = {
    "dyna": (
        "experiment=dyna", "evaluation.must_improve=false", "train.episodes=3",
        "train.updates_per_step=2",
        "planning.rollouts=20", "planning.horizon=20", "agent.hidden=[32,32]", "replay.capacity=10000",
        "replay.model_capacity=1500",
    ),
    "default": (
        "evaluation.must_improve=false", "planning.updates=10",
        "planning.more_updates=10", "planning.rollouts=8", "planning.window=20",
    ),
}  # fmt: skip
CODES = {"SIGKILL": -9, "SIGINT": 130, "SIGTERM": 143}


@pytest.fixture(scope="module")
def whole(tmp_path_factory, command):
    """Return, once for each experiment, what the run that nobody stops leaves, and how long it takes [s]."""
    found = {}

    def make(name):
        if name not in found:
            home, begun = tmp_path_factory.mktemp(name), time.perf_counter()
            done = command("train", *EXPERIMENTS[name], *SMALL, "hydra.run.dir=run", cwd=home)
            assert done.code == 0, done
            found[name] = left_by(home / "run", "origin.json"), time.perf_counter() - begun
        return found[name]

    return make


@pytest.mark.slow
@pytest.mark.parametrize("number", range(MOMENTS))
@pytest.mark.parametrize(("how", "name"), [("SIGKILL", "dyna"), ("SIGINT", "dyna"), ("SIGTERM", "default")])
def test_a_run_stopped_at_a_random_moment_ends_as_the_one_that_was_not(tmp_path, command, whole, how, name, number):
    expected, seconds = whole(name)
    moment = random.Random(f"{how} {name} {number}").uniform(0.0, 1.0)
    words, home = [*EXPERIMENTS[name], *SMALL, "hydra.run.dir=run"], tmp_path / "home"
    home.mkdir()
    running = forked.Running(forked.script("train", *words, before=forked.DRAWING_NOTHING), home)
    time.sleep(moment * seconds)
    running.send(getattr(signal, how))
    done = running.end()
    stopped = done.returncode != 0  # it may have ended before
    if stopped:
        assert done.returncode == CODES[how], done
    if stopped and how != "SIGKILL":
        assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr, done
        assert len(re.findall(r"(?:^|[\r\n])stopped", done.stderr)) == 1, done
    begun = (home / "run" / "config.yaml").is_file()
    place = re.findall(r"up to the end of ([^:]*):", done.stderr)
    again = command("train", *(["resume=run"] if begun else words), cwd=home)
    assert again.code == 0, again
    found = left_by(home / "run", "origin.json")
    if file := os.environ.get("DYNASINDY_MOMENTS_CSV"):
        row = [how, name, number, f"{moment:.3f}", int(stopped), done.returncode, *place[:1], int(found == expected)]
        with Path(file).open("a") as table:
            csv.writer(table, lineterminator="\n").writerow(row)
    assert found == expected


def test_a_full_disk_costs_one_line_and_no_good_checkpoint(tmp_path, command, whole):
    expected, _ = whole("dyna")
    words, home = [*EXPERIMENTS["dyna"], *SMALL, "hydra.run.dir=run"], tmp_path / "home"
    home.mkdir()
    # As on a full disk, larger files cannot be written.
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))"
    done = forked.run(forked.script("train", *words, before=full + forked.DRAWING_NOTHING), cwd=home)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: ") and "checkpoints/" in last, done
    again = command("train", "resume=run", cwd=home)
    assert again.code == 0 and left_by(home / "run", "origin.json") == expected


FICKLE = """
import os, signal
from pathlib import Path
from dynasindy.systems import Xi
class Fickle(Xi):
    def forward(self, x, u):
        if any(Path("run").glob("checkpoints/*.pt")) and not Path("stopped").exists():
            Path("stopped").touch()
            os.kill(os.getpid(), signal.SIGINT)
        return super().forward(x, u)
"""
"""A plant that stops its run once, as soon as there is a checkpoint."""


def test_a_run_with_a_class_of_the_user_s_own_goes_on_by_the_command_that_is_printed(tmp_path, command, monkeypatch):
    (tmp_path / "fickle.py").write_text(FICKLE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), os.pathsep)
    words = [*EXPERIMENTS["default"], *SMALL, "system._target_=fickle.Fickle", "hydra.run.dir=run"]
    for name in ("whole", "parts"):
        (tmp_path / name).mkdir()
    (tmp_path / "whole" / "stopped").touch()
    assert command("train", *words, cwd=tmp_path / "whole").code == 0
    done = command("train", *words, cwd=tmp_path / "parts")
    assert done.code == 130, done
    (told,) = re.findall(r"(python \S*scripts/train\.py .*?) \(", done.err)
    _, _, *again = shlex.split(told)
    assert "plugins=[fickle]" in again
    refused = command("train", *(word for word in again if "plugins" not in word), cwd=tmp_path / "parts")
    assert refused.code == 2 and "fickle" in refused.err
    assert command("train", *again, cwd=tmp_path / "parts").code == 0
    ours, theirs = (left_by(tmp_path / name / "run", "origin.json") for name in ("parts", "whole"))
    assert ours == theirs and {"policy.pt", "metrics.json", "progress.csv", "model.json"} <= set(ours)


def test_a_signal_during_the_imports_costs_one_line(tmp_path):
    command = [sys.executable, str(ROOT / "scripts" / "train.py"), "experiment=smoke"]
    child = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while "/torch/lib/" not in Path(f"/proc/{child.pid}/maps").read_text() and time.monotonic() < deadline:
        time.sleep(0.01)
    child.send_signal(signal.SIGINT)
    _, error = child.communicate(timeout=60)
    assert child.returncode == 130
    assert error.startswith("stopped") and error.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_a_run_goes_on_with_its_own_settings_only(tmp_path, refused, command):
    assert "nowhere" in refused("train", "resume=nowhere", cwd=tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").write_text("seed: 1\n")
    done = command("train", "resume=run", "system=xi", cwd=tmp_path)
    assert done.code == 2 and "system=xi" in done.err and done.err.count("\n") == 1
    assert (tmp_path / "run" / "config.yaml").read_text() == "seed: 1\n"
