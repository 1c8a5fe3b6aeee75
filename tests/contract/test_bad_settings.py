"""A bad setting costs exit code 2 and one line that names it, before any work, and leaves nothing behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONF = ROOT / "conf"
TASK = ["plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]"]


@pytest.mark.parametrize("group", ["agent", "rig", "setting"])
def test_a_misspelt_option_of_any_group(refused, tmp_path, group):
    name = {"rig": "rig", "setting": "ablation"}.get(group, "train")
    options = sorted(file.stem for file in (CONF / group).glob("*.yaml") if not file.stem.startswith("_"))
    line = refused(name, f"{group}={options[0]}x", cwd=tmp_path)
    assert f"'{group}'" in line and f"'{options[0]}x'" in line
    assert all(option in line for option in options)


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("seed", "x"),
        ("device", "tpu"),
        ("env.dt", "-0.05"),
        ("agent.gamma", "1.5"),
        ("replay.capacity", "0"),
        ("gate", "null"),
        ("excitation.duration", "nan"),
        ("agent.hidden", "400"),
        ("task.outputs", "[yaw,alpha_p]"),
        ("world_model.library", "nothing"),
        ("system._target_", "builtins.print"),
        ("folder", "[a]"),
        ("replay.batch_size", "20000"),
        ("+scenario.windows", "[[1]]"),
        ("plant.rates", "[alpha_a,alpha_p]"),
        ("+plant.bounds", "{alpha_a: 0.01}"),
    ],
)
def test_a_bad_value_of_any_part(refused, tmp_path, key, given):
    """One of each kind."""
    line = refused("train", "experiment=smoke", "planning=dyna", f"{key}={given}", cwd=tmp_path)
    assert key.rpartition(".")[2].strip("_+") in line or given.strip("[]") in line


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("planning.rolouts", "'rollouts'"),
        ("duration", "'excitation.duration'"),  # and not evaluation, which is spelt alike
        ("episodes", "'train.episodes' or 'scenario.episodes'"),
        ("planning.seed", "did you mean 'seed'"),
    ],
)
def test_a_key_that_does_not_exist(refused, tmp_path, key, meant):
    planning = ["planning=dyna"] if key.endswith("rolouts") else []
    line = refused("train", *planning, f"{key}=1", cwd=tmp_path)
    assert f"'{key.rpartition('.')[2]}'" in line and meant in line and "allowed are" in line


@pytest.mark.parametrize("words", [["planning.lrr=3", "seed=0,1"], ["-m", "seed=0,1", "planning.lrr=3", "sead=1"]])
def test_the_first_of_several_mistakes_of_a_sweep(refused, tmp_path, words):
    assert "'lrr'" in refused("train", *words, cwd=tmp_path)


@pytest.mark.parametrize("words", [["plant.outputs=[yaw"], ["system=tras", "system"], ["system=logged"]])
def test_words_that_cannot_be_read_or_name_no_plant_to_train_on(refused, tmp_path, words):
    assert words[-1] in refused("train", *words, cwd=tmp_path)


@pytest.mark.parametrize(
    ("words", "key"),
    [
        ([], "plant.outputs"),
        ([*TASK, "planning=dyna"], "planning"),
        ([*TASK, "env.dt=1e9"], "env.dt"),
        (["plant.outputs=[theta]", "plant.low=[-0.6]"], "plant.high"),
        (["plant.outputs=[thta]", *TASK[1:]], "'thta'"),
        ([*TASK, "plant.start={omega: 0}"], "plant.start"),
        ([*TASK, "data.path=nowhere.csv"], "nowhere.csv"),
        ([*TASK, "system=pendulum", "model=model.json"], "model"),
    ],
)
def test_what_is_missing_or_wrong_where_a_log_is_planned_from(refused, log, tmp_path, words, key):
    path = [] if any(word.startswith("data.path") for word in words) else [f"data.path={log}"]
    assert key in refused("train", *words, "data=csv", *path, cwd=tmp_path)


@pytest.mark.parametrize(
    ("name", "words", "key"),
    [
        ("identify", ["sensors=bench", "data=csv", "data.path=log.csv"], "sensors"),
        ("identify", ["system=tras", "plant.library=['1',u_a,'sinh(alpha_a)']", "excitation.duration=10000"], "'sinh'"),
        ("identify", ["data=csv", "data.path=log.csv", "data.states=[a,a]"], "data.states"),
        ("identify", ["system=pendulum", "horizons=[-1]"], "horizons"),
        ("identify", ["system=pendulum", "excitation=chirp", "excitation.band=[0,1e3]"], "excitation.band"),
        ("identify", ["data=csv", "data.path=log.csv", "device=cuda"], "'device'"),
        ("rig", ["system=pendulum", "planner=5"], "planner"),
        ("train", ["system=black_box"], "plant.low"),
        ("evaluate", ["run=nowhere", "scenarios=[]"], "scenarios"),
        ("evaluate", ["run=nowhere"], "nowhere"),
        ("report", ["results=nowhere"], "nowhere"),
        ("table", [], "folder"),
        ("ablation", ["setting=direct,oracle", "planning.updatez=3"], "'updatez'"),
        ("ablation", ["experiment=smoke", "hydra/launcher=basic", "level.error=-1"], "level"),
        ("train", ["sensors.channels={alpha_a: {noise: 1}}"], "sensors=bench"),
        ("train", ["data.path=log.csv"], "data=csv"),
        ("train", ["~planning"], "~planning"),
        ("train", ["-m", "seed=0,1", "--sead"], "--sead"),
        ("train", ["plant.outputs=[alpha_a,alpha_a]"], "plant.outputs"),
        ("train", ["experiment=smoke", "scenario.seconds=0.01"], "scenario.seconds"),
        ("identify", ["system=pendulum", "world_model=oracle"], "world_model"),
        ("train", ["~plant.outputs", "+plant.outputz=[alpha_a]"], "mean 'outputs'"),
        ("train", ["~plant.outputs"], "plant.outputs is not given"),
    ],
)
def test_a_bad_setting_of_any_other_command(refused, tmp_path, name, words, key):
    assert key in refused(name, *words, cwd=tmp_path)


@pytest.mark.parametrize(
    ("word", "key"),
    [
        ("targets=[[1,2,3]]", "targets"),
        ("targets=[[30.0]]", "plant.low"),
        ("flights=0", "seconds"),
        ("guard.low={thta: -1}", "'thta'"),
        ("planner={update: 100}", "'update'"),
        ("rig=udp rig.host=ADDRESS", "rig.host"),
    ],
)
def test_a_bad_setting_of_a_rig_before_anything_moves(command, tmp_path, word, key):
    done = command("rig", "system=pendulum", "folder=run", *word.split(maxsplit=word.count("=") - 1), cwd=tmp_path)
    lines = done.err.splitlines()
    assert done.code == 2 and len(lines) == 1 and key in lines[0]
    assert not list(tmp_path.rglob("*.csv"))


def test_a_file_of_the_user_with_a_slip_is_named_with_its_line(command, tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text("# @package _global_\nplant: {low: [0.1}\n")
    done = command("rig", "--config-dir", str(tmp_path), "system=arm", "folder=run", cwd=tmp_path)
    assert done.code == 2 and "arm.yaml, line 2" in done.err and done.err.count("\n") == 1


def test_a_folder_that_is_a_file(refused, log, tmp_path):
    (tmp_path / "here").write_text("a file")
    line = refused("train", "data=csv", f"data.path={log}", *TASK, f"folder={tmp_path}/here/run", cwd=tmp_path)
    assert "here/run" in line and (tmp_path / "here").read_text() == "a file"


def test_a_command_that_does_not_exist(tmp_path):
    words = [sys.executable, "-m", "dynasindy", "trian"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "'trian'" in done.stderr and "'train'" in done.stderr


SHORT = ("system=pendulum", "experiment=gradient_smoke", "scenario.episodes=2", "excitation.duration=3")
LOG = ("data=csv", "data.path=log.csv")


@pytest.mark.parametrize(
    ("name", "words", "key"),
    [
        ("train", ("device=null",), "device"),
        ("train", ("env.dt=1000",), "env.dt"),
        ("train", ("plant.low=[0.5]", "plant.high=[-0.5]"), "high"),
        ("train", ("plant.bounds={theta: 0.5}", "plant.start={theta: [1, 2]}"), "plant.start has theta"),
        ("train", ("plant.bounds={Omega: [0.5, 2]}",), "plant.start has Omega"),
        ("train", ("plant.amplitude=[0.8]", "plant.offset=[0.5]"), "plant.amplitude"),
        ("train", ("longest_delay=1e9",), "longest_delay"),
        ("identify", (*LOG, "data.states=[theta,u]", "data.inputs=[u]"), "data.states"),
        ("identify", (*LOG, "data.states={a: theta, b: theta}", "data.inputs=[u]"), "data.states"),
        ("identify", (*LOG, "data.states={theta: theta, Omega: {derivative_of: Omega}}"), "data.states"),
        ("identify", (*LOG, "plant.known={theta: theta}"), "plant.known"),
    ],
)
def test_a_setting_that_makes_no_sense_beside_another_one(command, log, tmp_path, name, words, key):
    (tmp_path / "log.csv").write_text(log.read_text())
    before = sorted(tmp_path.iterdir())
    done = command(name, *(SHORT if name == "train" else ()), *words, cwd=tmp_path)
    lines = [line for line in done.err.splitlines() if line.startswith("error: ")]
    assert (done.code, len(lines)) == (2, 1) and "Traceback" not in done.err and key in lines[0], done
    assert name == "train" or sorted(tmp_path.iterdir()) == before


PLANT = """
import torch
from dynasindy.systems import Signature, System

class Failing(System):
    def __init__(self):
        super().__init__(Signature(("p", "v"), ("m", "m/s"), ("force",), (2.0, 3.0)))
        self.count = 0

    def forward(self, x, u):
        self.count += 1
        if self.count > 200:
            {fault}
        p, v = x.unbind(-1)
        return torch.stack((v, 3 * u[..., 0] - v - 2 * p), -1)
"""
YAML = """# @package _global_
system: {_target_: failing.Failing}
plant: {outputs: [p], rates: [v], low: [-0.5], high: [0.5]}
"""


@pytest.mark.parametrize(
    ("fault", "key"),
    [
        ("{}['mass']", "KeyError"),
        ("raise SystemExit(3)", "SystemExit"),
    ],
)
def test_a_plant_that_fails_in_the_middle_of_a_run_is_named(command, tmp_path, monkeypatch, fault, key):
    (tmp_path / "conf" / "system").mkdir(parents=True)
    (tmp_path / "conf" / "system" / "failing.yaml").write_text(YAML)
    (tmp_path / "failing.py").write_text(PLANT.replace("{fault}", fault))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), os.pathsep)
    words = ("--config-dir", str(tmp_path / "conf"), "system=failing", *SHORT[1:], "task.max_steps=60", "folder=run")
    done = command("train", *words, cwd=tmp_path)
    lines = [line for line in done.err.splitlines() if line.startswith("error: ")]
    assert (done.code, len(lines)) == (2, 1) and "Traceback" not in done.err, done
    assert key in lines[0] and "Failing.forward" in lines[0] and "line 13" in lines[0]
    if key == "KeyError":
        monkeypatch.setenv("DYNASINDY_TRACEBACK", "1")
        assert fault in command("train", *words[:-1], "folder=again", cwd=tmp_path).err


ENVIRONMENT = """
import gymnasium
import numpy as np
from gymnasium.spaces import Box

class Mass(gymnasium.Env):
    def __init__(self, low=-1.0, nan=False, values=5):
        self.action_space = Box(np.full(1, low, np.float32), np.ones(1, np.float32))
        self.observation_space = Box(-10.0, 10.0, (2,))
        self.nan, self.values = nan, values

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.count = self.np_random.uniform(-0.1, 0.1, 2).astype(np.float32), 0
        return self.x.copy(), {}

    def step(self, action):
        self.count += 1
        self.x += np.float32(0.05) * np.array([self.x[1], 3 * action[0] - self.x[1] - 2 * self.x[0]], np.float32)
        if self.nan and self.count == 21:
            self.x[1] = np.nan
        return (self.x.copy(), 0.0, False, False, {})[: self.values]

for name, options in {"Nan": {"nan": True}, "Four": {"values": 4}, "Same": {"low": 1.0}}.items():
    gymnasium.register(f"{name}-v0", entry_point=Mass, kwargs=options, disable_env_checker=True)
"""


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        ("Nan", ("step 21", "component 1", "'v'")),
        ("Four", ("step", "five values")),
        ("Same", ("action_space", "low")),
    ],
)
def test_an_environment_of_gymnasium_that_misbehaves(command, tmp_path, monkeypatch, kind, keys):
    (tmp_path / "masses.py").write_text(ENVIRONMENT)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), os.pathsep)
    words = ("plant.states={p: 1.0, v: 2.0}", "plant.inputs=[force]", "plant.outputs=[p]", "plant.library=polynomial")
    words += ("plant.low=[-0.5]", "plant.high=[0.5]", f"env.id=masses:{kind}-v0", "env.dt=0.05", "folder=run")
    done = command("train", "system=gymnasium", *SHORT[1:], *words, cwd=tmp_path)
    lines = [line for line in done.err.splitlines() if line.startswith("error: ")]
    assert (done.code, len(lines)) == (2, 1) and "Traceback" not in done.err, done
    assert all(key in lines[0] for key in keys), lines


def test_latest_names_the_newest_run_and_those_before_it(command, tmp_path):
    for age, name in enumerate(("third", "second", "first")):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "config.yaml").write_text("a: 1\n")
        os.utime(tmp_path / "runs" / name / "config.yaml", (1e9 + age, 1e9 + age))
    for word, name in (("latest", "first"), ("latest~2", "third"), ("latest~3", "latest~3")):
        done = command("export", f"run={word}", cwd=tmp_path)
        assert done.code == 2 and name in done.err
