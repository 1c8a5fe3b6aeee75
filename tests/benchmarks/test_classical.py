"""The table of classical controllers."""

import csv

from dynasindy.agents.classical import Tuning
from dynasindy.benchmarks import classical


def test_main_writes_a_row_per_controller_scenario_and_axis(tmp_path, monkeypatch, capsys):
    quick = Tuning(population=6, elites=2, draws=1, seconds=1.0)
    monkeypatch.setattr(classical, "Tuning", lambda: quick)
    monkeypatch.setattr(classical, "PLANTS", {"xi": classical.Xi})
    classical.main(["--seconds", "2", "--out", str(tmp_path / "classical.csv")])
    with (tmp_path / "classical.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 4 * 2
    assert {(row["controller"], row["scenario"]) for row in rows} == {
        (controller, scenario) for controller in ("LQI", "PID") for scenario in ("step", "steps", "sine", "square")
    }
    assert all(0 < float(row["rmse [rad]"]) < 1 for row in rows)
    assert "PID gains" in capsys.readouterr().out
