"""What a command leaves behind: nothing beside what was asked for."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_a_run_in_a_folder_of_its_own_leaves_no_other_one(tmp_path):
    words = ["system=pendulum", "excitation.duration=3", "data.validation_seconds=1", f"folder={tmp_path}/mine"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "scripts" / "identify.py"), *words]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine"] and (tmp_path / "mine" / "model.json").is_file()
    assert "next:\n  python scripts/train.py system=pendulum excitation.duration=3  # excites" in done.stdout


def test_what_lies_in_a_folder_of_runs_stays(tmp_path):
    (tmp_path / "runs" / "before").mkdir(parents=True)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "scripts" / "identify.py"), "data=csv", "data.path=nowhere.csv"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300, cwd=tmp_path)
    assert done.returncode == 2 and "nowhere.csv does not exist" in done.stderr
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*"))] == ["runs", "runs/before"]
