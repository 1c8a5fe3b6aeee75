"""The C program that docs/export.md shows compiles, and acts as the controller in Python."""

import re
import subprocess
from pathlib import Path

import forked
import pytest
import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, Observer, load, save
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.export import controller_sources
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.systems.compiler import STRICT, compiler

REPOSITORY = Path(__file__).parents[1]
PAGE = (REPOSITORY / "docs" / "export.md").read_text()
PROGRAM = re.search(r"```c\n(.*?)```", PAGE, re.S)[1]
(ONNX,) = re.findall(r"```python\n(import numpy.*?)```", PAGE, re.S)
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


@pytest.fixture
def trained():
    """The controller of the main job, which sees all states as they are."""
    return load(REPOSITORY / "docs" / "results" / "policies" / "tras")


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
@pytest.mark.parametrize("name", ["controller", "trained"])
def test_the_program_of_the_page_acts_as_the_controller(name, request, tmp_path):
    controller = request.getfixturevalue(name)
    for file, text in {**controller_sources(controller).files(), "main.c": PROGRAM}.items():
        (tmp_path / file).write_text(text)
    done = subprocess.run([compiler(), *STRICT[1:], *COMMAND], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    printed = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    u = actions(controller)
    assert float(printed) == pytest.approx(u[0], abs=1e-6) and abs(u[0]) > 1e-3


@pytest.mark.parametrize("name", ["controller", "trained"])
def test_the_lines_of_the_page_on_onnx_act_as_the_controller(name, request, tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    controller = request.getfixturevalue(name)
    save(controller, tmp_path / "run" / "controller.json")
    done = forked.call("export", "run=run", "formats=[onnx]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    monkeypatch.chdir(tmp_path / "run" / "export")
    names = {}
    exec(compile(ONNX, "docs/export.md", "exec"), names)
    assert names["u"].tolist() == pytest.approx(actions(controller), abs=1e-5)


def actions(controller):
    """Return the action after 100 periods of the same measurement, 0.1 of the first state."""
    y, r = [0.1] + [0.0] * (controller.signature.n_x - 1), [0.0] * len(controller.outputs)
    controller.reset()
    return [controller.act(y, r) for _ in range(100)][-1].tolist()


def test_the_command_writes_what_the_page_says(controller, tmp_path):
    save(controller, tmp_path / "run" / "controller.json")
    done = forked.call("export", "run=run", "formats=[c,fmu,model]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table = re.findall(r"^\| `(c|fmu|model)` \| ([^|]+) \|", PAGE, re.M)
    names = {name for _, files in table for name in re.findall(r"`([\w.]+)`", files)}
    assert {path.name for path in (tmp_path / "run" / "export").iterdir()} == names
    assert "us per call on this computer" in done.stdout and "Files: run/export" in done.stdout
