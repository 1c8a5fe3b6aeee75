"""From a log to a controller by the command of README, and what it says where something is missing."""

import hashlib
import json
import os
import sys
from pathlib import Path

import forked
import pytest
from omegaconf import OmegaConf

ROOT = Path(__file__).parents[2]


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
