"""The command prints its verdict, writes numbers and figures, and its exit code says whether the loop is stable."""

import json
import os

import forked
import pytest
from carts import save_run

from dynasindy.findings import note, records, weak

SMALL = ("points=1", "grid=2", "draws=1", "seconds=3")


def called(folder, *words):
    return forked.call("check", "run=run", *words, cwd=folder)


@pytest.mark.parametrize(("spring", "code"), [(2.0, 0), (-2.0, 1)])
def test_the_exit_code_is_1_where_the_loop_is_not_stable(tmp_path, spring, code):
    save_run(tmp_path / "run", spring)
    (tmp_path / "run" / "config.yaml").write_text("plant: {low: [-0.1], high: [0.1]}\n")
    done = called(tmp_path, *SMALL)
    assert done.returncode == code, done.stderr
    assert ("NOT stable" in done.stdout) == bool(code)
    found = json.loads((tmp_path / "run" / "check" / "check.json").read_text())
    assert found["targets"][0]["stable"] == (code == 0) and found["settings"]["low"] == [-0.1]
    assert any(each["severity"] == "wrong" for each in found["findings"]) == bool(code)
    names = {path.name for path in (tmp_path / "run" / "check").iterdir()}
    assert {"check.json", "recovery.png", "steps.png"} <= names and ("nyquist.png" in names) == (code == 0)


def test_the_main_figures_join_what_the_run_has_written_and_leave_it_as_it_is(tmp_path):
    """A spring and a damper alone bear any gain of an input that hardly acts: no margin ends them."""
    save_run(tmp_path / "run", 2.0)
    (tmp_path / "run" / "config.yaml").write_text("plant: {low: [-0.1], high: [0.1]}\n")
    lacking = records([weak("model.unexplained", shares={"v": 0.2}), note("model.delay", seconds=0.1)])
    before = {"episodes": 3, "verdict": {"usable": True}, "cost": None, "findings": lacking}
    kept = tmp_path / "run" / "metrics.json"
    kept.write_text(json.dumps(before))
    os.utime(kept, (1e9, 1e9))
    done = called(tmp_path, *SMALL)
    assert done.returncode == 0, done.stderr
    assert "warning: " in done.stdout and "20 % in v" in done.stdout  # which no simulation of the model tells
    after = json.loads(kept.read_text())
    told = after.pop("check")
    assert after == before and kept.stat().st_mtime == 1e9  # evaluations made since are none of an older run
    assert told["stable"] is True
    whole = json.loads((tmp_path / "run" / "check" / "check.json").read_text())
    values = {each["code"]: each["values"] for each in told["findings"]}
    assert values["check.disk_margin"]["value"] == whole["targets"][0]["margins"]["force"]["disk"]
    shares = {" and ".join(each["states"]): each["share"] for each in whole["recovery"]}
    assert values["check.recovery"]["shares"] == shares
    assert told["findings"] == whole["findings"]
    called(tmp_path, *SMALL, f"folder={tmp_path}/elsewhere", "low=[-0.2]")
    assert json.loads(kept.read_text())["check"] == told


def test_what_is_missing_costs_one_line(tmp_path):
    save_run(tmp_path / "run", 2.0)
    done = called(tmp_path, *SMALL)
    assert done.returncode == 2 and "low" in done.stderr and "run/config.yaml" in done.stderr
    (tmp_path / "run" / "model.json").unlink()
    done = called(tmp_path, *SMALL, "low=[0]", "high=[0]")
    assert done.returncode == 2 and "model" in done.stderr and done.stderr.count("\n") == 1
