"""The command that flies a rig finds mistakes before anything moves, and says how it was stopped."""

import os
import re
from pathlib import Path

import forked
import pytest
import torch

from dynasindy.sindy import SindyModel

ROOT = Path(__file__).parents[2]


def test_the_file_of_the_page_is_a_rig_that_only_a_connection_is_missing_of(tmp_path):
    page = (ROOT / "docs" / "rig.md").read_text()
    (block,) = re.findall(r"`my_rig/system/arm.yaml`\n\n```yaml\n(.*?)```", page, re.S)
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text(block)
    words = ["--config-dir", str(tmp_path), "system=arm", f"folder={tmp_path}/run"]
    done = forked.call("rig", *words)
    assert done.returncode == 2
    assert "angle within -1.5 to 1.5 rad" in done.stdout and "rig=udp" in done.stderr


@pytest.mark.slow
def test_a_plant_of_a_user_without_known_equations_is_rehearsed(tmp_path):
    (tmp_path / "conf" / "system").mkdir(parents=True)
    (tmp_path / "user_tank.py").write_text(
        "from dynasindy.systems import Signature, System\n\n\n"
        "class Tank(System):\n"
        "    def __init__(self):\n"
        "        super().__init__(Signature(('h',), ('m',), ('pump',), (1.0,)))\n\n"
        "    def forward(self, x, u):\n"
        "        return 0.2 * (1.0 + u) - 0.2 * x\n"
    )
    (tmp_path / "conf" / "system" / "tank.yaml").write_text(
        "# @package _global_\n"
        "system: {_target_: user_tank.Tank}\n"
        "plant: {outputs: [h], low: [0.2], high: [0.8], library: polynomial, amplitude: [0.5], offset: [0.0],\n"
        "  sensors: {h: {noise: 0.002}}}\n"
    )
    words = ["--config-dir", str(tmp_path / "conf"), "system=tank", "sensors=bench", f"folder={tmp_path}/run"]
    words += ["excitation.duration=10", "seconds=0.5", "planner={updates: 2}", "guard.late=50", "guard.lost=100"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    done = forked.call("rig", *words, env=environment)
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr
    # What was identified is dh/dt = 0.2 + 0.2 pump - 0.2 h.
    model = SindyModel.load(str(tmp_path / "run" / "model.json"))
    rates = model(torch.tensor([[0.0], [1.0]], dtype=torch.float64), torch.tensor([[0.0], [0.5]], dtype=torch.float64))
    torch.testing.assert_close(rates, torch.tensor([[0.2], [0.1]], dtype=torch.float64), atol=0.02, rtol=0)
