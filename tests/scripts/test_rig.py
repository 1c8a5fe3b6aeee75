"""The command that flies a rig finds mistakes before anything moves, and says how it was stopped."""

import re
from pathlib import Path

import forked

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
