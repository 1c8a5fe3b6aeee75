"""From a log to a controller by the command of README, and what it says where something is missing."""

import hashlib
import json
import os
import sys
from pathlib import Path

import forked
import pytest
import torch
from omegaconf import OmegaConf

from dynasindy.control import load
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum

ROOT = Path(__file__).parents[2]
TASK = ["plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]"]
SHORT = [
    "planning.updates=40",
    "planning.rollouts=32",
    "planning.window=30",
    "scenario.reference.number=8",
    "scenario.episodes=8",
    "task.max_steps=120",
]


@pytest.fixture(scope="module")
def log(tmp_path_factory, write_log):
    data = record_plant(Pendulum(), Multisine(1, duration=10, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    return write_log(path, ["theta [rad]", "Omega [rad/s]", "u"], data.x, data.u)


def train(*words, cwd=None):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "scripts" / "train.py"), *words]
    return forked.run(command, env=environment, timeout=300, cwd=cwd)


WORDS = "plant.library=['1',u,theta,Omega,'sin(theta)']"


def arm():
    """Return theta'' = -9.81 sin(theta) - 0.5 theta' + 12 u, as `identify` might have found it."""
    model = SindyModel(Pendulum().signature, library=["theta", "Omega", "u", "sin(theta)"])
    rows = {"theta": (0, 0), "Omega": (1.0, -0.5), "u": (0, 12.0), "sin(theta)": (0, -9.81)}
    model.coefficients = torch.tensor([rows[name] for name in model.library.names], dtype=torch.float64)
    return model


@pytest.mark.slow
def test_a_plan_that_fails_leaves_the_model(log, tmp_path):
    given = [f"data.path={log}", *TASK, WORDS, "planning.lr=1e18"]
    done = train("data=csv", *given, f"folder={tmp_path}/run")
    assert done.returncode != 0
    assert "Run folder" in done.stdout
    model = SindyModel.load(tmp_path / "run" / "model.json")
    assert any("12 u" in line for line in model.equations())
    assert (tmp_path / "run" / "config.yaml").exists()
    assert (tmp_path / "run" / "origin.json").exists()
    kept = [*given[:-2], "plant.library=['sinh(theta)']", given[-1], f"model={tmp_path}/run/model.json"]
    again = train("data=csv", *kept, f"folder={tmp_path}/again")  # the model has a library: another one is not read
    assert "sinh" not in again.stderr and (tmp_path / "again" / "model.json").exists()


def test_a_controller_that_cannot_be_written_is_not_said_to_be_there(tmp_path):
    arm().save(tmp_path / "model.json")
    (tmp_path / "run" / "controller.json").mkdir(parents=True)
    words = [*TASK, *SHORT, "planning.updates=1", "planning.window=5"]
    done = train("model=model.json", *words, "folder=run", cwd=tmp_path)
    assert done.returncode == 2 and "controller.json" in done.stderr
    assert "Run folder" in done.stdout and "Controller" not in done.stdout


LOGGED = {"data": {"_target_": "dynasindy.identification.identify.LoggedData", "path": "log.csv"}, "system": None}


@pytest.mark.parametrize("settings", [LOGGED, {"rig": {"_target_": "dynasindy.rig.udp.connect"}}])
def test_a_run_without_a_simulated_plant_says_that_there_is_none_to_fly(tmp_path, settings):
    settings = {**settings, "plant": {"outputs": ["theta"]}}
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(settings))
    (tmp_path / "metrics.json").write_text("{}")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "scripts" / "evaluate.py"), f"run={tmp_path}"]
    done = forked.run(command, env=environment, timeout=300)
    assert done.returncode == 2
    assert f"python scripts/check.py run={tmp_path}" in done.stderr


ARM = """# @package _global_
defaults: [black_box, _self_]
system:
  states: {theta: rad}
  inputs: {u: {low: -12, high: 12, unit: V}}
plant: {outputs: [theta], low: [-0.6], high: [0.6]}
"""


@pytest.mark.slow
def test_the_log_of_a_rig_that_is_known_by_names_is_identified_with_its_ends_and_its_rate(tmp_path, write_log):
    """12 V are a torque of 12: Omega' = 12 u - 9.81 sin(theta) - 0.5 Omega of the controller's number u."""
    data = record_plant(Pendulum(), Multisine(1, duration=10, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    path = write_log(tmp_path / "log.csv", ["theta [rad]", "u [V]"], data.x[:, :1], 12 * data.u)
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text(ARM)
    words = ["--config-dir", str(tmp_path), "system=arm", "data=csv", f"data.path={path}", f"folder={tmp_path}/run"]
    functions = "plant.library=['1',u,theta,theta_rate,'sin(theta)']"
    done = train(
        *words, "plant.known={theta: theta_rate}", functions, *SHORT, "env.dt=0.034", "evaluation.must_control=false"
    )
    assert done.returncode == 0, done.stderr
    assert "12 V" in done.stdout
    model = SindyModel.load(tmp_path / "run" / "model.json")
    assert model.signature.input_ends == ((-12.0, 12.0),) and model.signature.input_units == ("V",)
    column = [float(model.coefficients[model.library.index(name), 1]) for name in ("u", "sin(theta)", "theta_rate")]
    assert column == pytest.approx([12.0, -9.81, -0.5], rel=0.02)
    written = json.loads((tmp_path / "run" / "controller.json").read_text())
    assert written["task"]["rates"] == ["theta_rate"]
    # The multiple of 0.01 s between samples that is used, and not what was asked for.
    assert OmegaConf.load(tmp_path / "run" / "config.yaml").env.dt == load(tmp_path / "run").dt == pytest.approx(0.03)


def test_a_job_of_a_sweep_is_done_again_if_its_log_is_another_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    import saved_run

    file, run = tmp_path / "log.csv", tmp_path / "run"
    run.mkdir()
    cfg = OmegaConf.create({"model": None, "data": {"path": str(file)}})
    file.write_text("time,y,u\n")
    read = saved_run._digests(cfg)
    assert read[str(file)] == hashlib.sha256(b"time,y,u\n").hexdigest()
    (run / "origin.json").write_text(json.dumps({"command": "train.py", "read": read}))
    assert saved_run._finished(run, read) is False  # it has forecast nothing yet
    (run / "metrics.json").write_text('{"prediction": {"controlled": true}}')
    assert saved_run._finished(run, read) is True
    assert saved_run._finished(run, saved_run._digests(OmegaConf.merge(cfg, {"seed": 1}))) is False
    file.write_text("time,y,u\n0,1,2\n")
    assert saved_run._finished(run, saved_run._digests(cfg)) is False
