"""The programs in docs/check.md, docs/export.md and docs/torchrl.md run, and do what the pages say."""

import inspect
import json
import re
import shutil
import subprocess
import textwrap
import warnings
from pathlib import Path

import forked
import pytest
import torch
from controllers import pendulum_controller

from dynasindy.control import load, save
from dynasindy.envs import ControlEnv, Tracking
from dynasindy.export import controller_sources
from dynasindy.systems.compiler import STRICT, compiler

DOCS = Path(__file__).parents[1] / "docs"
CHECK, EXPORT, TORCHRL = ((DOCS / f"{page}.md").read_text() for page in ("check", "export", "torchrl"))
INTEGRAL = re.findall(r"^    (import dynasindy\n(?:(?:    .*)?\n)+)", CHECK, re.M)
(CHECKS,) = re.findall(r"```python\n(.*?)```", CHECK, re.S)


def test_the_lines_that_check_a_controller_run(monkeypatch, capsys):
    monkeypatch.chdir(DOCS.parent)
    names = {}
    assert "grid=5, draws=3, seconds=20.0" in CHECKS
    short = CHECKS.replace("grid=5, draws=3, seconds=20.0", "grid=3, draws=1, seconds=5.0")
    exec(compile(short, "docs/check.md", "exec"), names)
    assert capsys.readouterr().out
    assert 1.0 < names["gain"] < float("inf")  # a stable loop bears a little more gain


def test_the_lines_on_integral_action_save_a_controller_that_has_it(tmp_path, monkeypatch):
    run = tmp_path / "runs" / "DATE_TIME"
    shutil.copytree(DOCS / "results" / "policies" / "tras", run)
    monkeypatch.chdir(tmp_path)
    before = json.loads((run / "controller.json").read_text())
    exec(compile(textwrap.dedent("    " + INTEGRAL[0]), "docs/check.md", "exec"), {})
    after = json.loads((run / "controller.json").read_text())
    assert before.pop("integral") is None and after.pop("integral")["gain"] > 0
    assert after["policy"] == before["policy"] and after["signature"]["x_scale"] == before["signature"]["x_scale"]


PROGRAM = re.search(r"```c\n(.*?)```", EXPORT, re.S)[1]
(ONNX,) = re.findall(r"```python\n(import numpy.*?)```", EXPORT, re.S)
COMMAND = re.search(r"^    gcc (.*)$", EXPORT, re.M)[1].split()


@pytest.fixture
def controller():
    return pendulum_controller(delay=0.0, stops=False)


@pytest.fixture
def trained():
    """The controller of the main job, which sees all states as they are."""
    return load(DOCS / "results" / "policies" / "tras")


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
@pytest.mark.parametrize("name", ["controller", "trained"])
def test_the_program_of_the_export_acts_as_the_controller(name, request, tmp_path):
    controller = request.getfixturevalue(name)
    for file, text in {**controller_sources(controller).files(), "main.c": PROGRAM}.items():
        (tmp_path / file).write_text(text)
    done = subprocess.run([compiler(), *STRICT[1:], *COMMAND], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    printed = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    u = actions(controller)
    assert float(printed) == pytest.approx(u[0], abs=1e-6) and abs(u[0]) > 1e-3


@pytest.mark.parametrize("name", ["controller", "trained"])
def test_the_lines_on_onnx_act_as_the_controller(name, request, tmp_path, monkeypatch):
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


def test_an_export_writes_what_the_page_says(controller, tmp_path):
    save(controller, tmp_path / "run" / "controller.json")
    done = forked.call("export", "run=run", "formats=[c,fmu,model]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table = re.findall(r"^\| `(c|fmu|model)` \| ([^|]+) \|", EXPORT, re.M)
    names = {name for _, files in table for name in re.findall(r"`([\w.]+)`", files)}
    assert {path.name for path in (tmp_path / "run" / "export").iterdir()} == names
    assert "us per call on this computer" in done.stdout and "Files: run/export" in done.stdout


LOOPS = re.findall(r"```python\n(.*?)```", TORCHRL, re.S)


def lived(block, names):
    with warnings.catch_warnings(record=True) as told, torch.random.fork_rng():
        warnings.simplefilter("always")
        exec(compile(block, "docs/torchrl.md", "exec"), names)
    assert not [str(each.message) for each in told if "InitTracker" in str(each.message)]
    return names


def test_the_loops_of_torchrl_run_and_the_keys_hold_what_its_table_says(capfd):
    first, second = LOOPS
    assert "total_frames=2000" in first
    names = lived(first.replace("total_frames=2000", "total_frames=300"), {})
    printed = "".join(capfd.readouterr())
    assert "InitTracker" not in printed and "is_init" in printed
    assert len(names["buffer"]) == 300
    flight = names["flight"]
    error = flight["reference"] - flight["state"][..., :1].float()
    expected = torch.cat([flight["state"].float() / torch.tensor([1.0, 3.0]), error / 0.5], -1)  # targets span 1 rad
    torch.testing.assert_close(flight["observation"], expected)
    keys = set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`.*?) \|", TORCHRL, re.M))))
    assert keys <= set(flight.keys()) | set(flight["next"].keys())
    assert flight["next", "truncated"].flatten().tolist() == [False] * 99 + [True]
    names = lived(second, names)
    assert len(names["buffer"]) == 300
    assert all(torch.isfinite(weight).all() for weight in names["loss"].parameters())


def test_the_settings_of_the_task_are_those_that_the_page_on_torchrl_lists():
    (listed,) = re.findall(r"^`Tracking\((.*?)\)`", TORCHRL, re.M | re.S)
    assert listed.replace("\n", " ").split(", ") == list(inspect.signature(Tracking).parameters)
    (listed,) = re.findall(r"^`ControlEnv\((.*?)\)`", TORCHRL, re.M | re.S)
    for name in inspect.signature(ControlEnv.__init__).parameters.keys() - {"self"}:
        assert name in listed
