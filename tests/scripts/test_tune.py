"""A search of Optuna on a log: its score is the one that each trial forecast, and the same command goes on with it."""

import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path

import forked
import pytest
import yaml

from dynasindy.envs.rollout_data import record_plant
from dynasindy.excitation import Multisine
from dynasindy.systems import Pendulum

ROOT = Path(__file__).parents[2]
INSTALLED = find_spec("hydra_plugins.hydra_optuna_sweeper") if find_spec("hydra_plugins") else None
WORDS = ["plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]", "planning.rollouts=4", "planning.updates=2"]
WORDS += ["plant.library=['1',u,theta,Omega,'sin(theta)']", "scenario.reference.number=4", "scenario.episodes=4"]


def tune(log, folder):
    words = ["-m", "experiment=tune", f"data.path={log}", *WORDS, "hydra.sweeper.n_trials=3", "seed=4"]
    command = [sys.executable, str(ROOT / "scripts" / "train.py"), *words, f"hydra.sweep.dir={folder}"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return forked.run(command, env=environment, timeout=300)


@pytest.fixture(scope="module")
def log(tmp_path_factory, write_log):
    data = record_plant(Pendulum(), Multisine(1, duration=6, dt=0.05, amplitude=[0.8], seed=0).samples(0.01), 0.01)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    return write_log(path, ["theta [rad]", "Omega [rad/s]", "u"], data.x, data.u)


@pytest.mark.slow
@pytest.mark.skipif(INSTALLED is None, reason="Optuna is not installed: pip install 'dynasindy[tune]'")
def test_the_best_trial_is_the_one_of_the_least_error_and_the_search_goes_on(log, tmp_path):
    done = tune(log, tmp_path / "tune")
    assert done.returncode == 0, done.stderr
    assert all("of 3 jobs" in line for line in done.stderr.splitlines())  # how far it is, and nothing of Optuna's own
    best = yaml.safe_load((tmp_path / "tune" / "optimization_results.yaml").read_text())
    trials = {
        json.loads(file.read_text())["prediction"]["score"]: yaml.safe_load((file.parent / "config.yaml").read_text())
        for file in (tmp_path / "tune").glob("[0-9]/metrics.json")
    }
    assert len(trials) == 3 and best["best_value"] == pytest.approx(min(trials), rel=1e-12)
    chosen = trials[min(trials)]["planning"]
    assert {f"planning.{name}": chosen[name] for name in ("lr", "width", "window", "real_starts", "jumps")} == (
        pytest.approx(best["best_params"])
    )
    assert {trial["seed"] for trial in trials.values()} == {4}
    assert "Best trial: planning.lr=" in done.stdout and "finished before" not in done.stdout
    again = tune(log, tmp_path / "tune")
    assert again.returncode == 0 and again.stdout.count("finished before") == 3
    assert yaml.safe_load((tmp_path / "tune" / "optimization_results.yaml").read_text()) == best


@pytest.mark.skipif(INSTALLED is not None, reason="Optuna is installed")
def test_without_optuna_a_line_says_how_to_install_it(log, tmp_path):
    done = tune(log, tmp_path / "tune")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "dynasindy[tune]" in done.stderr
