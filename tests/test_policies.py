"""The policies in docs/results/policies are read by one line, small, and hold the plants that they were made for."""

import json
import re
import shutil
from pathlib import Path

import forked
import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

import dynasindy
from dynasindy.systems import Tras, Xi

REPOSITORY = Path(__file__).parents[1]
POLICIES = REPOSITORY / "docs" / "results" / "policies"
PLANTS = {"tras": Tras, "xi": Xi}


def test_there_is_a_policy_for_each_plant_of_the_readme_and_all_of_them_are_small():
    assert sorted(folder.name for folder in POLICIES.iterdir()) == sorted(PLANTS)
    files = [file for file in POLICIES.glob("*/*") if file.is_file()]
    assert {file.name for file in files} == {"config.yaml", "controller.json", "model.json", "origin.json"}
    assert sum(file.stat().st_size for file in files) < 250_000
    assert not any(re.search(r"/(home|root|tmp|work|Users)\b", file.read_text()) for file in files)


def test_each_names_the_command_that_made_it():
    for name in PLANTS:
        origin = json.loads((POLICIES / name / "origin.json").read_text())
        assert origin["command"] == f"python scripts/train.py system={name}"


@pytest.mark.parametrize("name", PLANTS)
def test_a_policy_holds_its_plant_moved_by_another_integrator(name):
    controller, plant = dynasindy.load(POLICIES / name), PLANTS[name]()
    target, x, errors = np.array([0.3, -0.2]), np.zeros(6), []
    for period in range(160):
        errors.append(np.abs(x[:2] - target))
        u = torch.from_numpy(controller.act(x, target))
        moved = solve_ivp(
            lambda t, y, u=u: plant(torch.from_numpy(y), u).numpy(), (0, controller.dt), x, rtol=1e-4, atol=1e-6
        )
        x = moved.y[:, -1]
        assert period > 0 or np.abs(x).sum() > 0  # the first input moves it
    assert np.max(errors[-60:]) < 0.01  # rad, from 0.3 and 0.2 at first
    assert np.min(errors[0]) == pytest.approx(0.2)


def run_command(name, run, *words):
    """Run a command on a copy of a policy."""
    done = forked.call(name, f"run={run}", *words, cwd=run.parent, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", PLANTS)
def test_a_policy_is_evaluated_and_checked_without_training(name, tmp_path):
    run = Path(shutil.copytree(POLICIES / name, tmp_path / name))
    run_command("evaluate", run, "scenarios=[step]")
    found = json.loads((run / "evaluation" / "step.json").read_text())
    wanted = json.loads((POLICIES / name / "origin.json").read_text())["evaluation"]
    assert {key: found[key] for key in wanted} == pytest.approx(wanted, rel=0.02, abs=1e-5)
    run_command("check", run, "points=1", "grid=3", "draws=1", "seconds=5")
    assert json.loads((run / "check" / "check.json").read_text())
