"""The identification command writes what it found, and says in one line what is wrong."""

import json
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import forked
import pytest
import torch
import yaml

from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Aprbs
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum

REPOSITORY = Path(__file__).parents[2]
QUICK = "world_model.refinement.method=one_step"


def _run(folder: Path, *words: str) -> subprocess.CompletedProcess:
    return forked.run(
        [sys.executable, "scripts/identify.py", f"folder={folder}", f"hydra.run.dir={folder}", *words],
        cwd=REPOSITORY,
        timeout=300,
    )


def test_the_pendulum_is_identified_and_everything_written(tmp_path):
    done = _run(tmp_path / "run", "system=pendulum", "excitation.duration=5", "data.validation_seconds=2")
    assert done.returncode == 0, done.stderr
    assert "Omega' = -0.5 Omega + 12 u - 9.81 sin(theta)" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["run"], "nothing is left beside it"
    names = {p.name for p in (tmp_path / "run").iterdir()}
    assert {
        "model.json",
        "metrics.json",
        "report.txt",
        "coefficients.csv",
        "coefficients.txt",
    } <= names
    assert {"training_data.png", "prediction.png"} <= names
    assert max(json.loads((tmp_path / "run/metrics.json").read_text())["open_loop_nrmse"].values()) < 1e-4


IDENTIFIED = """
import sys
sys.argv = ["identify", "data=csv", "data.path=log.csv", "folder=run", "formats=[]"]
import identify
identify.main()
import dynasindy
print(*dynasindy.identify(dynasindy.read("log.csv"), {library!r}).equations())
print(*sys.modules)
"""


def test_a_log_is_identified_without_what_plans_and_draws(tmp_path, write_log):
    speed, u = [0.0], torch.tensor([1.0, -0.5, 0.3, 0.8]).repeat_interleave(20)
    for value in u:
        speed.append(float(value + math.exp(-0.02) * (speed[-1] - value)))
    write_log(tmp_path / "log.csv", ["speed [m/s]", "u"], torch.tensor(speed[:-1])[:, None], u[:, None])
    environment = {**os.environ, "PYTHONPATH": f"{REPOSITORY}{os.pathsep}{REPOSITORY / 'scripts'}"}
    code = [sys.executable, "-c", IDENTIFIED.format(library=["speed", "u"])]
    done = subprocess.run(code, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    *_, equations, modules = done.stdout.splitlines()
    assert equations == "speed' = -2 speed + 2 u" and (tmp_path / "run/model.json").is_file()
    assert not {"torchrl", "tensordict", "gymnasium", "matplotlib", "pysindy", "sympy"} & set(modules.split())


def next_command(done):
    """Return the words of the first command that is said to come next."""
    assert done.returncode == 0, done.stderr
    return shlex.split(done.stdout.partition("next:\n")[2].splitlines()[0], comments=True)


@pytest.mark.slow
def test_what_is_said_to_come_next_runs_as_it_stands_and_has_all_that_was_given(tmp_path, write_log):
    """The angle of a pendulum alone, whose rate is estimated with the model, whether it was named or not."""
    data = record_plant(Pendulum(), Aprbs(1, duration=6.0, amplitude=0.4, seed=0).samples(0.01), 0.01)
    log = write_log(tmp_path / "my log.csv", ["theta [rad]", "u"], data.x[:, :1], data.u)
    given = ["data=csv", f"data.path='{log}'", "plant.start={theta: [-0.1, 0.1]}"]
    words = [*given, "plant.known={theta: theta_rate}"]
    second = _run(tmp_path / "second", *words)
    alone = _run(tmp_path / "alone", *given)
    metrics = [json.loads((tmp_path / name / "metrics.json").read_text()) for name in ("second", "alone")]
    codes = [[each["code"] for each in found.pop("findings")] for found in metrics]
    assert codes[0][-1] == codes[1][-1] == "model.predicts"
    assert metrics[0].keys() == metrics[1].keys()
    models = [SindyModel.load(tmp_path / name / "model.json") for name in ("second", "alone")]
    assert [model.signature.state_names for model in models] == [("theta", "theta_rate")] * 2
    assert next_command(alone)[2 : 2 + len(given)] == given
    _, script, *words = next_command(second)
    assert script == "scripts/train.py" and words[:4] == [*given, "plant.known={theta: theta_rate}"]
    assert {"plant.outputs=[theta]", f'model="{tmp_path}/second/model.json"'} < set(words)
    more = ["planning.updates=1", "planning.rollouts=4", "evaluation.must_control=false", f"folder={tmp_path}/run"]
    command = [sys.executable, script, *words, *more]
    done = forked.run(command, cwd=REPOSITORY, timeout=300)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "controller.json").is_file()


def test_ends_of_actuators_that_are_guessed_are_said_until_they_are_given(tmp_path, write_log):
    """A valve that was opened by 10 to 87 %, and a fan between 0.1 and 0.6 of what it can."""
    share = torch.rand(60, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    share[7] = 1.0
    u, level = (0.1 + share * torch.tensor([0.77, 0.5])).repeat_interleave(10, 0), [0.2]
    for valve, fan in u[:-1].tolist():
        level.append(level[-1] + 0.01 * (5 * valve - 7 * level[-1] - 2 * fan))
    heads, x = ["level [m]", "u_valve [%]", "u_fan"], torch.tensor(level, dtype=torch.float64).unsqueeze(-1)
    log = write_log(tmp_path / "log.csv", heads, x, u * torch.tensor([100.0, 1.0]))
    first = _run(tmp_path / "first", "data=csv", f"data.path={log}", QUICK)
    said = set(re.findall(r"'data\.inputs=([^']+)'", first.stdout))
    ends = {"u_valve": {"name": "u_valve", "low": 0, "high": 87}, "u_fan": {"name": "u_fan", "low": 0, "high": 1}}
    assert ends in map(yaml.safe_load, said), said
    word = next(f"data.inputs={text}" for text in said if yaml.safe_load(text) == ends)
    words = ["data=csv", f"data.path={log}", word, QUICK]
    second = _run(tmp_path / "second", *words)
    assert f"'{word}'" not in second.stdout.partition("next:\n")[0], "they are given now"
    assert word in shlex.split(second.stdout.partition("next:\n")[2], comments=True)


def test_a_rate_that_the_tool_named_may_be_named_in_a_library(tmp_path, write_log):
    data = record_plant(Pendulum(), Aprbs(1, duration=6, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    path = write_log(tmp_path / "log.csv", ["theta [rad]", "u"], data.x[:, :1], data.u)
    words = f"data=csv data.path={path} refinement=trajectory longest_delay=0 formats=[]".split()
    done = _run(tmp_path / "run", *words, "plant.library=[theta_rate,u,sin(theta)]")
    assert done.returncode == 0, done.stderr
    model = SindyModel.load(tmp_path / "run" / "model.json")
    assert model.signature.state_names == ("theta", "theta_rate")
    assert float(model.coefficients[2, 1]) == pytest.approx(-9.81, rel=0.02)
