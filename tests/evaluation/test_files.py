"""Evaluations on disk read back as what they were."""

import csv
import json
from pathlib import Path

import pytest
import torch

from dynasindy.envs import ControlEnv
from dynasindy.evaluation.files import save_evaluation, write_csv
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.evaluation.summary import summarise
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking


def test_json_holds_the_summary_and_csv_one_row(tmp_path: Path) -> None:
    system = Xi()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.1, 0.2], [0.3, -0.1]])), substeps=1)
    scenario = Scenario("two", episodes=2, seconds=0.5)
    result = evaluate(env, lambda td: td.set("action", torch.full((*td.batch_size, 2), 0.25)), scenario)
    figures, table = save_evaluation(result, tmp_path / "new", row=1)

    record = json.loads(figures.read_text())
    assert (record.pop("scenario"), record.pop("rows")) == ("two", 2)
    assert record == summarise(result)

    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 10
    assert float(rows[3]["time [s]"]) == pytest.approx(0.15)
    assert float(rows[3]["omega_p [rpm]"]) == pytest.approx(result.trajectory["state"][1, 3, 5].item(), rel=1e-8)
    assert (rows[3]["u_a [-]"], float(rows[3]["reference_alpha_p [rad]"])) == ("0.25", pytest.approx(-0.1))


def test_a_table_replaces_the_old_one_whole(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "table.csv"
    write_csv(path, ["a", "b"], [[1.0, None]])
    write_csv(path, ["a", "b"], [[1.0, None], [2.5, 3.0]])
    assert path.read_text().split() == ["a,b", "1,", "2.5,3"]
    assert [file.name for file in path.parent.iterdir()] == ["table.csv"]
