"""The C program that docs/export.md shows compiles, and acts as the controller in Python."""

import math
import re
import subprocess
import sys
from pathlib import Path

import forked
import pytest
import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, save
from dynasindy.control.controller import ControlSetup
from dynasindy.export import controller_sources
from dynasindy.sensing import Observer, Sensors
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.systems.compiler import STRICT, compiler
from dynasindy.tasks import Step, Tracking, TrackingReward

REPOSITORY = Path(__file__).parents[1]
PAGE = (REPOSITORY / "docs" / "export.md").read_text()
PROGRAM = re.search(r"```c\n(.*?)```", PAGE, re.S)[1]
COMMAND = re.search(r"^    gcc (.*)$", PAGE, re.M)[1].split()


@pytest.fixture
def controller():
    signature = Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (1.5, 3.0))
    task = Tracking(signature, Step([[0.0]]), ("theta",), ("Omega",), TrackingReward((1.0,)))
    setup = ControlSetup(task, 0.05, 1)
    model = SindyModel(signature, ["u", "Omega", "sin(theta)"], known={"theta": "Omega"})
    model.set_coefficients(torch.tensor([[0.0, 8.0], [1.0, -0.6], [0.0, -9.5]]))
    observer = Observer(model, Sensors({"theta": {"noise": 0.01}}, rates={"theta": "Omega"}), setup)
    observer.load_state_dict({"process_noise": [0.01, 0.02], "nis": 1.0})
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Controller(actor(task.n_o, 1, (6, 5)).requires_grad_(False), setup, observer, {})


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
def test_the_program_of_the_page_acts_as_the_controller(controller, tmp_path):
    for name, text in {**controller_sources(controller).files(), "main.c": PROGRAM}.items():
        (tmp_path / name).write_text(text)
    done = subprocess.run([compiler(), *STRICT[1:], *COMMAND], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    printed = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    u = [controller.act([0.1, math.nan], [0.0])[0] for _ in range(100)]
    assert float(printed) == pytest.approx(u[-1], abs=1e-6) and abs(u[-1]) > 1e-3


def test_the_command_writes_what_the_page_says(controller, tmp_path):
    save(controller, tmp_path / "run" / "controller.json")
    command = [sys.executable, str(REPOSITORY / "scripts" / "export.py"), "run=run", "formats=[c,fmu,model]"]
    done = forked.run(command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table = re.findall(r"^\| `(c|fmu|model)` \| ([^|]+) \|", PAGE, re.M)
    names = {name for _, files in table for name in re.findall(r"`([\w.]+)`", files)}
    assert {path.name for path in (tmp_path / "run" / "export").iterdir()} == names
    assert "us per call on this computer" in done.stdout and "Files: run/export" in done.stdout
