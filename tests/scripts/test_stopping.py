"""A plan from a log that is stopped keeps its equations once it has them, and nothing before."""

import shlex
from pathlib import Path

import forked
import pytest

from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.systems import Pendulum


@pytest.fixture(scope="module")
def log(tmp_path_factory, write_log):
    data = record_plant(Pendulum(), Multisine(1, duration=10, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    return write_log(tmp_path_factory.mktemp("log") / "log.csv", ["theta [rad]", "u"], data.x[:, :1], data.u)


def stopped_at(phase, log, tmp_path):
    """Stop a plan from a log as soon as it reports a phase; return its exit code and its last line."""
    words = ["data=csv", f"data.path={log}", "plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]"]
    words += ["plant.known={theta: rate}", "plant.library=[rate,u,'sin(theta)']", "planning.rollouts=8", "folder=run"]
    words += ["world_model.refinement.method=trajectory"]
    stopper = f"""
import os, signal
from dynasindy import progress
def stop(what):
    if what.phase.startswith({phase!r}):
        progress._listeners.remove(stop)
        os.kill(os.getpid(), signal.SIGTERM)
progress._listeners.append(stop)
"""
    done = forked.run(forked.script("train", *words, before=stopper), cwd=tmp_path)
    return done.returncode, done.stderr.strip().splitlines()[-1]


def test_a_plan_from_a_log_that_is_stopped_in_its_fit_keeps_nothing_and_says_so(log, tmp_path):
    code, line = stopped_at("fit", log, tmp_path)
    assert code == 143 and line.startswith("stopped")
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_a_plan_from_a_log_that_is_stopped_keeps_its_equations_and_goes_on_without_a_fit(log, tmp_path):
    code, line = stopped_at("planning", log, tmp_path)
    assert code == 143 and line.startswith("stopped")
    again = line.partition(": ")[2]
    assert {"config.yaml", "model.json", "origin.json"} == {file.name for file in (tmp_path / "run").iterdir()}
    python, script, *words = shlex.split(again)
    assert (python, Path(script).parts[-2:]) == ("python", ("scripts", "train.py"))
    assert "plant.known={theta: rate}" in words and words[-1] == "model=run/model.json"
    words += ["planning.updates=1", "evaluation.must_control=false"]
    done = forked.call("train", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fit of" not in done.stdout + done.stderr
    assert (tmp_path / "run" / "controller.json").is_file()
