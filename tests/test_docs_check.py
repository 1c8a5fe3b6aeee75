"""The lines of docs/check.md that check a controller from Python run, and print what the command prints."""

import json
import re
import shutil
import textwrap
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
PAGE = (REPOSITORY / "docs" / "check.md").read_text()
INTEGRAL = re.findall(r"^    (import dynasindy\n(?:(?:    .*)?\n)+)", PAGE, re.M)
(BLOCK,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)


def test_the_lines_of_the_page_run(monkeypatch, capsys):
    monkeypatch.chdir(REPOSITORY)
    names = {}
    assert "grid=5, draws=3, seconds=20.0" in BLOCK
    short = BLOCK.replace("grid=5, draws=3, seconds=20.0", "grid=3, draws=1, seconds=5.0")
    exec(compile(short, "docs/check.md", "exec"), names)
    assert capsys.readouterr().out
    assert 1.0 < names["gain"] < float("inf")  # a stable loop bears a little more gain


def test_the_lines_on_integral_action_save_a_controller_that_has_it(tmp_path, monkeypatch):
    run = tmp_path / "runs" / "DATE_TIME"
    shutil.copytree(REPOSITORY / "docs" / "results" / "policies" / "tras", run)
    monkeypatch.chdir(tmp_path)
    before = json.loads((run / "controller.json").read_text())
    exec(compile(textwrap.dedent("    " + INTEGRAL[0]), "docs/check.md", "exec"), {})
    after = json.loads((run / "controller.json").read_text())
    assert before.pop("integral") is None and after.pop("integral")["gain"] > 0
    assert after["policy"] == before["policy"] and after["signature"]["x_scale"] == before["signature"]["x_scale"]
