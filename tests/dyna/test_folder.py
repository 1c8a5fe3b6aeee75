import json
import subprocess
import sys

import pytest
import torch

from dynasindy.dyna.run import result
from dynasindy.safe_io import locked


def finished(folder, episodes=3):
    record = {"episodes": episodes, "cost": {}, "evaluation": {}, "untrained": {}}
    record |= {"equations": [], "verdict": {}}
    (folder / "metrics.json").write_text(json.dumps(record))
    (folder / "model.json").write_text("{}")
    torch.save({"weight": torch.zeros(2)}, folder / "policy.pt")
    return record


def test_a_run_has_ended_if_its_files_are_sound(tmp_path):
    assert result(tmp_path, 3) is None
    record = finished(tmp_path)
    assert result(tmp_path, 3) == record
    assert result(tmp_path, 4) is None  # it was ended after three of four episodes


@pytest.mark.parametrize("name", ["metrics.json", "model.json", "policy.pt"])
@pytest.mark.parametrize("size", [0, 10])
def test_a_cut_file_is_no_result(tmp_path, name, size):
    finished(tmp_path)
    (tmp_path / "model.json").write_text(json.dumps({"library": list(range(20))}))
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:size])
    assert result(tmp_path, 3) is None


HOLD = (
    "import sys; from pathlib import Path; from dynasindy.safe_io import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
)


def test_two_processes_cannot_work_in_one_folder(tmp_path):
    other = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert other.stdout.readline() == b"held\n"
    with pytest.raises(ValueError, match="works"), locked(tmp_path):
        pass
    other.kill()  # a claim does not outlive its process, however that ends
    other.wait()
    with locked(tmp_path):
        pass
